"""Test sets: splits are disjoint, truth and extra inputs are aligned, pairs are a pure function of the seed."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from animals import BODY as ANIMAL
from freeze_sets import degrees_to_training, training_poses
from matrix import matrix
from same_pose import assert_same_pose
from scipy.spatial import KDTree

from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose
from mimesh.evaluate.metrics import pmd, resized
from mimesh.evaluate.pairs import human
from mimesh.evaluate.protocols import (
    CONTACT,
    CROSS_TOPOLOGY,
    HUMAN_NPT,
    NOISE,
    PROTOCOLS,
    QUADRUPED,
    Corrupted,
    split_pose_bank,
)
from mimesh.motions.clips import SPLITS

CASES = [(p, kind) for p in PROTOCOLS.values() for kind in p.kinds]
ENDS = [(p, kind) for p in PROTOCOLS.values() for kind in {p.kinds[0]: 0, p.kinds[-1]: 0}]
ALL_KINDS = matrix(("protocol", "kind"), CASES, quick=ENDS, ids=lambda value: getattr(value, "name", value))
CONTACTS = {
    "hands": (10760.831315, 13646.390544),
    "arms": (9563.491196, 9646.980536),
    "legs": (10240.466601, 11426.337790),
}
"""Sums over the coordinates of truth and driving (metres) of the first pair of each test set."""
BODY = 6890
"""Vertices of the plain body; garments come after them."""


@cache
def made(protocol, kind, i=0, split="val"):
    """Pair `i` with its vertices in the order of the body, and as methods get it (`Protocol.pair`)."""
    rng = protocol.rng(split, kind, i)
    plain = protocol.unshuffled_pair(split, kind, i, rng)
    return plain, plain.shuffled(rng)


def edge_lengths(vertices, faces):
    return np.linalg.norm(np.diff(vertices[faces[:, :2]], axis=1)[:, 0], axis=1)


@pytest.mark.slow
@ALL_KINDS
def test_truth_and_extra_inputs_are_aligned(protocol, kind):
    """A wrong order is wrong by far more than another person, and tears edges; markers are corresponding vertices; the
    third mesh is the driving person in the identity's pose."""
    plain, pair = made(protocol, kind)
    aligned = pmd(resized(pair.aligned, pair.truth), pair.truth)
    wrong = pmd(np.roll(pair.truth, 1, axis=0), pair.truth)
    assert aligned < 80e-4 < 500e-4 < wrong
    old, new = (edge_lengths(vertices, pair.identity.faces) for vertices in (pair.identity.vertices, pair.truth))
    assert np.median(np.abs(new / old - 1)) < 0.06
    for name in ("truth", "aligned"):
        np.testing.assert_array_equal(*(np.sort(getattr(p, name), axis=0) for p in (plain, pair)))
    assert pair.markers.shape == (13, 2)
    identity, driving = pair.markers[pair.markers[:, 1] >= 0].T
    assert (pair.markers[:, 1] >= 0).all() or kind in ("holes", "cropped", "half")
    distance = np.linalg.norm(pair.aligned[identity] - pair.driving.vertices[driving], axis=1)
    assert np.median(distance) < 0.05
    assert pair.reference.shape == pair.driving.vertices.shape
    if pair.aligned_reference is not None:
        around = np.linalg.norm(pair.aligned_reference[identity] - pair.reference[driving], axis=1)
        assert np.median(around) < 0.05
    own_vertices = protocol not in (CROSS_TOPOLOGY, NOISE) or kind.startswith("noise-")
    assert (pair.aligned_reference is not None) == own_vertices
    if len(pair.driving.faces) and not kind.startswith("noise-"):
        old, new = (edge_lengths(vertices, pair.driving.faces) for vertices in (pair.reference, pair.driving.vertices))
        assert np.median(np.abs(new / old - 1)) < 0.05


