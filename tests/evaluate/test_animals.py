"""Protocol animals: truths by the names of joints, of folders and pools; and animals of species."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from animals import BODY, FEET, animal, bones, random_turns
from rigs import character

from mimesh.bodies.animals import ANIMALS
from mimesh.bodies.character_pool import transferred_transforms
from mimesh.bodies.quadruped import LOWERED_HEAD, lowered_head, posture
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.errors import InputError
from mimesh.evaluate.animals import animals, find_animal_landmarks, transforms_by_name
from mimesh.evaluate.run import evaluate_command, find_protocol
from mimesh.io.gltf.character import read_rigged_animal
from mimesh.motions.gaits import quadruped_poses, quadruped_takes

KIND = "clips"


def motion(made, seed: int = 0, frames: int = 3):
    return [(random_turns(seed + t, made.order), np.array([0.0, 0.0, 0.1 * t])) for t in range(frames)]


MADE = {"cow": animal(0), "horse": animal(1), "pig": animal(2, bones(3))}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two animals of one skeleton, one with fewer bones, one with other names, and a person."""
    folder = tmp_path_factory.mktemp("animals")
    (folder / "more").mkdir()
    for k, (name, made) in enumerate(MADE.items()):
        path = folder / ("more" if name == "pig" else ".") / f"{name}.glb"
        made.write(path, {"dance": motion(made, 10 * k)}, spell=str)
    animal(3, bones(3)).write(folder / "stranger.glb", spell=lambda name: f"x{name}")
    character(folder / "man.glb")
    return folder


@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_poses_by_name_are_those_of_one_skeleton(scale, folder):
    cow, horse = (read_rigged_animal(folder / f"{name}.glb") for name in ("cow", "horse"))
    assert cow.rig.skeleton == horse.rig.skeleton
    for frame in range(3):
        transforms = cow.clip_transforms("dance", frame)
        by_name = transforms_by_name(cow.rig, horse.rig, transforms, scale)
        expected = transferred_transforms(cow.rig, horse.rig, transforms, scale)
        np.testing.assert_allclose(by_name, expected, atol=1e-9)
        np.testing.assert_allclose(
            transforms_by_name(cow.rig, cow.rig, transforms, 1.0), transforms, atol=1e-9
        )  # fmt: skip


def test_joints_that_the_driving_lacks_rest_in_their_parents(folder):
    cow, pig = (read_rigged_animal(folder / name) for name in ("cow.glb", "more/pig.glb"))
    transforms = transforms_by_name(pig.rig, cow.rig, np.tile(np.eye(4), (len(pig.rig.parents) + 1, 1, 1)), 1.0)
    np.testing.assert_allclose(transforms, np.eye(4)[None] + 0 * transforms, atol=1e-9)
    moved = transforms_by_name(cow.rig, pig.rig, cow.clip_transforms("dance", 1), 1.0)
    assert np.abs(pig.rig.skinned(moved) - pig.rig.mesh.vertices).max() > 0.05
    back = transforms_by_name(pig.rig, cow.rig, moved, 1.0)
    for side in ("Left", "Right"):
        foot, above = (cow.rig.joint_names.index(side + part) for part in ("Fingers", "Hand"))
        np.testing.assert_allclose(back[foot], back[above], atol=1e-9)


def test_the_truth_is_the_shape_of_the_identity_in_the_pose_of_the_driving(folder):
    """As the shipped quadruped says it; pairs are of animals with the same names of joints."""
    protocol = animals(folder)
    protocol.check("val")
    groups = set()
    for i in range(6):
        pair = protocol.unshuffled_pair("val", KIND, i, protocol.rng("val", KIND, i))
        assert len({*pair.groups, "stranger"}) == 3
        groups.add(pair.groups[0])
        identity, driving = (MADE[name] for name in pair.groups)
        frame = int(pair.driving.name[-1])
        turns, _ = motion(driving, 10 * list(MADE).index(pair.groups[1]))[frame]
        turns = {name: turn for name, turn in turns.items() if name in identity.order}
        truth, expected = (vertices - vertices.mean(axis=0) for vertices in (pair.truth, identity.posed(turns)))
        assert np.linalg.norm(truth - expected, axis=1).max() < 0.005 * pair.height
    assert groups == set(MADE)
    assert list(protocol.left_out("val").values()) == [1]


