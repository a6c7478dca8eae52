"""mime's training pairs: true transfers, self-contact, and damage to what the network is given."""

import math

import pytest
import torch

from mimesh.learn.mime import MimeData, SurfaceSource
from mimesh.learn.task import shipped_body

BODY = shipped_body()
CPU = torch.device("cpu")


@pytest.mark.parametrize(
    ("kind", "body"),
    [("table6", "human"), ("wide", "human"), pytest.param("wide", "quadruped", marks=pytest.mark.slow)],
)
def test_the_truth_is_the_identity_in_the_driving_pose(kind, body):
    body = shipped_body(body)
    source = SurfaceSource(MimeData(kind, 64, "identity", body=body.name), body, CPU, 0)
    batch = source.batch(3, 0)
    assert torch.equal(batch.truth.weights, batch.identity.weights)
    assert torch.equal(batch.truth.rotation, batch.driving.rotation)
    # Bones keep their lengths from pose to pose.
    above = list(body.parents[1:])
    one, two = ((m.joints[:, 1:] - m.joints[:, above]).norm(dim=-1) for m in (batch.identity, batch.truth))
    assert torch.allclose(one, two, atol=1e-5)
    again = source.batch(3, 0)
    assert torch.equal(again.truth.points, batch.truth.points)
    assert not math.isclose(float(source.batch(3, 1).truth.points.mean()), float(batch.truth.points.mean()))


def test_one_sided_driving_points_face_one_way(monkeypatch):
    monkeypatch.setattr("mimesh.learn.mime.ONE_SIDED", 1.0)
    batch = SurfaceSource(MimeData("wide", 64, "identity"), BODY, CPU, 0).batch(8, 0)
    for whole, (_, normals) in zip(batch.driving.normals, zip(*batch.inputs[1], strict=True), strict=True):
        given = {tuple(n) for n in normals.tolist()} - {(0.0, 0.0, 0.0)}
        assert not given or 10 < len(given) < 54
        across = torch.tensor(sorted(given))[:, [0, 2]]
        angles = torch.linspace(0, 2 * math.pi, 361)
        facing = across @ torch.stack([angles.sin(), angles.cos()])
        assert not given or (facing > -1e-6).all(0).any()
        assert given <= {tuple(n) for n in whole.tolist()}


def test_people_in_self_contact_have_the_shapes_that_their_poses_fit():
    """Hands touch on the body that the pose was made for, and on no other."""
    source = SurfaceSource(MimeData("wide", 400, "identity", heading=0.0, contacts=1.0), BODY, CPU, 0)
    shapes, _, touching = source.people.pairs(4, torch.Generator().manual_seed(0))
    assert touching.all()
    assert (shapes.flatten(0, 1)[:, None] == source.people.contacts[0]).all(-1).any(1).all()
    before = source.batch(4, 0)
    source.people.contacts[0] = source.people.contacts[0] + 1.0
    assert not torch.equal(before.identity.points, source.batch(4, 0).identity.points)
