"""Rigs that were bound sitting, crouching, lying or running move as the same one bound in a T-pose."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import rigs
from scipy.spatial.transform import Rotation

import mimesh
from mimesh.io import load_mesh
from mimesh.io.gltf.draft import Draft


def turns(**angles: tuple[float, float, float]) -> dict[str, tuple[float, float, float]]:
    """Return rotation vectors (degrees) of joints; those of "Legs" and "Shins" for both sides."""
    both = {"Legs": "UpLeg", "Shins": "Leg"}
    pairs = [(side + both[name], of) for name, of in angles.items() if name in both for side in ("Left", "Right")]
    return dict(pairs) | {name: of for name, of in angles.items() if name not in both}


ARMS = {"LeftForeArm": (0.0, -80.0, 0.0), "RightForeArm": (0.0, 60.0, 0.0)}
ACTIONS = {
    "sitting": turns(Legs=(-85, 0, 0), Shins=(85, 0, 0), **ARMS),
    "on the floor": turns(Hips=(-25, 0, 0), Legs=(-65, 0, 0), Spine=(30, 0, 0)),
    "crouching": turns(Hips=(50, 0, 0), Legs=(-130, 0, 0), Shins=(120, 0, 0), Head=(-30, 20, 0), **ARMS),
    "running": turns(
        Hips=(10, 15, 0), Spine=(5, -30, 0), LeftUpLeg=(-60, 0, 0), LeftLeg=(70, 0, 0), RightUpLeg=(20, 0, 0), **ARMS
    ),
    "on the back": turns(Hips=(-88, 10, 5), LeftUpLeg=(-30, 0, 0), LeftLeg=(60, 0, 0)),
    "on the side": turns(Hips=(0, 0, 86), Legs=(-50, 0, 0), Shins=(80, 0, 0)),
}


SCALES = np.array([[1.0, 1.0, 1.0], [1.3, 1.3, 1.3]])


@cache
def clip(folder) -> mimesh.Clip:
    """Make the driving: another person's exercise on a rig in a T-pose."""
    path = rigs.character(folder / "driving.glb", shape=3, clips={"move": rigs.exercise(rigs.figure(3))})
    return mimesh.load_clip(path)


def moved(folder, name: str, pose: dict[str, tuple[float, float, float]], without=(), frames=None, **options):
    """Move person 0, bound in a pose; returns the result, and its joints from the hips (T, J, 3) in metres."""
    person = rigs.figure().without(*without)
    rest = np.tile(np.eye(3), (len(person.names), 1, 1))
    for joint in pose.keys() & set(person.names):
        rest[person.names.index(joint)] = Rotation.from_rotvec(pose[joint], degrees=True).as_matrix()
    path = rigs.character(folder / f"{name}.glb", person=person, rest=rest, frames=frames, **options)
    result = mimesh.animate(load_mesh(path), clip(folder), motion=mimesh.MotionOptions(contacts=False))
    assert result.skeleton is not None
    joints = result.skeleton.joint_positions()
    return result, dict(zip(result.skeleton.names, np.moveaxis(joints - joints[:, :1], 1, 0), strict=True))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("rests")


@pytest.mark.slow
@pytest.mark.parametrize("name", ACTIONS)
def test_a_rig_bound_in_an_action_moves_as_one_bound_in_a_t_pose(folder, name):
    _, truth = moved(folder, "T", {})
    result, found = moved(folder, name.replace(" ", "-"), ACTIONS[name])
    assert result.report.get("rig") == "own"
    for joint, path in found.items():
        # A foot is as its surface says: 1 cm at the toes of this body of 300 triangles.
        np.testing.assert_allclose(path, truth[joint], atol=0.01 if joint.endswith("ToeBase") else 1e-5)


LIMBS = ("UpLeg", "Leg", "Foot", "ToeBase", "Shoulder", "Arm", "ForeArm", "Hand")
TRUNK = ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head")


