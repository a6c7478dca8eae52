"""mime: no order, any place and size, frames that mend, exact skinning, and a file that runs."""

import pytest

torch = pytest.importorskip("torch")

from mimesh.bodies import load_body  # noqa: E402
from mimesh.learn.batches import DataConfig  # noqa: E402
from mimesh.learn.joint_frames import Frames, turn  # noqa: E402
from mimesh.learn.mime import Mime, MimeConfig  # noqa: E402
from mimesh.learn.mime_batches import MimeSource  # noqa: E402
from mimesh.learn.mime_loss import MimeLossConfig, mime_loss, pmd  # noqa: E402
from mimesh.learn.skinning import posed_joints, skinned  # noqa: E402

BODY = load_body()
SMALL = MimeConfig(width=16, heads=2, latents=4, blocks=2, mendings=2, near=8, local=8, weighing=8)


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    model = Mime(SMALL, BODY).eval()
    for parameter in model.parameters():  # zeros at the start say nothing
        parameter.data += 0.02 * torch.randn_like(parameter)
    return model


@pytest.fixture(scope="module")
def batch():
    return MimeSource(DataConfig("wide", 64, "identity"), BODY, torch.device("cpu"), 0).batch(2, 0)


def test_people_who_touch_themselves_have_the_shapes_that_their_poses_are_for():
    """Hands that touch do so on the body that the pose was found for, and on no other."""
    source = MimeSource(DataConfig("wide", 400, "identity", heading=0.0, contacts=1.0), BODY, torch.device("cpu"), 0)
    shapes, _, touching = source._endless(4, torch.Generator().manual_seed(0))
    assert touching.all()
    assert (shapes.flatten(0, 1)[:, None] == source.contacts[0]).all(-1).any(1).all()
    before = source.batch(4, 0)
    source.contacts[0] = source.contacts[0] + 1.0
    assert not torch.equal(before.identity.points, source.batch(4, 0).identity.points)


@torch.no_grad()
def test_a_reading_knows_no_order_and_follows_place_and_size(model, batch):
    points, normals = batch.given[0]
    expected = model.read(points, normals)
    order = torch.randperm(64)
    mixed = model.read(points[:, order], normals[:, order])
    assert torch.allclose(mixed.rotation, expected.rotation, atol=1e-4)
    moved = model.read(3 * points + 7, normals)
    assert torch.allclose(moved.rotation, expected.rotation, atol=1e-4)
    assert torch.allclose(moved.place, 3 * expected.place + 7, atol=1e-3)


@torch.no_grad()
def test_rotations_are_rotations(model, batch):
    for rotation in model.read(*batch.given[0]).rotations:
        assert torch.allclose(rotation @ rotation.mT, torch.eye(3), atol=1e-5)
        assert torch.allclose(torch.linalg.det(rotation), torch.ones(()), atol=1e-5)
    assert torch.equal(turn(torch.zeros(6)), torch.eye(3))


@torch.no_grad()
def test_joints_see_the_same_in_every_pose(batch):
    """A rigid turn of the world, points and frames alike, changes nothing that a joint sees."""
    true = batch.identity
    q = turn(torch.randn(6))
    frames = Frames(true.rotation, true.joints)
    turned = Frames(q @ true.rotation, true.joints @ q.mT)
    seen = frames.of(true.points[:, None], true.normals[:, None])
    again = turned.of((true.points @ q.mT)[:, None], (true.normals @ q.mT)[:, None])
    assert torch.allclose(seen, again, atol=1e-4)


@torch.no_grad()
def test_true_frames_and_weights_give_the_truth(batch):
    """The parts of the result are exact: only blends of two bent joints differ from undoing the pose first."""
    one, two = batch.identity, batch.truth
    place = posed_joints(one.rotation, one.joints, two.rotation, two.joints[:, 0], BODY.parents)
    assert torch.allclose(place, two.joints, atol=1e-5)
    result = skinned(one.points, one.weights, one.rotation, one.joints, two.rotation, place)
    assert pmd(result, batch).mean() < 2e-4
    same = skinned(one.points, one.weights, one.rotation, one.joints, one.rotation, one.joints)
    assert torch.allclose(same, one.points, atol=1e-5)


def test_the_loss_reaches_every_weight(model, batch):
    model.zero_grad()
    loss = mime_loss(model, batch, MimeLossConfig())
    loss.backward()
    assert loss.isfinite()
    assert [n for n, p in model.named_parameters() if p.grad is None or not p.grad.isfinite().all()] == []
    assert [n for n, p in model.named_parameters() if not p.grad.any()] == []