def check_pose(protocol, kind, i, pair):
    """Assert that truth and driving mesh of an unshuffled pair are in one pose, whatever the driving mesh lacks."""
    clean = pair
    if isinstance(protocol, Corrupted):
        clean = protocol.clean_pair("val", i)
        # The driving mesh is the clean one with other vertices (some centimetres apart) or noise (10 cm at most).
        distance = KDTree(clean.driving.vertices).query(pair.driving.vertices)[0]
        assert distance.max() < 0.12
    persons = ((pair.identity.vertices, pair.truth), (clean.reference, clean.driving.vertices))
    assert_same_pose(*(tuple(vertices[:BODY] for vertices in person) for person in persons))


@ALL_KINDS
def test_truth_is_the_identity_in_the_driving_pose(protocol, kind):
    """Every limb of the truth has rotated from the identity as the driving person's from the third mesh; no other truth
    or driving mesh passes."""
    pairs = [made(protocol, kind, i)[0] for i in range(2)]
    for i, pair in enumerate(pairs):
        check_pose(protocol, kind, i, pair)
        foreign = pairs[1 - i]
        if len(foreign.truth) == len(pair.truth):
            with pytest.raises(AssertionError):
                check_pose(protocol, kind, i, dataclasses.replace(pair, truth=foreign.truth))
        with pytest.raises(AssertionError):
            check_pose(protocol, kind, i, dataclasses.replace(pair, driving=foreign.driving))


def test_splits_have_different_seeds_and_people():
    """People and poses are drawn from the seed of the split (and the kind), so two splits share none."""
    protocols = (*PROTOCOLS.values(), QUADRUPED)
    assert len({p.seed(split) for p in protocols for split in SPLITS}) == len(protocols) * len(SPLITS)
    for protocol in protocols:
        # Before the shuffle the vertices of the plain body come first; garments may differ.
        val, test = (made(protocol, protocol.kinds[-1], 0, split)[0].truth[:BODY] for split in ("val", "test"))
        assert not np.allclose(val, test, atol=1e-3)


def test_motions_of_the_splits_are_later_seconds_of_the_takes():
    """Those of `test` begin 3 s after the last training frame; those of `val` follow it."""
    for split, gap in (("val", 0.0), ("test", 3.0)):
        for take, start, stop in SPLITS[split]:
            assert start < stop
            for other in SPLITS.keys() - {split}:
                assert all(start >= b or stop <= a for name, a, b in SPLITS[other] if name == take)
            assert start >= max(b for name, _, b in SPLITS["train"] if name == take) + gap


@pytest.mark.slow
@matrix("split", ["val", "test"], quick=["test"])
def test_poses_of_a_split_are_not_neighbours_of_training_frames(split):
    """Frames 1/30 s apart differ by 0.2 to 4 degrees (median 1.3 and 1.7 of the two takes); these by more."""
    poses = rotvec_to_rotmat(split_pose_bank(split).astype(np.float64))
    angle = degrees_to_training(poses)
    assert angle.min() > 1
    assert np.median(angle) > 3.5
    bank = rotvec_to_rotmat(split_pose_bank("train").astype(np.float64))
    assert degrees_to_training(bank[:3]).max() < 0.1  # 16-bit numbers


def test_angle_to_training_is_that_of_the_nearest_pose_whatever_its_heading():
    bank = training_poses()
    turned = bank[100].copy()
    turned[0] = rotvec_to_rotmat(np.array([0.0, 2.0, 0.0])) @ turned[0]
    bent = turned.copy()
    bent[5] = bent[5] @ rotvec_to_rotmat(np.array([0.0, 0.0, np.radians(3.1)]))
    exact, near = degrees_to_training(np.stack([turned, bent]), bank[100:101])
    assert exact < 0.05
    assert abs(near - 3.1 / 31) < 0.05


def test_human_npt_has_the_numbers_of_the_paper():
    assert len(HUMAN_NPT.train_people(human())) == 16
    assert len(HUMAN_NPT.train_poses(human())) == 400
    assert (HUMAN_NPT.new_people, HUMAN_NPT.pairs) == (14, 72)


