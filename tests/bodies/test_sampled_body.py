"""Sampled bodies: points lie on the posed body, and the Jacobian agrees with finite differences."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampled_body import BodyState, PosedBody, SampledBody, kinds_of_bones
from mimesh.core.geometry import closest_on_mesh, face_normals
from mimesh.core.surface_points import sample_surface

BODY = load_body()
SAMPLED = SampledBody.of(BODY, 400)


def random_state(seed=0, turn=0.5, bones=0.2, size=1.3):
    rng = np.random.default_rng(seed)
    state = SAMPLED.mean_person(
        size, rng.normal(size=3), Rotation.from_rotvec(turn * rng.normal(size=(31, 3))).as_matrix()
    )
    shape, logarithms = rng.normal(size=len(state.shape)), bones * rng.normal(size=len(state.bones))
    return dataclasses.replace(state, shape=shape, bones=logarithms)


def test_points_lie_on_the_posed_body():
    rng = np.random.default_rng(1)
    local = Rotation.from_rotvec(0.3 * rng.normal(size=(31, 3))).as_matrix()
    shape = rng.normal(size=len(BODY.components))
    vertices, rest = BODY.posed(shape, local), BODY.shaped(shape)[1]
    rotation, offset = BODY.skinning_transforms(rest, local)
    posed = PosedBody(SAMPLED, BodyState(1.0, rest[0], shape, np.zeros_like(random_state().bones), rotation))
    face, _, distance = closest_on_mesh(posed.points, vertices, BODY.faces)
    assert np.median(distance) < 2e-3
    assert np.median((face_normals(vertices, BODY.faces)[face] * posed.normals).sum(axis=1)) > 0.98
    assert np.allclose(posed.joints, offset + (rotation @ rest[..., None])[..., 0])


def test_small_parts_are_sampled_more_densely():
    face, barycentric = sample_surface(BODY.vertices, BODY.faces, 20_000, np.random.default_rng(0))
    uniform = (BODY.weights[BODY.faces[face]] * barycentric[..., None]).sum(axis=(0, 1)) / 20_000
    fraction = SAMPLED.weights.mean(axis=0)
    for name in ("LeftHand", "RightHand", "LThumb", "Neck"):
        assert fraction[BODY.joint(name)] > 1.5 * uniform[BODY.joint(name)]
    assert fraction[BODY.joint("LeftUpLeg")] < uniform[BODY.joint("LeftUpLeg")]
    assert 380 <= len(SAMPLED.vertices) <= 400


@pytest.mark.parametrize("group", ["size", "root", "shape", "bones", "turns"])
def test_jacobians_agree_with_finite_differences(group):
    rng, state, small = np.random.default_rng(2), random_state(), 1e-6
    step = np.zeros(SAMPLED.unknowns["turns"].stop)
    step[SAMPLED.unknowns[group]] = rng.normal(size=len(step[SAMPLED.unknowns[group]]))
    posed, after = PosedBody(SAMPLED, state), PosedBody(SAMPLED, SAMPLED.stepped(state, small * step))
    index = rng.integers(len(posed.points), size=700)
    direction = rng.normal(size=(700, 3))
    moved = ((after.points - posed.points)[index] / small * direction).sum(axis=1)
    assert np.allclose(posed.along(index, direction) @ step, moved, atol=1e-4)
    assert np.abs(moved).max() > 0.1
    assert np.allclose(posed.of_joints() @ step, (after.joints - posed.joints).reshape(-1) / small, atol=1e-4)


def test_bones_scale_in_length_on_both_sides():
    arm, below, kinds = BODY.joint("LeftArm"), BODY.joint("LeftForeArm"), kinds_of_bones(BODY)
    rest = BodyState(
        1.0, np.zeros(3), np.zeros(16), np.zeros_like(random_state().bones), np.tile(np.eye(3), (31, 1, 1))
    )
    longer = rest.bones.copy()
    longer[kinds[arm]] = np.log(1.5)
    old, new = (PosedBody(SAMPLED, dataclasses.replace(rest, bones=b)) for b in (rest.bones, longer))
    assert np.allclose(new.joints[below] - new.joints[arm], 1.5 * (old.joints[below] - old.joints[arm]))
    other = BODY.joint("RightForeArm")
    assert not np.allclose(new.joints[other], old.joints[other])
    assert np.allclose(new.joints[BODY.joint("Head")], old.joints[BODY.joint("Head")])


def test_joints_agree_with_those_of_training_people():
    torch = pytest.importorskip("torch")
    from mimesh.learn.data.surfaces import SurfaceBody, plain_people

    state = random_state(size=1.0)
    posed, surface = PosedBody(SAMPLED, state), SurfaceBody(BODY, 100)
    length, girth = (torch.from_numpy(np.exp(b)[SAMPLED.kind]).float()[None] for b in np.split(state.bones, 2))
    parents = [0, *BODY.parents[1:]]
    local = state.rotation[parents].transpose(0, 2, 1) @ state.rotation
    local[0] = state.rotation[0]
    people = plain_people(torch.from_numpy(state.shape).float()[None], surface)
    people = dataclasses.replace(people, length=length, girth=girth)
    found = surface.posed(people, torch.from_numpy(local).float()[None], torch.arange(10)[None])
    joints = found.joints[0].numpy()
    assert np.allclose(joints - joints[0], posed.joints - posed.joints[0], atol=1e-4)
