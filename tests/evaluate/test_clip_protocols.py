"""Clip protocol: truth is the identity in the driving motion, splits are disjoint, the test set is fixed."""

import itertools
from functools import cache

import numpy as np
import pytest
from deepmimic_files import write_folder
from freeze_sets import degrees_to_training, training_poses
from held_out_files import SHORT, write_takes
from matrix import matrix
from same_pose import assert_same_pose

from mimesh.bodies.sampling import sample_shape
from mimesh.core.errors import InputError
from mimesh.evaluate.clip_protocols import (
    ANIMATED,
    BOXING_SECONDS,
    CLIPS_ANIFORMER,
    GAITS,
    ORDER,
    SEEN,
    STRESS,
    TAKES,
    clips_aniformer,
    is_held_out,
)
from mimesh.evaluate.frozen_sets import frozen_sets
from mimesh.evaluate.metrics import pmd, resized
from mimesh.evaluate.pairs import human
from mimesh.motions import load_motion, resample, spline_motion
from mimesh.motions.clips import SPLITS
from mimesh.motions.deepmimic import CLIPS

STREAMS = ("train", "train/motions", "val", "val/actors", "val/motions", "test", "test/actors", "test/motions")
KINDS = CLIPS_ANIFORMER.kinds
GOLDEN = {
    "seen": (264930.065593, 282286.203755),
    "held-out": (326174.474971, 315359.066483),
    "stress": (346027.344300, 292397.494547),
    "procedural": (300780.210840, 286580.716474),
}
"""Sums over the coordinates of truth and driving clip (metres) of the first test trial.

Those of `held-out` and `stress` are for the files that this test writes.
"""


EACH_KIND = matrix("kind", KINDS, quick=["held-out", "procedural"])


@cache
def trial_of(protocol, kind):
    return protocol.pair("test", kind, 0)


@pytest.fixture(scope="module")
def protocol(motions):
    return clips_aniformer(motions)


def test_protocol_has_the_numbers_of_the_paper():
    assert len(CLIPS_ANIFORMER.seen(human())) == sum(SEEN.values()) == 80
    assert len({motion.name for motion in CLIPS_ANIFORMER.seen(human())}) == 80
    assert CLIPS_ANIFORMER.train_motions(human()).shape == (80, 30, 31, 3, 3)
    assert CLIPS_ANIFORMER.train_people(human()).shape == (16, 16)
    assert KINDS == ("seen", "held-out", "procedural", "stress")
    assert [CLIPS_ANIFORMER.count(kind) for kind in KINDS] == [24, 30, 20, 13]
    assert [CLIPS_ANIFORMER.count(kind, 80) for kind in KINDS] == [80, 30, 20, 13]
    assert [CLIPS_ANIFORMER.count(kind, 80, "val") for kind in KINDS] == [80, 7, 20, 13]
    assert [CLIPS_ANIFORMER.count(kind, 3) for kind in KINDS] == [3, 3, 3, 3]


def test_motions_are_rotations_that_begin_at_the_origin_facing_front():
    rotmat = CLIPS_ANIFORMER.train_motions(human())
    root = np.stack([motion.root for motion in CLIPS_ANIFORMER.seen(human())])
    np.testing.assert_allclose(np.linalg.det(rotmat[:, ::10]), 1, atol=1e-9)
    np.testing.assert_array_equal(root[:, 0, [0, 2]], 0)
    front = rotmat[:, 0, 0, :, 2]
    np.testing.assert_allclose(front[:, 0], 0, atol=1e-12)
    assert front[:, 2].min() > 0
    assert np.linalg.norm(np.diff(root, axis=1), axis=-1).max() < 0.2  # metres per frame: no jumps


def test_seconds_are_disjoint_windows_of_the_training_takes():
    """Every second equals its window of its take, and no frame is used twice."""
    used = set()
    for motion in CLIPS_ANIFORMER.seen(human())[: SEEN["seconds"]]:
        take, offset = motion.name.split("@")
        first = round(sum(map(float, offset.split("+"))) * 30)
        np.testing.assert_array_equal(motion.rotmat[:, 1:], load_motion(take).rotmat[first : first + 30, 1:])
        assert any(name == take and 30 * a <= first <= 30 * b - 30 for name, a, b in SPLITS["train"])
        frames = {(take, t) for t in range(first, first + 30)}
        assert not frames & used
        used |= frames


def test_seen_trials_use_every_motion_once_and_begin_with_all_sources():
    names = [CLIPS_ANIFORMER.motion("test", "seen", i).name for i in range(80)]
    assert len(set(names)) == 80
    by_source = [[n for n in names[:24] if word in n] for word in ("mirrored", "walk", "spline")]
    assert all(2 <= len(found) <= 6 for found in by_source)


