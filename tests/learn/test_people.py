"""People, poses and vertices for training: normalisation of subsets, even coverage of the body."""

import pytest
import torch

from mimesh.learn.data import endless
from mimesh.learn.data.bodies import numbers_of_step
from mimesh.learn.data.people import BodySampler, PairSource
from mimesh.learn.npt import NPTData
from mimesh.learn.task import STEPS_AHEAD, BatchesAhead, shipped_body


def test_subsets_are_normalised_as_the_whole():
    """Centre and radius come from the outermost vertices of the whole body, within a hundredth or two of its radius."""
    body = shipped_body()
    some, whole = (BodySampler(NPTData("wide", n), body, torch.device("cpu"), seed=3) for n in (64, 0))
    rng = torch.Generator().manual_seed(0)
    shapes, poses, _ = some.people.pairs(8, rng)
    index = torch.arange(0, 6890, 10).expand(8, -1)
    subset, radius = some._normalized_mesh(shapes[1], poses[1], index)
    full, full_radius = whole._normalized_mesh(shapes[1], poses[1], torch.arange(6890).expand(8, -1))
    torch.testing.assert_close(radius, full_radius, rtol=1e-2, atol=0)
    torch.testing.assert_close(subset, full[:, ::10], rtol=0, atol=2e-2)


def test_stratified_vertices_cover_the_body():
    source = BodySampler(NPTData("table6", 64), shipped_body(), torch.device("cpu"), seed=0)
    drawn = source._stratified_vertices(2, 100, torch.Generator().manual_seed(0))
    rank = torch.empty(6890, dtype=torch.long)
    rank[source.order] = torch.arange(6890)
    cells = (rank[drawn].sort(dim=1).values * 100 / 6890).long()
    assert all(len(c.unique()) >= 95 for c in cells)


def test_wide_meshes_may_be_as_dense_as_their_area():
    source = BodySampler(NPTData("wide", 64), shipped_body(), torch.device("cpu"), seed=0)
    drawn = source._stratified_vertices(400, 100, torch.Generator().manual_seed(0))
    body = shipped_body()
    of_hands = [name.startswith(("LeftHand", "RightHand")) for name in body.joint_names]
    hands = torch.from_numpy(body.weights[:, of_hands].sum(1) > 0.5)
    share = hands[drawn].float().mean(dim=1)
    assert share.quantile(0.9) > 1.5 * share.quantile(0.1) > 0


def test_tumbling_rotates_a_share_of_driving_meshes_and_changes_nothing_else():
    """Identities and all other driving meshes are those without it."""
    poses = [
        BodySampler(NPTData("wide", 64, tumble=share), shipped_body(), torch.device("cpu"), 0).people.pairs(
            200, torch.Generator().manual_seed(1)
        )[1]
        for share in (0.0, 0.3)
    ]
    same = torch.isclose(poses[0], poses[1], atol=1e-6).flatten(2).all(-1)
    assert same[0].all()
    assert 0.2 < 1 - same[1].float().mean() < 0.4
    up = poses[1][1][~same[1]][:, 0, 1, 1]
    assert up.min() < -0.5 < 0.5 < up.max()
    assert torch.allclose(poses[0][:, :, 1:], poses[1][:, :, 1:])


def test_recombined_poses_have_limbs_of_poses_of_the_table_and_the_trunk_of_one():
    body, share = shipped_body(), 0.5
    source = BodySampler(NPTData("table6", 64, recombine=share), body, torch.device("cpu"), seed=0)
    whole, table = source.people.poses[:200], source.people.poses[:, None]
    mixed = endless.recombined(whole[:, None], table, source.people.limbs, share, torch.Generator().manual_seed(0))[
        :, 0
    ]
    kept = (mixed == whole).flatten(1).all(1)
    assert 70 <= kept.sum() <= 130
    joints = [body.joint(name) for name in ("Hips", "Spine1", "LeftShoulder", "RightShoulder")]
    assert torch.equal(mixed[:, joints], whole[:, joints])
    for chain in (("LeftUpLeg", "LeftLeg", "LeftFoot"), ("RightArm", "RightForeArm", "RightHand"), ("Neck", "Head")):
        limb = [body.joint(name) for name in chain]
        same = (mixed[~kept][:, None, limb] == source.people.poses[None, :, limb]).flatten(2).all(-1)
        assert same.any(1).all(), "a limb that no pose of the table has"
        assert (same.int().argmax(1) != torch.arange(200)[~kept]).float().mean() > 0.9


