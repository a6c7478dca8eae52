"""Endless people for mime: exact skinning, garments, and proportions."""

import dataclasses

import numpy as np
import pytest
import torch

from mimesh.bodies import load_body
from mimesh.bodies.dress import GARMENTS
from mimesh.learn.data.bodies import rotvec_to_rotmat
from mimesh.learn.data.surfaces import PeopleSampler, SurfaceBody, plain_people

BODY = load_body()
CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def surface():
    return SurfaceBody(BODY)


def poses(size, reach=0.4):
    torch.manual_seed(1)
    return rotvec_to_rotmat(reach * torch.randn(size, len(BODY.parents), 3))


def test_plain_people_are_those_of_the_rigged_body(surface):
    """Points lie on the triangles that the body's own vertices have in that pose, within what a triangle bends."""
    shape, rotmat = torch.randn(2, len(BODY.components)), poses(2)
    who = plain_people(shape, surface)
    rng = torch.Generator().manual_seed(0)
    index = surface.choose(who, 400, rng)
    found = surface.posed(who, rotmat, index)
    vertices = BODY.posed(shape.double().numpy(), rotmat.double().numpy())
    from scipy.spatial import KDTree

    for points, mesh in zip(found.points.numpy(), vertices, strict=True):
        assert np.median(KDTree(mesh).query(points)[0]) < 0.02
        assert KDTree(mesh).query(points)[0].max() < 0.08
    rotation, offset = BODY.skinning_transforms(BODY.shaped(shape.double().numpy())[1], rotmat.double().numpy())
    joints = offset + (rotation @ BODY.shaped(shape.double().numpy())[1][..., None])[..., 0]
    assert np.allclose(found.joints.numpy(), joints, atol=1e-5)
    assert np.allclose(found.rotation.numpy(), rotation, atol=1e-5)
    assert torch.allclose(found.weights.sum(-1), torch.ones(2, 400), atol=1e-5)


def test_normals_are_at_right_angles_to_the_surface(surface):
    """Of a sphere of girths and lengths: turned and scaled normals stay at right angles to nearby points."""
    who = dataclasses.replace(
        plain_people(torch.zeros(1, len(BODY.components)), surface),
        girth=torch.full((1, len(BODY.parents)), 1.5),
        length=torch.full((1, len(BODY.parents)), 0.8),
    )
    every = torch.arange(6000)[None]
    found = surface.posed(who, poses(1, 0.0), every)
    from scipy.spatial import KDTree

    points, normals = found.points[0].numpy(), found.normals[0].numpy()
    near = KDTree(points).query(points, k=4)[1][:, 1:]
    along = points[near] - points[:, None]
    along /= np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    assert np.median(np.abs((along * normals[:, None]).sum(-1))) < 0.2


def test_proportions_scale_bones_and_nothing_else(surface):
    who = plain_people(torch.zeros(1, len(BODY.components)), surface)
    arm, hand = BODY.joint("LeftArm"), BODY.joint("LeftForeArm")
    longer = dataclasses.replace(who, length=who.length.clone())
    longer.length[0, arm] = 1.5
    index = torch.arange(500)[None]
    old, new = (surface.posed(p, poses(1, 0.0), index).joints[0] for p in (who, longer))
    assert torch.allclose((new[hand] - new[arm]), 1.5 * (old[hand] - old[arm]), atol=1e-5)
    assert torch.allclose(new[BODY.joint("Head")], old[BODY.joint("Head")])


def test_points_lie_on_worn_garments_only(surface):
    who = PeopleSampler(BODY, 1.3, CPU).draw(40, torch.Generator().manual_seed(3))
    index = surface.choose(who, 300, torch.Generator().manual_seed(4))
    piece = surface.piece[index]
    for person in range(40):
        assert set(piece[person].tolist()) <= set(torch.where(who.worn[person])[0].tolist())
    assert who.worn[:, 0].all()
    assert 0.1 < who.worn[:, 1].float().mean() < 0.45


def test_training_draws_all_garments(surface):
    assert surface.piece.unique().tolist() == list(range(1 + len(GARMENTS)))
    assert PeopleSampler(BODY, 1.3, CPU).draw(8, torch.Generator()).worn.shape == (8, 1 + len(GARMENTS))