@EACH_KIND
def test_frames_of_the_truth_have_the_vertex_order_of_the_identity(protocol, kind):
    """In every frame: `copy` is wrong by the body shape only, a wrong vertex order by far more."""
    trial = trial_of(protocol, kind)
    assert trial.truth_frames.shape == trial.clip.vertices.shape == trial.aligned_frames.shape == (30, 6890, 3)
    assert trial.clip.fps == 30
    for t in (0, 11, 29):
        truth = trial.truth_frames[t]
        assert pmd(resized(trial.aligned_frames[t], truth), truth) < 80e-4
        assert pmd(np.roll(truth, 1, axis=0), truth) > 500e-4
        assert np.median(np.abs(edge_lengths(truth, trial) / edge_lengths(trial.identity.vertices, trial) - 1)) < 0.06
        np.testing.assert_allclose(
            np.sort(trial.clip.vertices[t], axis=0), np.sort(trial.aligned_frames[t], axis=0), atol=1e-12
        )
    assert np.linalg.norm(np.diff(trial.truth_frames, axis=0), axis=-1).max() < 0.8
    assert np.linalg.norm(trial.truth_frames[0] - trial.truth_frames[-1], axis=-1).max() > 0.05


@EACH_KIND
def test_truth_is_the_identity_in_the_driving_motion(protocol, kind):
    """Every limb of every frame has rotated from the identity as the driving person's; another frame does not pass."""
    trial = protocol.unshuffled_pair("test", kind, 1, np.random.default_rng(0))

    def check(truth, t):
        assert_same_pose((trial.identity.vertices, truth), (trial.reference, trial.clip.vertices[t]))

    for t in range(0, 30, 4):
        check(trial.truth_frames[t], t)
    with pytest.raises(AssertionError):
        check(trial.truth_frames[15], 10)
    other = protocol.unshuffled_pair("test", kind, 2, np.random.default_rng(0))
    with pytest.raises(AssertionError):
        check(other.truth_frames[10], 10)


@EACH_KIND
def test_fields_of_a_pair_are_those_of_the_first_frame(protocol, kind):
    trial = trial_of(protocol, kind)
    np.testing.assert_array_equal(trial.driving.vertices, trial.clip.vertices[0])
    np.testing.assert_array_equal(trial.clip.mesh.faces, trial.driving.faces)
    np.testing.assert_array_equal(trial.truth, trial.truth_frames[0])
    np.testing.assert_array_equal(trial.aligned, trial.aligned_frames[0])
    later = trial.frame(7)
    np.testing.assert_array_equal(later.driving.vertices, trial.clip.vertices[7])
    np.testing.assert_array_equal(later.truth, trial.truth_frames[7])
    identity, driving = trial.markers.T
    np.testing.assert_allclose(trial.aligned[identity], trial.driving.vertices[driving], atol=1e-12)
    np.testing.assert_allclose(trial.aligned_reference[identity], trial.reference[driving], atol=1e-12)
    rest = trial.identity.vertices
    assert pmd(resized(trial.aligned_reference, rest), rest) < 80e-4  # one pose, two people


def edge_lengths(vertices, trial):
    edge = trial.identity.faces[:, :2]
    return np.linalg.norm(np.diff(vertices[edge], axis=1)[:, 0], axis=1)


def test_identities_are_eight_and_driving_people_new():
    seeds = [CLIPS_ANIFORMER.seed(stream) for stream in STREAMS]
    assert len(set(seeds)) == len(STREAMS)
    first = [sample_shape(human(), seed, 0) for seed in seeds]
    assert all(not np.allclose(a, b) for a, b in itertools.combinations(first, 2))
    first_trial, ninth_trial = (CLIPS_ANIFORMER.pair("val", "seen", i) for i in (0, 8))
    assert first_trial.height == ninth_trial.height
    assert not np.allclose(np.ptp(first_trial.clip.vertices[0], axis=0), np.ptp(ninth_trial.clip.vertices[0], axis=0))


def test_motions_that_checkpoints_are_chosen_by_are_later_seconds_and_need_no_folder():
    """They follow the training windows, and are no neighbours of the motions of the table but for walks."""
    assert CLIPS_ANIFORMER.validation_kinds == ("seen", "unseen", "procedural")
    seen = np.concatenate([motion.rotmat for motion in CLIPS_ANIFORMER.seen(human())])
    motions = [CLIPS_ANIFORMER.motion("val", "unseen", i) for i in range(14)]
    assert len({motion.name for motion in motions}) == 14
    for motion in motions:
        take, second = motion.name.removesuffix("-mirrored").split("@")
        start = sum(map(float, second.split("+")))
        assert start >= max(stop for name, _, stop in SPLITS["train"] if name == take)
        assert len(motion) == 30
    assert degrees_to_training(np.concatenate([motion.rotmat for motion in motions]), seen).min() > 1
    splines = [CLIPS_ANIFORMER.motion("val", "procedural", i).rotmat for i in (1, 3)]
    assert degrees_to_training(np.concatenate(splines), seen).min() > 3


