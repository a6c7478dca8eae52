"""Animals of folders and pools as training surfaces, and a training on them."""

import json

import numpy as np
import pytest
import torch
from animals import BODY, FEET, LEGS, animal, bones, random_turns, write_pool_animal
from pools import write_character
from rigs import character

from mimesh.bodies.character_limbs import SIDES
from mimesh.bodies.character_pool import read_pool
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.options import TrainingFiles
from mimesh.evaluate.character_folder import read_character_folder
from mimesh.learn import checkpoint
from mimesh.learn.data.characters import (
    CharacterSurface,
    TrainingCharacters,
    body_spread,
)
from mimesh.learn.data.endless import pose_sources
from mimesh.learn.start import train_command

TINY = ["data.body=quadruped", "data.characters=0.5", "pairs=16", "batch=8", "validate_every=1000"]
TINY += ["validation_pairs=1", "compile=false", "data.vertices=32", "model.width=32", "precision=fp32"]


def motion(made, seed: int = 0):
    return [(random_turns(seed + t, made.order, 25), np.array([0.0, 0.0, 0.1 * t])) for t in range(6)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two files of a pack, one with fewer bones, a person, and a damaged file."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "farm").mkdir()
    animal(0).write(folder / "farm" / "cow.glb", {"dance": motion(animal(0))})
    made = animal(1, bones(2), ())
    made.write(folder / "farm" / "pig.glb", {"dance": motion(made, 9)})
    (folder / "farm" / "License.txt").write_text("CC0")
    character(folder / "man.glb")
    (folder / "bad.glb").write_bytes(b"glTF\x02\0\0\0")
    return folder


def test_a_folder_has_its_animals_and_says_what_is_left_out(folder):
    pool = read_character_folder(folder, body="quadruped")
    assert [(c.meta.file, c.meta.pack, c.meta.licence) for c in pool.characters] == [
        ("cow", "farm", "License.txt"),
        ("pig", "farm", "License.txt"),
    ]
    assert set(pool.refused) == {"man.glb", "bad.glb"}
    people = read_character_folder(folder)
    assert [c.meta.file for c in people.characters] == ["man"]


def test_a_pool_has_animals_and_people_and_refuses_those_of_another_class(tmp_path):
    write_pool_animal(tmp_path, "cow", animal(0), motion(animal(0)))
    write_pool_animal(tmp_path, "goat", animal(1, detached=FEET), motion(animal(1)), split="test")
    write_character(tmp_path, "man", split="train")
    pool = read_pool(tmp_path, "train", body="quadruped")
    assert [c.meta.file for c in pool.characters] == ["cow"]
    assert [c.meta.file for c in read_pool(tmp_path, "train").characters] == ["man"]
    (goat,) = read_pool(tmp_path, "test", body="quadruped").characters
    assert {"LeftFingers", "RightToes", "Head"} <= set(goat.joints)
    cow = pool.characters[0]
    for t, frame in enumerate(motion(animal(0))):
        np.testing.assert_allclose(cow.rig.skinned(cow.clip_transforms("dance", t)), animal(0).posed(*frame), atol=1e-5)
    arrays = dict(np.load(tmp_path / "cow.npz"))
    arrays["meta"] = np.array(json.dumps(json.loads(str(arrays["meta"])) | {"class": "humanoid"}))
    np.savez(tmp_path / "cow.npz", **arrays)
    pool = read_pool(tmp_path, "train", body="quadruped")
    assert pool.refused == {"cow": "expected a quadruped, found humanoid; leave it out"}


@pytest.mark.parametrize("count", [1, 4])
def test_surfaces_have_the_weights_and_joints_of_the_body(count, tmp_path):
    made = animal(0, bones(count, ("Hips", "Neck1", "Chest", "Head", "Tail1", "Tail3")))
    made.write(tmp_path / "cow.glb", {"dance": motion(made)})
    (found,) = read_character_folder(tmp_path, body="quadruped").characters
    surface = CharacterSurface.of(found, BODY)
    np.testing.assert_allclose(surface.weights.sum(axis=1), 1)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1)
    size = np.sqrt(np.square(surface.points - surface.points.mean(axis=0)).sum(-1).mean())
    assert size == pytest.approx(body_spread(BODY), rel=0.01)
    legs = {side + part for side in SIDES for chain in LEGS.values() for part in chain}
    had = {name for name in legs if surface.turning[BODY.joint(name)]}
    assert had == legs & set(made.order)
    placed = np.array([surface.joints[BODY.joint(name)] for name in made.order if name in had | {"Head", "Neck1"}])
    own = np.array([made.joints[k] for k, name in enumerate(made.order) if name in had | {"Head", "Neck1"}])
    scale = np.linalg.norm(placed) / np.linalg.norm(own)
    np.testing.assert_allclose(placed, scale * own, atol=1e-4)
    for name in had | {"Head", "Neck1"}:
        assert surface.placed[BODY.joint(name)], name
        assert surface.weights[:, BODY.joint(name)].any(), name
    below = BODY.joint("LeftToes")
    assert BODY.joint_names[surface.carrier[below]] == f"Left{LEGS['hind'][count - 1]}"


def test_clips_become_poses_of_the_body(folder):
    found = TrainingCharacters.read(folder, BODY)
    assert found.facts["makers"] == {"not stated: farm (License.txt)": 2}
    assert len(found.poses) > 2
    assert found.poses.shape[1:] == (len(BODY.parents), 3)
    # Posed by them, the body has the legs of the animal in its own frames.
    made = animal(0)
    clip = next(c for c in read_character_folder(folder, body="quadruped").characters if c.meta.file == "cow")
    poses = TrainingCharacters.read(folder, BODY).poses[: (len(clip.clips["dance"]) + 1) // 2]
    for t, pose in zip(range(0, 6, 2), poses, strict=True):
        turns, _ = motion(made)[t]
        rotation, translation = BODY.skinning_transforms(BODY.joints, rotvec_to_rotmat(pose.astype(float)))
        ours = np.einsum("jkl,jl->jk", rotation, BODY.joints) + translation
        moves = made.transforms(turns)
        theirs = np.einsum("jkl,jl->jk", moves[:, :3, :3], made.joints) + moves[:, :3, 3]
        for start, end in (("LeftThigh", "LeftShin"), ("RightForearm", "RightHand"), ("LeftFoot", "LeftToes")):
            one = ours[BODY.joint(end)] - ours[BODY.joint(start)]
            other = theirs[made.order.index(end)] - theirs[made.order.index(start)]
            assert one @ other / np.linalg.norm(one) / np.linalg.norm(other) > np.cos(np.radians(1)), (t, start)


def test_poses_of_training_animals_are_those_of_animals():
    sources = pose_sources(BODY)
    low, high = sources.limits
    assert (low <= high).all()
    assert (sources.usual[0] >= low - np.radians(1)).mean() > 0.95
    assert sources.frames.shape[1:] == BODY.joints.shape
    assert len(sources.contact_shapes) == len(sources.contact_poses) == 0
    lowered = BODY.posed(np.zeros(1), rotvec_to_rotmat(sources.resting))
    head = BODY.weights[:, BODY.joint("Head")] > 0.5
    assert lowered[head, 1].mean() < BODY.vertices[head, 1].mean() - 0.1


@pytest.mark.slow
def test_a_training_on_animals_takes_steps(folder, tmp_path):
    out = train_command("mime", "small", tmp_path / "run", None, 0.001, TINY, None, TrainingFiles(folder))
    state = checkpoint.load(out / "last.safetensors")
    assert state.pairs >= 8
    assert all(torch.isfinite(value).all() for value in state.tensors.values() if value.is_floating_point())
