"""Folders of rigged files to train on: packs, licences, clips, and files that cannot be read."""

import numpy as np
import pytest
import rigs
from motion_files import write_bvh
from pools import write_character

from mimesh.bodies import load_body
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.errors import InputError
from mimesh.evaluate.character_folder import read_character_folder
from mimesh.learn.data.characters import LEAST_TURN, LEVELS, TrainingCharacters, TrainingClips, distinct_poses, possible
from mimesh.motions import load_motion
from mimesh.motions.procedural import walk_motion

BODY = load_body()


def test_a_folder_of_files_and_a_pool_in_one(tmp_path):
    """Sub-folders are packs, licence files are quoted, bad files are counted, other splits are left out."""
    write_character(tmp_path, "hero", split="train", pack="ours")
    write_character(tmp_path, "judge", split="test", pack="ours")
    for folder in ("kit/models", "other"):
        (tmp_path / folder).mkdir(parents=True)
    rigs.character(tmp_path / "kit" / "models" / "one.glb")
    rigs.character(tmp_path / "kit" / "judge.glb")
    rigs.character(tmp_path / "other" / "two.gltf", shape=1)
    (tmp_path / "kit" / "License.txt").write_text("CC0")
    (tmp_path / "kit" / "bad.glb").write_bytes(b"glTF\x02\0\0\0")
    rigs.character(tmp_path / "other" / "names.glb", name=lambda name: f"x{BODY.joint(name)}")
    done = []
    found = TrainingCharacters.read(tmp_path, BODY, progress=lambda *counts: done.append(counts))
    assert found.facts["makers"] == {
        "we: ours (CC0-1.0)": 1,
        "not stated: kit (License.txt)": 1,
        "not stated: other (not stated)": 1,
    }
    assert done[4] == (5, 5)
    assert sorted(found.refused.values()) == [1, 1, 1]
    told = found.described()
    assert "1 refused: kit/judge.glb: expected one of the split train, found the split test of the index" in told
    assert "expected a thigh and an upper arm" in told
    assert str(tmp_path) not in told


def test_a_surface_of_a_file_is_that_of_the_same_character_in_a_pool(tmp_path):
    for folder in ("pool", "files"):
        (tmp_path / folder).mkdir()
    write_character(tmp_path / "pool", "hero", split="train", clip=False)
    rigs.character(tmp_path / "files" / "hero.glb")
    ours, theirs = (TrainingCharacters.read(tmp_path / folder, BODY).surfaces[0] for folder in ("files", "pool"))
    for name in ("joints", "alignment", "weights", "points"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=2e-3)


def test_a_pack_can_be_left_out(tmp_path):
    write_character(tmp_path, "one", split="train", pack="kit")
    write_character(tmp_path, "two", shape=1, split="train", pack="set")
    found = TrainingCharacters.read(tmp_path, BODY, leave_out=("kit",))
    assert [surface.pack for surface in found.surfaces] == ["set"]
    assert found.facts["left_out"] == {"kit": 1}
    assert "1 of the pack kit left out" in found.described()
    with pytest.raises(InputError, match=r"--leave-out box: expected a pack of .* \(kit, set\)"):
        TrainingCharacters.read(tmp_path, BODY, leave_out=("box",))


def test_an_empty_folder_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected a folder of rigged characters"):
        read_character_folder(tmp_path)


def test_low_poly_points_lie_on_few_flat_triangles(tmp_path):
    rigs.character(tmp_path / "hero.glb", faces=3000)
    surface = TrainingCharacters.read(tmp_path, BODY, low_poly=True).surfaces[0]
    assert surface.coarse is not None
    for (points, normals), count in zip(surface.coarse, LEVELS, strict=True):
        assert len(np.unique(normals.round(6), axis=0)) <= count
        assert np.median(np.linalg.norm(points - surface.points, axis=1)) < 0.06
        assert ((normals * surface.normals).sum(axis=1) > 0).mean() > 0.95


def test_clips_of_a_folder_become_poses_without_those_held_out(tmp_path):
    walk = walk_motion(BODY, 0, 0)
    write_bvh(tmp_path / "walk.bvh", BODY, walk)
    write_bvh(tmp_path / "01_03.bvh", BODY, walk)
    (tmp_path / "bad.bvh").write_text("HIERARCHY\nROOT")
    found = TrainingClips.read(tmp_path, BODY)
    assert found.facts["makers"] == {f"not stated: {tmp_path.name} (not stated)": 1}
    assert found.refused["01_03.bvh, 01_03.bvh"] == "held out for evaluation"
    assert len(found.refused) == 2
    assert len(found.poses) == found.facts["poses"] > 10
    thighs = found.poses[:, BODY.joint("LeftUpLeg")]
    assert np.ptp(thighs[:, 0]) > 0.3
    (tmp_path / "walk.bvh").unlink()
    with pytest.raises(InputError, match="expected clips of people"):
        TrainingClips.read(tmp_path, BODY)


def test_poses_that_a_person_cannot_take_and_repeated_ones_are_left_out():
    motion = load_motion("walk")
    taken = distinct_poses(motion)
    assert 1 < len(taken) <= len(motion)
    angles = np.arccos(
        ((np.trace(np.swapaxes(taken[:-1], -1, -2) @ taken[1:], axis1=-2, axis2=-1) - 1) / 2).clip(-1, 1)
    )
    assert angles.max(axis=1).min() >= LEAST_TURN - 1e-6
    off = np.zeros((2, len(BODY.parents), 3))
    off[1, BODY.joint("Head"), 0] = 2.5
    assert possible(rotvec_to_rotmat(off), BODY.joint_names).tolist() == [True, False]
