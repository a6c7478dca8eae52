"""Clips in one vertex order: aligned trials, driving people of the training, and splits that share no second."""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from matrix import matrix
from networks import write_sequence_network

from mimesh.core.errors import InputError
from mimesh.evaluate.clip_protocols import CLIPS_ANIFORMER, CLIPS_ORDERED, UNSEEN, clips_ordered
from mimesh.evaluate.measure import extra_inputs, on_supported_vertices, run_on_clip
from mimesh.evaluate.metrics import pmd_aligned, resized
from mimesh.evaluate.pairs import human
from mimesh.motions import load_motion
from mimesh.motions.clips import SPLITS

KINDS = CLIPS_ORDERED.kinds


@pytest.fixture(scope="module")
def with_files(motions):
    return clips_ordered(motions)


def test_protocol_has_the_numbers_of_the_paper():
    assert KINDS == CLIPS_ORDERED.validation_kinds == ("seen", "unseen")
    assert [CLIPS_ORDERED.count(kind, 80) for kind in KINDS] == [80, UNSEEN]
    for kind, count in (("seen", 80), ("unseen", UNSEEN)):
        assert len({CLIPS_ORDERED.motion("test", kind, i).name for i in range(count)}) == count


@matrix("split", ["val", "test"], quick=["val"])
def test_vertex_i_of_driving_and_identity_is_the_same_point(with_files, split):
    """Copying by index is wrong by the body shape only, copying in another order by far more."""
    rng = np.random.default_rng(0)
    for kind in with_files.kinds:
        trial = with_files.pair(split, kind, 1)
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
    for i in range(40):
        trial = CLIPS_ORDERED.unshuffled_pair("test", "seen", i, np.random.default_rng())
        target, driver = int(trial.groups[0]), int(trial.driving.name[2:].partition("_")[0]) - CLIPS_ORDERED.targets
        expected = human().posed(people[driver], CLIPS_ORDERED.motion("test", "seen", i).rotmat[0])
        difference = expected - trial.driving.vertices  # but for where it stands
        np.testing.assert_allclose(difference - difference.mean(axis=0), 0, atol=1e-9)
        pairs.add((target, driver))
    assert len(pairs) == 40
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


def test_files_are_needed_for_held_out_motions_alone(tmp_path):
    CLIPS_ORDERED.check("val")
    CLIPS_ORDERED.check("test")
    with pytest.raises(InputError, match="without trials"):
        CLIPS_ORDERED.check("train")
    for split in ("val", "test"):
        with pytest.raises(InputError, match="expected"):
            clips_ordered(tmp_path).check(split)


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
    assert run_on_clip(short, network).vertices.shape == (3, 6890, 3)
    with pytest.raises(InputError, match="other triangles"):
        run_on_clip(shuffled, network)


def test_a_network_with_weights_for_each_vertex_gets_the_order_of_the_body(monkeypatch):
    trial = CLIPS_ORDERED.pair("val", "seen", 1)
    monkeypatch.setattr("mimesh.evaluate.measure.find_method", lambda method: SimpleNamespace(vertices=6890))
    ordered = on_supported_vertices(trial, "any.onnx")
    plain = CLIPS_ORDERED.unshuffled_pair("val", "seen", 1, CLIPS_ORDERED.rng("val", "seen", 1))
    for field in ("truth_frames", "aligned_frames"):
        np.testing.assert_array_equal(getattr(ordered, field), getattr(plain, field))
    np.testing.assert_array_equal(ordered.clip.vertices, plain.clip.vertices)
    np.testing.assert_array_equal(ordered.identity.vertices, plain.identity.vertices)
    assert CLIPS_ANIFORMER.pair("val", "seen", 1).place is None
