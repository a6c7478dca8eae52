"""Fingers of a rigged hand follow those of a rigged driving hand, whatever pose the hands rest in."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import rigs
from matrix import matrix
from networks import write_mime_network
from scipy.spatial.transform import Rotation

from mimesh.bodies.joint_names import FINGERS, finger_joints
from mimesh.core.options import MotionOptions
from mimesh.pipeline import animate

ALL = (*finger_joints("Left"), *finger_joints("Right"))
UNREAL = {"Thumb": "thumb", "Index": "index", "Middle": "middle", "Ring": "ring", "Pinky": "pinky"}
BONES = [(f"{side}Hand{finger}{k}", f"{side}Hand{finger}{k + 1}")
         for side in ("Left", "Right") for finger in FINGERS for k in (1, 2)]  # fmt: skip


def unreal(name: str) -> str:
    """Name finger joints as Unreal does: index_01_l; others keep our names."""
    if name not in ALL:
        return name
    side, finger = name.split("Hand")
    return f"{UNREAL[finger[:-1]]}_0{finger[-1]}_{side[0].lower()}"


def resting(person: rigs.Figure, angle: float) -> np.ndarray:
    """Local rotations of a rest pose with relaxed fingers: each joint is bent by an angle (degrees)."""
    rest = np.tile(np.eye(3), (len(person.names), 1, 1))
    for name in ALL:
        sign = -1 if name.startswith("Left") else 1
        rest[person.names.index(name)] = Rotation.from_euler("z", sign * angle, degrees=True).as_matrix()
    return rest


@matrix("angle", [0.0, 20.0], quick=[20.0])
def test_finger_bones_point_where_the_drivings_do(angle, tmp_path):
    pytest.importorskip("onnx")
    person = rigs.figure(None, fingers=True)
    frames = rigs.exercise(person, joints=(*rigs.MOVING, *ALL))
    driving = rigs.character(tmp_path / "move.glb", person=person, clips={"move": frames})
    short = dataclasses.replace(person, joints=person.joints.copy())
    for name in ALL:  # shorter fingers than the driving's
        hand = person.names.index(f"{name.split('Hand')[0]}Hand")
        short.joints[person.names.index(name)] += 0.2 * (person.joints[hand] - person.joints[person.names.index(name)])
    rest = resting(short, angle)
    path = rigs.character(tmp_path / "a.glb", person=short, rest=rest, name=unreal, frames=3)
    result = animate(
        str(path), str(driving), str(write_mime_network(tmp_path / "mime.onnx")), motion=MotionOptions(ground=False)
    )
    assert result.skeleton is not None
    names, positions = result.skeleton.names, result.skeleton.joint_positions()
    for start, end in BONES:
        found = positions[:, names.index(unreal(end))] - positions[:, names.index(unreal(start))]
        at = [[frame[person.names.index(n)] @ np.append(person.joints[person.names.index(n)], 1) for n in (start, end)]
              for frame in frames]  # fmt: skip
        expected = np.diff(np.array(at)[..., :3], axis=1)[:, 0]
        cosine = (found * expected).sum(axis=1) / np.linalg.norm(found, axis=1) / np.linalg.norm(expected, axis=1)
        assert np.degrees(np.arccos(cosine.clip(-1, 1))).max() < 1.0, start


def numbered(name: str) -> str:
    """Give finger joints names that say nothing; others keep theirs."""
    return f"bone_{ALL.index(name) * 7 % 31}" if name in ALL else name


@pytest.mark.slow
@pytest.mark.parametrize("missing", ["", "Thumb", "Pinky"])
def test_fingers_without_names_are_found_by_place(missing, model, tmp_path):
    """Hands turn as those whose fingers have names, and their fingers bend as these do; the outer one is the little."""
    person = rigs.figure(None, fingers=True)
    if missing:
        person = person.without(*(f"{side}Hand{missing}{k}" for side in ("Left", "Right") for k in (3, 2, 1)))

    def called(name: str) -> str:
        return unreal(name.replace("Ring", "Pinky") if missing == "Pinky" else name)

    frames = rigs.exercise(person, joints=(*rigs.MOVING, *ALL))
    driving = str(rigs.character(tmp_path / "move.glb", person=person, clips={"move": frames}))
    rest = rigs.arms_down(person)
    clips = [
        animate(
            str(rigs.character(tmp_path / file, person=person, rest=rest, name=name, faces=600)), driving, model
        ).clip.vertices
        for file, name in (("a.glb", called), ("b.glb", numbered))
    ]
    np.testing.assert_allclose(clips[1], clips[0], atol=1e-5)
