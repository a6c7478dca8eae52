"""Clip protocols: truth is the identity in the driving motion, splits share no second; trials in one vertex order."""

import dataclasses
import itertools
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from freeze_sets import degrees_to_training
from matrix import matrix
from networks import write_sequence_network
from same_pose import assert_same_pose

from mimesh.core.errors import InputError
from mimesh.evaluate.clip_protocols import (
    CLIPS_ANIFORMER,
    CLIPS_ORDERED,
    SEEN,
    UNSEEN,
)
from mimesh.evaluate.measure import extra_inputs, in_supported_order, run_on
from mimesh.evaluate.metrics import pmd, pmd_aligned, resized
from mimesh.evaluate.pairs import human
from mimesh.motions import load_motion
from mimesh.motions.clips import SPLITS

STREAMS = ("train", "train/motions", "val", "val/actors", "val/motions", "test", "test/actors", "test/motions")
KINDS = CLIPS_ANIFORMER.kinds
EACH_KIND = matrix("kind", KINDS, quick=["unseen", "procedural"])


@cache
def made(kind, i=0):
    """Trial `i` of `test` in the order of the body, and as methods get it (`Protocol.pair`)."""
    rng = CLIPS_ANIFORMER.rng("test", kind, i)
    plain = CLIPS_ANIFORMER.unshuffled_pair("test", kind, i, rng)
    return plain, plain.shuffled(rng)


def test_protocol_has_the_numbers_of_the_paper():
    assert len(CLIPS_ANIFORMER.seen(human())) == sum(SEEN.values()) == 80
    assert len({motion.name for motion in CLIPS_ANIFORMER.seen(human())}) == 80
    assert CLIPS_ANIFORMER.train_motions(human()).shape == (80, 30, 31, 3, 3)
    assert CLIPS_ANIFORMER.train_people(human()).shape == (16, 16)
    assert KINDS == ("seen", "unseen", "procedural")
    assert [CLIPS_ANIFORMER.count(kind) for kind in KINDS] == [24, 20, 20]
    assert [CLIPS_ANIFORMER.count(kind, 80) for kind in KINDS] == [80, 20, 20]
    assert [CLIPS_ANIFORMER.count(kind, 3) for kind in KINDS] == [3, 3, 3]
    # Seen trials use every motion once, and begin with all sources.
    names = [CLIPS_ANIFORMER.motion("test", "seen", i).name for i in range(80)]
    assert len(set(names)) == 80
    assert all(2 <= sum(word in name for name in names[:24]) <= 6 for word in ("mirrored", "walk", "spline"))
    # Eight identities; streams of samples are drawn from seeds of their own.
    assert len({CLIPS_ANIFORMER.seed(stream) for stream in STREAMS}) == len(STREAMS)
    targets = [CLIPS_ANIFORMER.target("val", i)[0].shape for i in range(9)]
    assert len({shape.tobytes() for shape in targets}) == 8


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


def test_motions_that_checkpoints_are_chosen_by_are_later_seconds():
    """They follow the training windows, and are no neighbours of the motions of the table but for walks."""
    seen = np.concatenate([motion.rotmat for motion in CLIPS_ANIFORMER.seen(human())])
    motions = [CLIPS_ANIFORMER.motion("val", "unseen", i) for i in range(14)]
    assert len({motion.name for motion in motions}) == 14
    for motion in motions:
        take, second = motion.name.removesuffix("-mirrored").split("@")
        start = sum(map(float, second.split("+")))
        assert start >= max(stop for name, _, stop in SPLITS["train"] if name == take)
        assert len(motion) == 30
    assert degrees_to_training(np.concatenate([motion.rotmat[::6] for motion in motions]), seen).min() > 1
    splines = [CLIPS_ANIFORMER.motion("val", "procedural", i).rotmat[::6] for i in (1, 3)]
    assert degrees_to_training(np.concatenate(splines), seen).min() > 3


