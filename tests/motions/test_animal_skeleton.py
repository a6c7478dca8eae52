"""Skeletons of four-legged animals without a mesh move the shipped quadruped, whatever their names and axes."""

import numpy as np
import pytest
from animals import BODY, FEET, animal, bones, nothing_said, random_turns
from motion_files import write_bvh

from mimesh.bodies import load_body
from mimesh.bodies.character_pool import facing_rotation
from mimesh.core.geometry import angles_between, rotation_between
from mimesh.io.gltf.character import NO_PERSON
from mimesh.motions import Motion, load_motion, window
from mimesh.motions.bvh import Bvh, load_bvh
from mimesh.motions.motion import joint_tracks
from mimesh.motions.on_body import on_body, retarget_animal
from mimesh.pipeline.gltf_rigs import person_motion

Z_UP = rotation_between(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
TURNS = {"+z, y up": np.eye(3), "-x, y up": facing_rotation("-x").T, "z up": Z_UP}
LEVEL = [name for name in bones() if not name.endswith(("Fingers", "Toes"))]
"""Joints whose rotation is that of one bone; toes of the body point to the ground."""


def skeleton(made, turn: np.ndarray, size: float = 1.0) -> tuple[Bvh, Motion]:
    """Make a skeleton of an animal in three frames, turned and scaled, and its motion as the shipped body has it."""
    path = np.array([[0.0, 0.0, 0.1 * t] for t in range(3)])
    local = np.tile(np.eye(3), (3, len(BODY.parents), 1, 1))
    for t in range(3):
        for name, rotation in random_turns(t, LEVEL).items():
            local[t, BODY.joint(name)] = rotation
    motion = Motion("truth", BODY.joint_names, local, path)
    chosen = [BODY.joint(name) for name in made.order]
    own = turn @ np.stack([local[:, j] for j in chosen], axis=1) @ turn.T
    offsets = size * np.array(
        [at - (made.joints[p] if p >= 0 else at) for at, p in zip(made.joints, made.parents, strict=True)]
    )
    names = tuple(map(nothing_said, made.order))
    ends = {nothing_said(foot): size * turn @ [0.0, -made.joints[made.order.index(foot), 1], 0.0] for foot in FEET}
    hips = size * (made.joints[0] + path)
    return Bvh("walk", names, made.parents, offsets @ turn.T, ends, own, hips @ turn.T, 30.0), motion


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
def test_the_quadruped_has_the_rotations_and_the_way_of_the_skeleton(turn):
    """The way within 1 %, as legs are measured to the ground, which those of the body are above at rest."""
    source, truth = skeleton(animal(), turn, size=3.0)
    found = on_body(source, "walk.bvh").motion
    expected, given = (joint_tracks(BODY, motion)[0] for motion in (truth, found))
    chosen = [BODY.joint(name) for name in LEVEL]
    assert angles_between(given[:, chosen], expected[:, chosen]).max() < 1e-3
    assert np.allclose(np.diff(found.root, axis=0), np.diff(truth.root, axis=0), atol=1e-3)


def test_the_joints_are_those_of_an_animal():
    clip = on_body(skeleton(animal(0), np.eye(3))[0], "walk.bvh").clip()
    assert clip.skeleton is not None
    assert person_motion(clip.skeleton, "quadruped").joints == BODY.joint_names
    with pytest.raises(NO_PERSON, match="those of an animal"):
        person_motion(clip.skeleton, "human")


@pytest.mark.parametrize("rest", ["t", "a", "lowered", "up", "along-x"])
def test_skeletons_of_people_are_no_animals(tmp_path, rest):
    path = write_bvh(tmp_path / "a.bvh", load_body(), window(load_motion("jump"), 0.0, 0.1), rest=rest)
    assert retarget_animal(load_bvh(path)) is None
