"""Characters of a pool as surfaces on the shipped body's joints: weights, joints, alignment and clips."""

import numpy as np
import pytest
from pools import BLOCKS, blocks, write_character

from mimesh.bodies import load_body
from mimesh.bodies.character_pool import read_character
from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose
from mimesh.core.errors import InputError
from mimesh.learn.data.characters import CharacterSurface, TrainingCharacters, body_spread

BODY = load_body()


def surface(folder, name="hero", **options):
    made = write_character(folder, name, **options)
    return CharacterSurface.of(read_character(folder / f"{name}.npz"), BODY), made


def test_joints_and_weights_are_those_of_the_body(tmp_path):
    """A character that is the body itself, in another unit: joints agree where they are placed, in the body's size."""
    found, made = surface(tmp_path, shape=0, size=50.0)
    limb = np.linalg.norm(made.joints["LeftLeg"] - made.joints["LeftFoot"])
    unit = np.linalg.norm(found.joints[BODY.joint("LeftLeg")] - found.joints[BODY.joint("LeftFoot")]) / limb
    for name in ("LeftArm", "RightLeg", "LeftFoot", "Hips", "Head"):
        offset = made.joints[name] - made.joints["Hips"]
        ours = found.joints[BODY.joint(name)] - found.joints[BODY.joint("Hips")]
        np.testing.assert_allclose(ours, unit * offset, atol=2e-3)
        assert found.placed[BODY.joint(name)]
    assert np.allclose(found.weights.sum(axis=1), 1)
    centred = found.points - found.points.mean(axis=0)
    assert np.isclose(np.sqrt(np.square(centred).sum(-1).mean()), body_spread(BODY), rtol=1e-6)


def test_joints_that_a_character_lacks_go_with_the_nearest_that_it_has(tmp_path):
    found, _ = surface(tmp_path, without=[name for name in BODY.joint_names if name not in BLOCKS], spell=blocks)
    elbow, hand, arm = (BODY.joint(f"Left{part}") for part in ("ForeArm", "Hand", "Arm"))
    assert found.carrier[elbow] == found.carrier[hand] == arm
    assert not found.turning[elbow]
    assert found.turning[arm]
    assert not found.weights[:, [elbow, hand]].any()
    # The elbow of a limb of one joint is in its middle.
    ends = found.joints[[arm, hand]]
    middle = np.linalg.norm(found.joints[elbow] - ends.mean(axis=0)) / np.linalg.norm(ends[1] - ends[0])
    assert middle < 0.1
    assert found.placed[elbow]


def test_the_alignment_turns_the_bodys_limbs_to_those_of_the_character(tmp_path):
    found, _ = surface(tmp_path, shape=3)
    for name, tail in (("LeftArm", "LeftForeArm"), ("RightUpLeg", "RightLeg")):
        ours = BODY.joints[BODY.joint(tail)] - BODY.joints[BODY.joint(name)]
        theirs = found.joints[BODY.joint(tail)] - found.joints[BODY.joint(name)]
        turned = found.alignment[BODY.joint(name)] @ ours
        assert turned @ theirs > 0.9999 * np.linalg.norm(turned) * np.linalg.norm(theirs)


def test_clips_become_poses_of_the_body(tmp_path):
    """The clip was made of poses of the body: every second frame is read back, whatever the joints' own axes."""
    write_character(tmp_path, "hero", shape=0, split="train")
    write_character(tmp_path, "other", shape=1, split="train", clip=False, clips_from="_clips_hero.npz")
    found = TrainingCharacters.read(tmp_path, BODY)
    assert len(found.surfaces) == 2
    poses = rotvec_to_rotmat(found.poses)
    assert len(poses) == 3  # shared clips are taken once
    for t, pose in enumerate(poses):
        true = rotvec_to_rotmat(sample_pose(BODY, 3, 2 * t))
        for name in ("LeftForeArm", "RightLeg", "Head"):
            np.testing.assert_allclose(pose[BODY.joint(name)], true[BODY.joint(name)], atol=0.12)


def test_facts_name_makers_and_licences_and_change_with_the_data(tmp_path):
    write_character(tmp_path, "one", split="train", maker="ann", pack="kit", licence="MIT")
    first = TrainingCharacters.read(tmp_path, BODY).facts
    assert first["makers"] == {"ann: kit (MIT)": 1}
    write_character(tmp_path, "two", shape=1, split="train", maker="bob", pack="set")
    second = TrainingCharacters.read(tmp_path, BODY).facts
    assert second["makers"] == {"ann: kit (MIT)": 1, "bob: set (CC0-1.0)": 1}
    assert first["sha256"] != second["sha256"]
    assert TrainingCharacters.read(tmp_path, BODY).facts == second


def test_a_pool_without_training_characters_is_refused(tmp_path):
    write_character(tmp_path, "one", split="val")
    with pytest.raises(InputError, match="expected humanoids of the split train, found none"):
        TrainingCharacters.read(tmp_path, BODY)