def test_held_out_and_stress_motions_are_the_middle_second_of_whole_clips(protocol):
    """DeepMimic's are divided between `val` and the stress test; those of `test` are of other files."""
    assert sorted((*GAITS, *STRESS)) == sorted(CLIPS)
    for split, kind, names in (("val", "held-out", GAITS), ("test", "stress", STRESS), ("val", "stress", STRESS)):
        motions = [protocol.motion(split, kind, i) for i in range(len(names))]
        assert [motion.name for motion in motions] == list(names)
        assert {(len(motion), motion.fps) for motion in motions} == {(30, 30.0)}
    motions = [protocol.motion("test", "held-out", i) for i in range(30)]
    clips = [clip for clips in ANIMATED.values() for clip in clips]
    assert sorted(motion.name for motion in motions) == sorted([*clips, *(f"boxing@{s}" for s in BOXING_SECONDS)])
    assert {(len(motion), motion.fps) for motion in motions} == {(30, 30.0)}
    assert [TAKES[k][0] == "Boxing_Toes.bvh" for k in ORDER[:6]] == [False, False, True] * 2


def test_held_out_motions_are_those_of_the_files(protocol):
    """The files hold generated motions; their rotations come back, from the middle of each clip."""
    names = [TAKES[k][1] for k in ORDER]
    source = spline_motion(human(), 8, 0, seconds=1.5, fps=30.0)
    assert rotation_error(protocol.motion("test", "held-out", names.index("Walking_A")), source.rotmat[7:37]) < 0.5
    short = spline_motion(human(), 8, list(ANIMATED["Med_MovementBasic.glb"]).index(SHORT), seconds=0.7, fps=30.0)
    slowed = protocol.motion("test", "held-out", names.index(SHORT))
    assert rotation_error(slowed, short.rotmat[[0, -1]], [0, -1]) < 0.5
    boxing = resample(spline_motion(human(), 7, 0, seconds=20.1, fps=10.0), 30.0)
    assert rotation_error(protocol.motion("test", "held-out", names.index("4")), boxing.rotmat[120:150]) < 0.5


def rotation_error(motion, expected, frames=slice(None)):
    """Largest angle (degrees) of the limbs and the trunk from the expected rotations; the heading begins at 0."""
    joints = [human().joint(side + name) for side in ("Left", "Right") for name in ("UpLeg", "Leg", "Arm", "ForeArm")]
    trace = np.einsum("tjab,tjab->tj", motion.rotmat[frames][:, joints], expected[:, joints])
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1))).max()


def test_training_can_leave_out_held_out_clips_and_their_variants():
    assert all(is_held_out(f"Rig_Medium|{clip}") for clips in ANIMATED.values() for clip in clips)
    assert all(map(is_held_out, ("Jump_Land", "Running_Strafe_Right", "Ranged_Bow_Draw_Up", "Skeletons_Walking")))
    assert not any(map(is_held_out, ("Rig_Medium|Crawling", "Melee_2H_Attack_Chop", "Ranged_Magic_Raise")))


def test_stored_distances_of_held_out_motions_are_those_of_other_takes():
    """The nearest training frame of a held-out frame is further than any of 19 in 20 pairs of neighbouring frames."""
    stored = {key[1:]: entry.degrees_to_training for key, entry in frozen_sets().items() if key[0] == "clips-aniformer"}
    bank = training_poses()
    step = [degrees_to_training(bank[t : t + 1], bank[t + 1 : t + 2])[0] for t in range(0, 400, 10)]
    neighbours = float(np.median(step))
    assert 1 < neighbours < 2.5
    assert stored["test", "seen"] == (0, 0)
    assert stored["val", "held-out"][0] > 2 * neighbours
    assert stored["test", "held-out"][0] > 3 * neighbours
    assert stored["test", "held-out"][1] > 10


def test_missing_data_are_reported_before_measuring(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for split in ("val", "test"):
        with pytest.raises(InputError, match="DeepMimic clips: expected a folder or an installed pybullet"):
            CLIPS_ANIFORMER.check(split)
    with pytest.raises(InputError, match="expected val or test"):
        CLIPS_ANIFORMER.check("train")
    with pytest.raises(InputError, match="expected the 20 human clips"):
        clips_aniformer(tmp_path)
    write_folder(tmp_path / "some" / "motions")
    protocol = clips_aniformer(tmp_path)
    protocol.check("val")
    message = r"found no Boxing_Toes\.bvh and 6 others; .* Debian package assimp-testmodels"
    with pytest.raises(InputError, match=message):
        protocol.check("test")
    write_takes(tmp_path / "takes")
    protocol.check("test")


@matrix("kind", GOLDEN, quick=["held-out"])
def test_first_trials_of_files_are_as_published(protocol, kind):
    trial = trial_of(protocol, kind)
    sums = [np.abs(trial.truth_frames).sum(), np.abs(trial.clip.vertices).sum()]
    assert np.allclose(sums, GOLDEN[kind], rtol=1e-7), sums
