"""The network of mime: invariance to order, place and size; joint frames; exact skinning; older weights."""

import pytest
import torch

from mimesh.learn.data.bodies import posed_joints, skinned
from mimesh.learn.mime import (
    JointFrames,
    MimeConfig,
    MimeData,
    MimeLossConfig,
    MimeNetwork,
    SurfaceSource,
    mime_loss,
    reconstruction,
    rotation_from_6d,
)
from mimesh.learn.task import shipped_body

BODY = shipped_body()
SMALL = MimeConfig(width=16, heads=2, latents=4, blocks=2, refinements=2, near=8, local=8, skinning=8)


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    model = MimeNetwork(SMALL, BODY).eval()
    for parameter in model.parameters():  # some layers begin with zeros
        parameter.data += 0.02 * torch.randn_like(parameter)
    return model


@pytest.fixture(scope="module")
def batch():
    return SurfaceSource(MimeData("wide", 64, "identity"), BODY, torch.device("cpu"), 0).batch(2, 0)


@torch.no_grad()
def test_prediction_ignores_point_order_and_follows_place_and_size(model, batch):
    points, normals = batch.inputs[0]
    expected = model.predict_joints(points, normals)
    order = torch.randperm(64)
    mixed = model.predict_joints(points[:, order], normals[:, order])
    assert torch.allclose(mixed.rotation, expected.rotation, atol=1e-4)
    moved = model.predict_joints(3 * points + 7, normals)
    assert torch.allclose(moved.rotation, expected.rotation, atol=1e-4)
    assert torch.allclose(moved.joints, 3 * expected.joints + 7, atol=1e-3)


@torch.no_grad()
def test_rotations_are_rotations(model, batch):
    for rotation in model.predict_joints(*batch.inputs[0]).rotations:
        assert torch.allclose(rotation @ rotation.mT, torch.eye(3), atol=1e-5)
        assert torch.allclose(torch.linalg.det(rotation), torch.ones(()), atol=1e-5)
    assert torch.equal(rotation_from_6d(torch.zeros(6)), torch.eye(3))


@torch.no_grad()
def test_points_in_joint_frames_do_not_change_with_a_rigid_motion(batch):
    """A rigid turn of the world, points and frames alike, changes nothing that describes a point."""
    true = batch.identity
    q = rotation_from_6d(torch.randn(6))
    frames = JointFrames(true.rotation, true.joints)
    turned = JointFrames(q @ true.rotation, true.joints @ q.mT)
    before = frames.describe(true.points[:, None], true.normals[:, None])
    after = turned.describe((true.points @ q.mT)[:, None], (true.normals @ q.mT)[:, None])
    assert torch.allclose(before, after, atol=1e-4)


@torch.no_grad()
def test_true_frames_and_weights_give_the_truth(batch):
    """The parts of the result are exact: only blends of two bent joints differ from undoing the pose first."""
    one, two = batch.identity, batch.truth
    place = posed_joints(one.rotation, one.joints, two.rotation, two.joints[:, 0], BODY.parents)
    assert torch.allclose(place, two.joints, atol=1e-5)
    result = skinned(one.points, one.weights, one.rotation, one.joints, two.rotation, place)
    assert reconstruction(result, batch).mean() < 2e-4
    same = skinned(one.points, one.weights, one.rotation, one.joints, one.rotation, one.joints)
    assert torch.allclose(same, one.points, atol=1e-5)


def test_the_loss_reaches_every_weight(model, batch):
    model.zero_grad()
    loss = mime_loss(model, batch, MimeLossConfig())
    loss.backward()
    assert loss.isfinite()
    assert [n for n, p in model.named_parameters() if p.grad is None or not p.grad.isfinite().all()] == []
    assert [n for n, p in model.named_parameters() if not p.grad.any()] == []