@EACH_KIND
def test_frames_of_the_truth_have_the_vertex_order_of_the_identity(kind):
    """In every frame: `copy` is wrong by the body shape only, a wrong vertex order by far more; the fields of a pair
    are those of the first frame."""
    trial = made(kind)[1]
    assert trial.truth_frames.shape == trial.clip.vertices.shape == trial.aligned_frames.shape == (30, 6890, 3)
    assert trial.clip.fps == 30
    rest = trial.identity.vertices
    for t in (0, 11, 29):
        truth = trial.truth_frames[t]
        assert pmd(resized(trial.aligned_frames[t], truth), truth) < 80e-4
        assert pmd(np.roll(truth, 1, axis=0), truth) > 500e-4
        assert np.median(np.abs(edge_lengths(truth, trial) / edge_lengths(rest, trial) - 1)) < 0.06
        sides = (np.sort(frames[t], axis=0) for frames in (trial.clip.vertices, trial.aligned_frames))
        np.testing.assert_allclose(*sides, atol=1e-12)
    assert np.linalg.norm(np.diff(trial.truth_frames, axis=0), axis=-1).max() < 0.8
    assert np.linalg.norm(trial.truth_frames[0] - trial.truth_frames[-1], axis=-1).max() > 0.05
    np.testing.assert_array_equal(trial.clip.mesh.faces, trial.driving.faces)
    for t, pair in ((0, trial), (7, trial.frame(7))):
        np.testing.assert_array_equal(pair.driving.vertices, trial.clip.vertices[t])
        np.testing.assert_array_equal(pair.truth, trial.truth_frames[t])
        np.testing.assert_array_equal(pair.aligned, trial.aligned_frames[t])
    identity, driving = trial.markers.T
    np.testing.assert_allclose(trial.aligned[identity], trial.driving.vertices[driving], atol=1e-12)
    np.testing.assert_allclose(trial.aligned_reference[identity], trial.reference[driving], atol=1e-12)
    assert pmd(resized(trial.aligned_reference, rest), rest) < 80e-4  # one pose, two people


def edge_lengths(vertices, trial):
    edge = trial.identity.faces[:, :2]
    return np.linalg.norm(np.diff(vertices[edge], axis=1)[:, 0], axis=1)


@EACH_KIND
def test_truth_is_the_identity_in_the_driving_motion(kind):
    """Every limb of every frame has rotated from the identity as the driving person's; another frame does not pass."""
    trial, other = (made(kind, i)[0] for i in range(2))

    def check(truth, t):
        assert_same_pose((trial.identity.vertices, truth), (trial.reference, trial.clip.vertices[t]))

    for t in (0, 10, 29):
        check(trial.truth_frames[t], t)
    for foreign in (trial.truth_frames[15], other.truth_frames[10]):
        with pytest.raises(AssertionError):
            check(foreign, 10)


def test_ordered_protocol_has_the_numbers_of_the_paper():
    assert CLIPS_ORDERED.kinds == ("seen", "unseen")
    assert [CLIPS_ORDERED.count(kind, 80) for kind in CLIPS_ORDERED.kinds] == [80, UNSEEN]
    for kind, count in (("seen", 80), ("unseen", UNSEEN)):
        assert len({CLIPS_ORDERED.motion("test", kind, i).name for i in range(count)}) == count


@matrix("split", ["val", "test"], quick=["val"])
def test_vertex_i_of_driving_and_identity_is_the_same_point(split):
    """Copying by index is wrong by the body shape only, copying in another order by far more."""
    rng = np.random.default_rng(0)
    for kind in CLIPS_ORDERED.kinds:
        trial = CLIPS_ORDERED.pair(split, kind, 1)
        np.testing.assert_array_equal(trial.identity.faces, trial.clip.mesh.faces)
        np.testing.assert_allclose(trial.clip.vertices, trial.aligned_frames, atol=1e-6)
        assert not np.array_equal(trial.identity.faces, human().faces)
        for t in (0, 29):
            driving, truth = trial.clip.vertices[t], trial.truth_frames[t]
            assert pmd_aligned(resized(driving, truth), truth) < 160e-4
            assert pmd_aligned(rng.permutation(driving), truth) > 500e-4


