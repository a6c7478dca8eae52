"""Figures: points of the body as it is posed, and derivatives that finite differences give too."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampled_body import BodyState, PosedBody, SampledBody, kinds_of_bones
from mimesh.core.geometry import closest_on_mesh
from mimesh.core.surface_points import sample_surface

BODY = load_body()
FIGURE = SampledBody.of(BODY, 400)


def stance(seed=0, turn=0.5, bones=0.2, size=1.3):
    rng = np.random.default_rng(seed)
    figure = FIGURE.mean_person(
        size, rng.normal(size=3), Rotation.from_rotvec(turn * rng.normal(size=(31, 3))).as_matrix()
    )
    shape, grown = rng.normal(size=len(figure.shape)), bones * rng.normal(size=len(figure.bones))
    return dataclasses.replace(figure, shape=shape, bones=grown)


def world(local):
    """World rotations of local ones."""
    rotation = [local[0]]
    for j, parent in enumerate(BODY.parents[1:], 1):
        rotation.append(rotation[parent] @ local[j])
    return np.stack(rotation)


def test_points_lie_on_the_posed_body():
    rng = np.random.default_rng(1)
    local = Rotation.from_rotvec(0.3 * rng.normal(size=(31, 3))).as_matrix()
    shape = rng.normal(size=len(BODY.components))
    vertices = BODY.posed(shape, local)
    root = BODY.shaped(shape)[1][0]
    posed = PosedBody(FIGURE, BodyState(1.0, root, shape, np.zeros_like(stance().bones), world(local)))
    face, _, apart = closest_on_mesh(posed.points, vertices, BODY.faces)
    assert np.median(apart) < 2e-3
    corners = vertices[BODY.faces[face]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    alike = (normals / np.linalg.norm(normals, axis=1, keepdims=True) * posed.normals).sum(axis=1)
    assert np.median(alike) > 0.98
    rotation, offset = BODY.skinning_transforms(BODY.shaped(shape)[1], local)
    joints = offset + (rotation @ BODY.shaped(shape)[1][..., None])[..., 0]
    assert np.allclose(posed.joints, joints)


def test_small_parts_have_more_points_than_their_area_is_worth():
    face, shares = sample_surface(BODY.vertices, BODY.faces, 20_000, np.random.default_rng(0))
    even = (BODY.weights[BODY.faces[face]] * shares[..., None]).sum(axis=(0, 1)) / 20_000
    share = FIGURE.weights.mean(axis=0)
    for name in ("LeftHand", "RightHand", "LThumb", "Neck"):
        assert share[BODY.joint(name)] > 1.5 * even[BODY.joint(name)]
    assert share[BODY.joint("LeftUpLeg")] < even[BODY.joint("LeftUpLeg")]
    assert 380 <= len(FIGURE.vertices) <= 400


@pytest.mark.parametrize("group", ["size", "root", "shape", "bones", "turns"])
def test_derivatives_are_those_of_finite_differences(group):
    rng, here, small = np.random.default_rng(2), stance(), 1e-6
    step = np.zeros(FIGURE.unknowns["turns"].stop)
    step[FIGURE.unknowns[group]] = rng.normal(size=len(step[FIGURE.unknowns[group]]))
    posed, after = PosedBody(FIGURE, here), PosedBody(FIGURE, FIGURE.stepped(here, small * step))
    index = rng.integers(len(posed.points), size=700)
    direction = rng.normal(size=(700, 3))
    moved = ((after.points - posed.points)[index] / small * direction).sum(axis=1)
    assert np.allclose(posed.along(index, direction) @ step, moved, atol=1e-4)
    assert np.abs(moved).max() > 0.1
    assert np.allclose(posed.of_joints() @ step, (after.joints - posed.joints).reshape(-1) / small, atol=1e-4)


def test_bones_grow_along_and_across():
    arm, below, kinds = BODY.joint("LeftArm"), BODY.joint("LeftForeArm"), kinds_of_bones(BODY)
    still = BodyState(1.0, np.zeros(3), np.zeros(16), np.zeros_like(stance().bones), np.tile(np.eye(3), (31, 1, 1)))
    longer = still.bones.copy()
    longer[kinds[arm]] = np.log(1.5)
    old, new = (PosedBody(FIGURE, dataclasses.replace(still, bones=b)) for b in (still.bones, longer))
    assert np.allclose(new.joints[below] - new.joints[arm], 1.5 * (old.joints[below] - old.joints[arm]))
    other = BODY.joint("RightForeArm")
    assert not np.allclose(new.joints[other], old.joints[other])
    assert np.allclose(new.joints[BODY.joint("Head")], old.joints[BODY.joint("Head")])


def test_they_are_the_people_that_networks_learn_from():
    torch = pytest.importorskip("torch")
    from mimesh.learn.tasks.mime_people import SurfaceBody, plain_people

    here = stance(size=1.0)
    posed, surface = PosedBody(FIGURE, here), SurfaceBody(BODY, 100)
    length, girth = (torch.from_numpy(np.exp(b)[FIGURE.kind]).float()[None] for b in np.split(here.bones, 2))
    parents = [0, *BODY.parents[1:]]
    local = here.rotation[parents].transpose(0, 2, 1) @ here.rotation
    local[0] = here.rotation[0]
    who = plain_people(torch.from_numpy(here.shape).float()[None], surface)
    who = dataclasses.replace(who, length=length, girth=girth)
    found = surface.posed(who, torch.from_numpy(local).float()[None], torch.arange(10)[None])
    joints = found.joints[0].numpy()
    assert np.allclose(joints - joints[0], posed.joints - posed.joints[0], atol=1e-4)