@pytest.mark.parametrize("name", ["cow.glb", "horse.glb", "more/pig.glb"])
def test_landmarks_are_those_of_the_body(name, folder):
    """The roots of some tails have no vertex; no vertex is two landmarks."""
    found = read_rigged_animal(folder / name)
    points = found.rig.mesh.vertices
    marks = find_animal_landmarks(found)
    known = marks[marks >= 0]
    assert len(set(known.tolist())) == len(known) >= len(marks) - 1
    nose, forefeet, hind = points[marks[0]], points[marks[1:3]], points[marks[3:5]]
    height, low = np.ptp(points[:, 1]), points[:, 1].min()
    assert nose[2] > points[:, 2].max() - 0.1 * height
    assert (forefeet[:, 1] < low + 0.15 * height).all()
    assert (hind[:, 1] < low + 0.15 * height).all()
    assert (forefeet[:, 2] - hind[:, 2] > 0.3 * height).all()
    for left, right in (forefeet, hind):
        assert left[0] > 0 > right[0]


def test_animals_are_evaluated(folder):
    report = evaluate_command("animals", ["identity"], split="val", pairs=1, data=folder)
    (row,) = report["results"]
    assert row["pmd_e4"] > 0
    assert row["pairs"] == 1


def test_folders_without_pairs_are_refused(tmp_path):
    with pytest.raises(InputError, match="expected two rigged four-legged animals"):
        animals(tmp_path).check("val")
    animal(0).write(tmp_path / "alone.glb", spell=str)
    animal(1, detached=FEET).write(tmp_path / "other.glb")
    with pytest.raises(InputError, match="expected two rigged four-legged animals"):
        animals(tmp_path / ".").check("test")
    with pytest.raises(InputError, match="--data"):
        find_protocol("animals")


def heights(species):
    """Highest points of the back, of the hips and of the head of a species that stands, over that of the hips."""
    vertices = BODY.posed(np.array(ANIMALS[species].shape), rotvec_to_rotmat(posture(BODY, species)))
    parts = {"back": ("Spine2", "Spine3", "Spine4"), "hips": ("Hips",), "head": ("Head",)}
    own = {part: BODY.weights[:, [BODY.joint(name) for name in names]].sum(axis=1) for part, names in parts.items()}
    top = {part: vertices[weight > 0.5, 1].max() for part, weight in own.items()}
    return {part: top[part] / top["hips"] for part in parts}


def test_species_have_their_proportions():
    horse, lion, camel = (heights(species) for species in ("horse", "lion", "camel"))
    assert camel["back"] > 1.1 > 1.06 > max(horse["back"], lion["back"])
    assert lion["head"] < 1.3 < 1.35 < min(horse["head"], camel["head"])


def test_heads_are_lowered_by_shares():
    half = lowered_head(BODY, 0.5)
    moved = [BODY.joint_names[j] for j in np.flatnonzero(half.any(axis=1))]
    assert set(moved) == set(LOWERED_HEAD)
    np.testing.assert_allclose(2 * half, lowered_head(BODY))
    one = lowered_head(BODY, np.array([1.0, 0.0, 0.0]))
    assert np.degrees(one[BODY.joint("Neck1"), 0]) == pytest.approx(LOWERED_HEAD["Neck1"])
    assert np.count_nonzero(one) == 1


@pytest.mark.slow
def test_poses_are_frames_of_the_takes():
    takes = quadruped_takes(BODY, "val", 10.0)
    assert all(len(take) == 20 for take in takes)
    np.testing.assert_array_equal(np.concatenate(takes), quadruped_poses(BODY, "val"))
    # The same motion at another rate.
    fine = quadruped_takes(BODY, "val", 30.0)
    np.testing.assert_allclose(fine[0][::3], takes[0], atol=1e-6)
