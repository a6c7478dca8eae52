"""Garments of the shipped human follow its pose and shape, and lie outside its skin."""

import dataclasses

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mimesh.bodies import load_body
from mimesh.bodies.dress import GARMENTS, dressed_body, load_garment
from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.core.errors import InputError
from mimesh.core.geometry import closest_on_mesh, edges, face_vectors, vertex_normals
from mimesh.core.surface_points import at_barycentric

WEARERS = 3


@pytest.fixture(scope="module")
def body():
    return load_body()


def components(faces: np.ndarray, count: int) -> np.ndarray:
    pairs = edges(faces)
    return connected_components(coo_matrix((np.ones(len(pairs)), pairs.T), (count, count)), directed=False)[1]


def heights(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Signed distance above the skin: along the interpolated normal of the closest point."""
    face, barycentric, _ = closest_on_mesh(points, vertices, faces)
    normal = at_barycentric(vertex_normals(vertices, faces), faces, face, barycentric)
    difference = points - at_barycentric(vertices, faces, face, barycentric)
    return (difference * normal).sum(axis=1) / np.linalg.norm(normal, axis=1)


@pytest.mark.parametrize("garments", [(), ("skirt",), ("hair", "tights"), GARMENTS], ids="+".join)
def test_garments_do_not_change_the_body(body, garments):
    dressed = dressed_body(body, garments)
    shape, pose = sample_shape(body, 0, 1), rotvec_to_rotmat(sample_pose(body, 0, 1))
    count = len(body.vertices)
    # Not to the last bit: a matrix product of more rows may round a value differently.
    np.testing.assert_allclose(dressed.posed(shape, pose)[:count], body.posed(shape, pose), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(dressed.faces[: len(body.faces)], body.faces)
    np.testing.assert_array_equal(dressed.joints, body.joints)
    assert dressed.name == "+".join(("human", *garments))


@pytest.mark.parametrize("name", GARMENTS)
def test_a_garment_is_a_consistently_wound_manifold_that_faces_outward_with_weights_that_sum_to_1(body, name):
    garment = load_garment(name)
    np.testing.assert_allclose(garment.weights.sum(axis=1), 1, atol=1e-12)
    assert garment.weights.min() >= 0
    assert (garment.weights > 0).sum(axis=1).max() <= 6
    part = components(garment.faces, len(garment.vertices))
    assert not part.any()  # one component, and no vertex is left over
    directed = garment.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)[1].max() <= 2  # manifold
    assert len(np.unique(directed, axis=0)) == len(directed)
    assert np.isfinite(garment.components).all()
    middle = garment.vertices[garment.faces].mean(axis=1)
    face, barycentric, _ = closest_on_mesh(middle, body.vertices, body.faces)
    skin = at_barycentric(vertex_normals(body.vertices, body.faces), body.faces, face, barycentric)
    outward = (face_vectors(garment.vertices, garment.faces) * skin).sum(axis=1) > 0
    assert outward.mean() > 0.95


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "most", "share"),
    [("skirt", 0.30, 0.98), ("tights", 0.03, 0.99), ("hair", 0.12, 0.99)],
)
def test_garments_are_outside_the_skin_and_near_it_at_rest_and_outside_in_poses(body, name, most, share):
    garment, wearer = load_garment(name), dressed_body(body, (name,))
    outside, count = [], len(body.vertices)
    for i in range(WEARERS):  # other people than the garments were lifted for
        shape = sample_shape(body, 1000, i)
        worn = garment.vertices + np.tensordot(shape, garment.components, axes=1)
        height = heights(worn, body.shaped(shape)[0], body.faces)
        assert (height > 0).mean() > 0.995  # the lift leaves out one person in twenty at every vertex
        assert height.min() > -0.005
        assert height.max() < most
        posed = wearer.posed(shape, rotvec_to_rotmat(sample_pose(body, 1000, i)))
        outside.append((heights(posed[count:], posed[:count], body.faces) > -0.001).mean())
    assert np.mean(outside) > share


def test_tights_follow_the_leg(body):
    """The suit moves with the skin it lies on: bending a knee leaves hardly any slip between them."""
    pose = np.zeros((len(body.parents), 3))
    pose[body.joint("LeftLeg"), 0] = np.radians(90)
    tights = load_garment("tights")
    whole = dressed_body(body, ("tights",))
    bent = whole.posed(np.zeros(16), rotvec_to_rotmat(pose)) - whole.vertices
    face, barycentric, _ = closest_on_mesh(tights.vertices, body.vertices, body.faces)
    skin = at_barycentric(bent[: len(body.vertices)], body.faces, face, barycentric)
    apart = np.linalg.norm(bent[len(body.vertices) :] - skin, axis=1)
    assert np.linalg.norm(skin, axis=1).max() > 0.4
    # A layer at height h that turns by 90 degrees leaves its skin by h times the square root of 2.
    assert apart.max() < 0.05
    assert apart.mean() < 0.005


def test_mistakes_are_told(body):
    fewer = {
        "joints": body.joints[:5],
        "joint_components": body.joint_components[:, :5],
        "weights": body.weights[:, :5],
    }
    twice = {name: np.concatenate([getattr(body, name)] * 2) for name in ("components", "joint_components")}
    count = len(body.components)
    for changes, garments, message in (
        ({}, ("toga",), "toga: expected a garment"),
        ({}, ("hair", "hair"), "each at most once, found hair, hair"),
        ({"name": "giant", "joints": 2 * body.joints}, ("hair",), "giant: expected the shipped human"),
        ({"name": "stump", **fewer}, ("hair",), "stump: expected the shipped human"),
        (twice, ("hair",), f"at most the {count} shape .*found {2 * count}"),
    ):
        with pytest.raises(InputError, match=message):
            dressed_body(dataclasses.replace(body, **changes), garments)