def test_limbs_of_recombined_windows_move_as_in_one_window_of_the_motions():
    config = NPTData("clips80", 64, recombine=1.0)
    source = BodySampler(config, shipped_body(), torch.device("cpu"), seed=0).people
    source.motions = source.motions[:6, :8]
    window = source.motions[[0, 1], :3]
    mixed = endless.recombined(window, source.motions, source.limbs, 1.0, torch.Generator().manual_seed(0))
    every = torch.stack([source.motions[:, t : t + 3] for t in range(6)], dim=1).flatten(0, 1)
    for limb in source.limbs:
        same = (mixed[:, None, :, limb] == every[:, :, limb]).flatten(2).all(2)
        assert same.any(1).all()
    assert not torch.equal(mixed, window)
    trunk = ~source.limbs.any(0)
    assert torch.equal(mixed[:, :, trunk], window[:, :, trunk])


def test_a_share_of_driving_meshes_is_posed_anyhow_within_the_joint_limits():
    few, all_of_them = (
        BodySampler(NPTData("wide", 64, limits=of_all), shipped_body(), torch.device("cpu"), 0).people.pairs(
            200, torch.Generator().manual_seed(1), share
        )[1]
        for of_all, share in ((0.1, None), (0.5, 1.0))
    )
    torch.testing.assert_close(few[0], all_of_them[0])  # identities are the same
    same = (few[1] - all_of_them[1]).abs().amax((1, 2, 3)) < 1e-6
    assert 0.05 < same.float().mean() < 0.15


@pytest.mark.slow
def test_ordered_pairs_are_of_the_same_vertices():
    device, body = torch.device("cpu"), shipped_body()
    for vertices in (64, 0):
        ordered, random = (
            BodySampler(NPTData("table6", vertices, pairing=pairing), body, device, 0)
            for pairing in ("order", "random")
        )
        index, driving, edges, _ = ordered._sample_vertices(2, numbers_of_step(0, 0, ordered.device))
        assert torch.equal(index, driving)
        other_index, other, _, _ = random._sample_vertices(2, numbers_of_step(0, 0, random.device))
        assert torch.equal(index, other_index)
        assert (other != index).float().mean() > 0.9
        ends = torch.from_numpy(body.faces)
        for row, pairs in zip(index, edges[:, :20], strict=True):
            assert all((ends == a).any(1).logical_and((ends == b).any(1)).any() for a, b in row[pairs].tolist())


def test_mixed_people_have_the_mean_and_the_spread_of_the_people():
    device, body = torch.device("cpu"), shipped_body()
    mixed = BodySampler(NPTData("table6", 64, mix_people=1.0), body, device, 0)
    shapes = endless.mixed_people(mixed.people.shapes, 1.0, 40_000, numbers_of_step(0, 0, mixed.device)).flatten(0, 1)
    people = mixed.people.shapes
    assert torch.allclose(shapes.mean(0), people.mean(0), atol=0.03)
    assert torch.allclose(shapes.T.cov(correction=0), people.T.cov(correction=0), atol=0.06)
    assert torch.cdist(shapes[:100], people).amin() > 0
    some = BodySampler(NPTData("table6", 64, mix_people=0.25), body, device, 0)
    of_table = (
        (endless.mixed_people(some.people.shapes, 0.25, 2000, numbers_of_step(0, 0, some.device))[0][:, None] == people)
        .all(2)
        .any(1)
    )
    assert 0.7 < of_table.float().mean() < 0.8


def test_batches_made_together_are_divided_among_steps_with_equal_shares():
    source = PairSource(NPTData("table6", 32, reflect=0.5), shipped_body(), torch.device("cpu"), 0)
    ahead = BatchesAhead(source)
    steps = [ahead.batch(4, step) for step in range(STEPS_AHEAD)]
    together = source.batch(4 * STEPS_AHEAD, 0)
    for k, batch in enumerate(steps):
        assert torch.equal(batch.truth, together.truth[k::STEPS_AHEAD])
        assert torch.equal(batch.edges, together.edges[k::STEPS_AHEAD])
        assert batch.edges_of_mesh == together.edges_of_mesh
    again = BatchesAhead(source).batch(4, STEPS_AHEAD + 3)
    assert torch.equal(ahead.batch(4, STEPS_AHEAD + 3).identity, again.identity)
    assert not torch.equal(again.identity, steps[3].identity)