@pytest.mark.slow
def test_driving_people_are_those_of_the_training_and_identities_are_not():
    people = CLIPS_ANIFORMER.train_people(human())
    known = [human().shaped(shape)[0] for shape in people]
    pairs = set()
    for i in (*range(15), 22):  # all of the 16 drive
        trial = CLIPS_ORDERED.unshuffled_pair("test", "seen", i, np.random.default_rng())
        target, driver = int(trial.groups[0]), int(trial.driving.name[2:].partition("_")[0]) - CLIPS_ORDERED.targets
        expected = human().posed(people[driver], CLIPS_ORDERED.motion("test", "seen", i).rotmat[0])
        difference = expected - trial.driving.vertices  # but for where it stands
        np.testing.assert_allclose(difference - difference.mean(axis=0), 0, atol=1e-9)
        pairs.add((target, driver))
    assert len(pairs) == 16
    assert {driver for _, driver in pairs} == set(range(16))
    for split, i in itertools.product(("val", "test"), range(CLIPS_ORDERED.targets)):
        shape = CLIPS_ORDERED.target(split, i)[0].shape
        assert min(np.abs(human().shaped(shape)[0] - other).max() for other in known) > 0.005  # metres


def test_seconds_of_training_val_and_test_are_disjoint():
    def frames(name):
        take, offset = name.removesuffix("-mirrored").split("@")
        first = round(sum(map(float, offset.split("+"))) * 30)
        assert len(load_motion(take)) >= first + 30
        return {(take, t) for t in range(first, first + 30)}

    used = {split: set[tuple[str, int]]() for split in SPLITS}
    for motion in CLIPS_ANIFORMER.seen(human()):
        if "@" in motion.name:
            used["train"] |= frames(motion.name)
    for split, i in itertools.product(("val", "test"), range(UNSEEN)):
        used[split] |= frames(CLIPS_ORDERED.motion(split, "unseen", i).name)
    assert all(not used[a] & used[b] for a, b in itertools.combinations(used, 2))
    for split, taken in used.items():
        assert all(any(name == take and 30 * a <= t < 30 * b for name, a, b in SPLITS[split]) for take, t in taken)


def test_a_split_without_trials_is_refused():
    for protocol in (CLIPS_ANIFORMER, CLIPS_ORDERED):
        protocol.check("test")
        with pytest.raises(InputError, match="without trials"):
            protocol.check("train")


def test_networks_that_pair_by_index_are_measured_here_and_refused_where_vertices_are_shuffled(tmp_path):
    pytest.importorskip("onnx")
    network = str(write_sequence_network(tmp_path / "tiny.onnx", metadata={"pairing": "order"}))
    assert "true correspondence" in extra_inputs(network)
    shuffled, ordered = (p.pair("val", "seen", 0) for p in (CLIPS_ANIFORMER, CLIPS_ORDERED))
    short = dataclasses.replace(
        ordered,
        clip=dataclasses.replace(ordered.clip, vertices=ordered.clip.vertices[:3]),
        truth_frames=ordered.truth_frames[:3],
        aligned_frames=ordered.aligned_frames[:3],
    )
    assert run_on(short, network).vertices.shape == (3, 6890, 3)
    with pytest.raises(InputError, match="other triangles"):
        run_on(shuffled, network)


def test_a_network_with_weights_for_each_vertex_gets_the_order_of_the_body(monkeypatch):
    trial = CLIPS_ORDERED.pair("val", "seen", 1)
    monkeypatch.setattr("mimesh.evaluate.measure.find_model", lambda method: SimpleNamespace(vertices=6890))
    ordered = in_supported_order(trial, "any.onnx")
    plain = CLIPS_ORDERED.unshuffled_pair("val", "seen", 1, CLIPS_ORDERED.rng("val", "seen", 1))
    for field in ("truth_frames", "aligned_frames"):
        np.testing.assert_array_equal(getattr(ordered, field), getattr(plain, field))
    np.testing.assert_array_equal(ordered.clip.vertices, plain.clip.vertices)
    np.testing.assert_array_equal(ordered.identity.vertices, plain.identity.vertices)
    assert CLIPS_ANIFORMER.pair("val", "seen", 1).place is None