def test_seen_poses_are_training_poses():
    train = HUMAN_NPT.train_poses(human())
    pair = HUMAN_NPT.pair("test", "seen", 0)
    rng = np.random.default_rng(np.random.SeedSequence([HUMAN_NPT.seed("test"), True, 0]))
    rng.choice(HUMAN_NPT.new_people, 2, replace=False)
    pose = train[rng.choice(HUMAN_NPT.poses, 2, replace=False)[1]]
    index = int(np.flatnonzero((train == pose).all((1, 2)))[0])
    np.testing.assert_array_equal(pose, sample_pose(human(), HUMAN_NPT.seed("train"), index))
    span = np.ptp(human().posed(np.zeros(1), rotvec_to_rotmat(pose))[:, 1])
    assert abs(np.ptp(pair.truth[:, 1]) / span - 1) < 0.35
    unseen = HUMAN_NPT.pair("test", "unseen", 0)
    assert not np.allclose(pair.truth[:10], unseen.truth[:10])


def test_noise_has_the_amplitude_of_its_kind():
    clean = NOISE.clean_pair("val", 0).driving.vertices
    radius = np.linalg.norm(clean - clean.mean(axis=0), axis=1).max()
    for percent in (0, 1, 5):
        noisy = made(NOISE, f"noise-{percent}")[0]
        largest = np.abs(noisy.driving.vertices - clean).max() / radius
        assert 0.99 * percent / 100 <= largest <= percent / 100 * (1 + 1e-12)


@pytest.mark.parametrize("protocol", [NOISE, CROSS_TOPOLOGY], ids=lambda protocol: protocol.name)
def test_corrupted_kinds_share_people_and_poses(protocol):
    pairs = [made(protocol, kind)[1] for kind in (protocol.kinds[0], protocol.kinds[-1])]
    for arrays in ([pair.identity.vertices for pair in pairs], [pair.truth for pair in pairs]):
        first, *others = (np.sort(array, axis=0) for array in arrays)
        assert all(np.array_equal(first, other) for other in others)


@matrix("kind", CONTACTS, quick=["hands"])
def test_first_pairs_of_contacts_are_the_published_ones(kind):
    """Contacts are solved iteratively to a tolerance, so they depend on the libraries; other sets are frozen."""
    pair = CONTACT.pair("test", kind, 0)
    sums = [np.abs(pair.truth).sum(), np.abs(pair.driving.vertices).sum()]
    assert np.allclose(sums, CONTACTS[kind], rtol=1e-3)


@matrix("kind", QUADRUPED.kinds, quick=QUADRUPED.kinds[:1])
def test_truths_are_animals_in_other_poses_and_shapes(kind):
    for i in range(2):
        pair, shuffled = made(QUADRUPED, kind, i)
        identity, driving = shuffled.markers.T  # for deformation transfer, which gets the driving animal at rest
        np.testing.assert_allclose(shuffled.aligned[identity], shuffled.driving.vertices[driving], atol=1e-12)
        np.testing.assert_allclose(shuffled.aligned_reference[identity], shuffled.reference[driving], atol=1e-12)
        assert pair.truth.shape == pair.identity.vertices.shape == ANIMAL.vertices.shape
        assert np.isfinite(pair.truth).all()
        assert pair.height == pytest.approx(np.ptp(pair.identity.vertices[:, 1]), rel=0.5)
        moved = np.linalg.norm(pair.truth - pair.identity.vertices, axis=1)
        assert moved.mean() > 0.02 * pair.height
        # Edges are nearly as long in the truth as at rest, and not those of the driving animal.
        truth, identity, driving = (
            edge_lengths(vertices, ANIMAL.faces)
            for vertices in (pair.truth, pair.identity.vertices, pair.driving.vertices)
        )
        stretched = np.median(np.abs(np.log(truth / identity)))
        assert stretched < 0.05
        assert np.median(np.abs(np.log(truth / driving))) > 2 * stretched