@pytest.mark.parametrize("pose", [{}, ACTIONS["sitting"]], ids=["T-pose", "sitting"])
@pytest.mark.parametrize(
    "without",
    [
        pytest.param(joints, id=joints[-1], marks=[] if joints == ("LeftFoot",) else pytest.mark.slow)
        for joints in [(name,) for name in TRUNK]
        + [(f"Left{name}",) for name in LIMBS]
        + [(f"Left{name}", f"Right{name}") for name in LIMBS]
    ],
)
def test_a_rig_that_lacks_a_joint_is_used_or_said_not_to_be(folder, pose, without):
    """Of a limb whose rig is used, the other limbs and the trunk move as with it."""
    _, truth = moved(folder, "T", {})
    result, found = moved(folder, "lacks", pose, without)
    if result.report.get("rig") != "own":
        assert any("the rig of lacks is not used" in note for note in result.notes)
        assert without[0].endswith(("Leg", "Foot"))
        return
    assert all(np.isfinite(path).all() for path in found.values())
    if without[0].startswith("Left") and without[0] != "LeftUpLeg":  # trunk and thighs tell where hips face
        part = LIMBS[:4] if without[0][4:] in LIMBS[:4] else LIMBS[4:]
        others = [n for n in found.keys() & truth.keys() if n.removeprefix("Left").removeprefix("Right") not in part]
        for joint in others:
            ends = joint.endswith(("ToeBase", "Thumb", "FingerBase", "HandFinger1"))
            np.testing.assert_allclose(found[joint], truth[joint], atol=0.05 if ends else 1e-5, err_msg=joint)


def test_it_stands_on_the_floor_that_it_lay_on(folder):
    result, _ = moved(folder, "lying", ACTIONS["on the back"])
    truth, _ = moved(folder, "T", {})
    heights = [
        np.asarray(of.clip.vertices)[..., 1].min(axis=1) - of.clip.mesh.vertices[:, 1].min() for of in (result, truth)
    ]
    np.testing.assert_allclose(*heights, atol=0.01)


def test_frames_that_say_nothing_leave_limbs_to_their_bend(folder):
    _, truth = moved(folder, "T", {})
    result, found = moved(folder, "random", ACTIONS["sitting"], frames=3)
    assert result.report.get("rig") == "own"
    for joint, atol in {
        "LeftLeg": 0.006,
        "RightLeg": 0.006,
        "LeftFoot": 0.006,
        "RightFoot": 0.006,
        "LeftArm": 0.02,
    }.items():
        np.testing.assert_allclose(found[joint], truth[joint], atol=atol)


@pytest.mark.parametrize("angle", [15, 30])
def test_a_rig_that_was_bound_aslant_moves_upright(folder, angle):
    """An armature turned about z before the mesh was bound to it."""
    _, truth = moved(folder, "T", {})
    turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()
    _, found = moved(folder, f"aslant-{angle}", {}, turn=turn, armature=np.eye(4))
    for joint, path in found.items():
        np.testing.assert_allclose(path, truth[joint], atol=0.01 if joint.endswith("ToeBase") else 1e-5)


@pytest.mark.slow
def test_scales_of_a_driving_are_left_with_a_note(folder):
    """Scales of joints, keyed in the driving, say nothing about an identity of another size."""

    def growing(draft: Draft) -> None:
        head = next(k for k, node in enumerate(draft.gltf["nodes"]) if node.get("name") == "Head")
        times, scales = draft.add_floats(np.array([[0.0], [0.2]]), bounds=True), draft.add_floats(SCALES)
        animation = draft.gltf["animations"][0]
        animation["channels"].append({"sampler": len(animation["samplers"]), "target": {"node": head, "path": "scale"}})
        animation["samplers"].append({"input": times, "output": scales})

    plain = rigs.character(folder / "plain.glb", shape=3, clips={"move": rigs.exercise(rigs.figure(3))})
    scaled = rigs.character(
        folder / "grows.glb", shape=3, clips={"move": rigs.exercise(rigs.figure(3))}, change=growing
    )
    identity = rigs.character(folder / "T.glb", frames=None)
    results = [mimesh.animate(load_mesh(identity), mimesh.load_clip(path)) for path in (plain, scaled)]
    np.testing.assert_allclose(*(np.asarray(result.clip.vertices) for result in results), atol=1e-5)
    note = "grows scales Head: joints are turned and moved, their sizes are not carried over"
    assert [note in result.notes for result in results] == [False, True]
