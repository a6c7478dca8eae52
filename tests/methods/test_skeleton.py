"""The skeleton baseline: exact where it can be, near the truth where it cannot."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from people import person, walk
from zoo import ZOO

from mimesh.bodies import load_body
from mimesh.bodies.body_parameters import BodyParameters, thin_body
from mimesh.core.canonical_order import canonical_order
from mimesh.core.mesh import Clip, Mesh, permute_vertices
from mimesh.core.normalization import Normalization
from mimesh.evaluate.metrics import pmd_of_pair
from mimesh.methods.base import Method
from mimesh.methods.skeleton import SkeletonBaseline, bind, bone_segments, bone_transforms, surface_sampler

BODY = thin_body(load_body(), 500, 8)
IDENTITY, DRIVING = person(0, pose=3), person(1, pose=1)
IDENTITY_FRAME = Normalization.fit(IDENTITY, "+y", "+z")


def fit_like(seed: int, turn: float = 0.3) -> BodyParameters:
    rng = np.random.default_rng(seed)
    return BodyParameters(
        0.9, np.array([0.0, -0.9, 0.0]), rng.normal(size=8), turn * rng.normal(size=(len(BODY.parents), 3))
    )


def normalised(mesh: Mesh) -> Mesh:
    return dataclasses.replace(mesh, vertices=Normalization.fit(mesh, "+y", "+z").apply(mesh.vertices))


def shuffled(mesh: Mesh, order) -> Mesh:
    mesh = permute_vertices(mesh, order)
    return dataclasses.replace(mesh, faces=np.random.default_rng(1).permutation(mesh.faces))


def an_order(mesh: Mesh):
    return np.random.default_rng(0).permutation(len(mesh.vertices))


def bound(mesh: Mesh, fit: BodyParameters):
    ranked = canonical_order(mesh.vertices)
    return bind(mesh, ranked, BODY, fit)[ranked.group]


def moved(identity: Mesh, driving: Mesh):
    identity, driving = normalised(identity), normalised(driving)
    return next(iter(SkeletonBaseline().prepare(identity, Clip.still(driving))([driving.vertices])))


@cache
def example():
    return moved(IDENTITY, DRIVING)


def test_it_is_a_method():
    assert isinstance(SkeletonBaseline(), Method)
    assert SkeletonBaseline().name == "skeleton"


def test_the_identity_as_driving_gives_the_identity():
    mesh = normalised(person(0, pose=1))
    assert np.allclose(moved(mesh, mesh), mesh.vertices, rtol=0, atol=1e-12)


def test_the_result_is_near_the_truth():
    truth = person(0, pose=1).vertices
    error = pmd_of_pair(IDENTITY_FRAME.radius * example(), truth)
    assert error < 5e-4  # the paper's has 27e-4
    assert pmd_of_pair(IDENTITY.vertices, truth) > 10 * error


def test_permuting_either_input_permutes_the_result_alike_to_the_last_bit():
    order = an_order(IDENTITY)
    result = moved(shuffled(IDENTITY, order), shuffled(DRIVING, an_order(DRIVING)))
    assert np.array_equal(result, example()[order])


@pytest.mark.parametrize("faces", [True, False])
def test_the_fits_see_the_same_points_whatever_the_order_place_and_size(faces):
    mesh = DRIVING if faces else dataclasses.replace(DRIVING, faces=DRIVING.faces[:0])
    other = shuffled(mesh, an_order(mesh))
    other = normalised(dataclasses.replace(other, vertices=3.7 * other.vertices + [100, 2, -5]))
    mesh = normalised(mesh)
    points, same = (surface_sampler(m, 400, np.random.default_rng(2))(m.vertices) for m in (mesh, other))
    assert points.shape == (400, 3)
    assert np.allclose(points, same, rtol=0, atol=1e-12)
    assert len(np.unique(points, axis=0)) > 390


def test_binding_does_not_depend_on_the_order_and_seams_share_their_weights():
    mesh, fit = normalised(IDENTITY), fit_like(0, 0.0)
    weights, order = bound(mesh, fit), an_order(mesh)
    assert np.array_equal(bound(shuffled(mesh, order), fit), weights[order])
    split = Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))
    assert np.allclose(bound(split, fit), weights[mesh.faces.ravel()], rtol=0, atol=1e-12)


def test_segments_join_the_joints_and_every_joint_owns_one():
    fit = fit_like(1)
    segments, owners = bone_segments(BODY, fit)
    assert set(owners) == set(range(len(BODY.parents)))
    assert np.allclose(segments[:, 0], fit.joints(BODY)[owners])
    knee, foot = BODY.joint("LeftLeg"), BODY.joint("LeftFoot")
    assert np.allclose(segments[owners == knee][0], fit.joints(BODY)[[knee, foot]])
    top = segments[owners == BODY.joint("Head")][0, 1] - fit.joints(BODY)[BODY.joint("Head")]
    assert np.linalg.norm(top) > 0.05


def test_the_end_of_a_limb_without_points_is_refused():
    weights = BODY.weights.copy()
    weights[:, BODY.joint("Head")] = 0
    with pytest.raises(AssertionError, match="end of a limb moves none"):
        bone_segments(dataclasses.replace(BODY, weights=weights), fit_like(1))


def test_bones_keep_their_length_and_turn_as_the_fits_say():
    own, other = fit_like(1), fit_like(2)
    rotation, offset = bone_transforms(BODY, own, other)
    assert np.allclose(rotation @ own.rotations(BODY), other.rotations(BODY), rtol=0, atol=1e-12)
    joints, parents = own.joints(BODY), np.array(BODY.parents)
    place = np.einsum("jkl,jl->jk", rotation, joints) + offset
    ends = np.einsum("jkl,jl->jk", rotation[parents[1:]], joints[1:]) + offset[parents[1:]]
    assert np.allclose(ends, place[1:], rtol=0, atol=1e-12)  # parent and child agree where they meet
    lengths, expected = (np.linalg.norm(x[1:] - x[parents[1:]], axis=1) for x in (place, joints))
    assert np.allclose(lengths, expected, rtol=0, atol=1e-12)


def test_a_clip_is_followed():
    identity, clip = person(0), walk(1, frames=3)
    size, frame = Normalization.fit(identity, "+y", "+z").radius, Normalization.fit(clip.mesh, "+y", "+z")
    drive = SkeletonBaseline().prepare(normalised(identity), Clip.still(normalised(clip.mesh)))
    results = drive(frame.apply(vertices) for vertices in clip.vertices)
    for result, truth in zip(results, walk(0, frames=3).vertices, strict=True):
        assert pmd_of_pair(size * result, truth) < 2e-4


@pytest.mark.parametrize("make", ZOO, ids=lambda make: make.__name__)
def test_anything_can_be_bound(make):
    weights = bound(make(), fit_like(0))
    assert np.isfinite(weights).all()
    assert np.allclose(weights.sum(axis=1), 1, rtol=0, atol=1e-12)
