"""Garments of the shipped human follow its pose and shape, and lie outside its skin."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from garment_files import REAL_FOLDER, write_test_garments
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mimesh.bodies import load_body
from mimesh.bodies.dress import GARMENTS, TEST_FILE, TEST_GARMENTS, dressed_body, load_garment
from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.core.errors import InputError
from mimesh.core.geometry import closest_on_mesh, edges, face_vectors, vertex_normals
from mimesh.core.surface_points import at_barycentric

WEARERS = 3
FOLDER = Path(REAL_FOLDER) if REAL_FOLDER else None
REAL = pytest.mark.skipif(FOLDER is None, reason="MIMESH_GARMENTS: no folder of test garments")
OUTWARD = 0.85
"""Share of the faces of test garments that face outward: lapels, cuffs and soles have an inner side."""
EVERY = [*GARMENTS, *(pytest.param(name, marks=REAL) for name in TEST_GARMENTS)]


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


@pytest.mark.parametrize("name", EVERY)
def test_a_garment_is_a_consistently_wound_manifold_that_faces_outward_with_weights_that_sum_to_1(body, name):
    garment = load_garment(name, FOLDER)
    np.testing.assert_allclose(garment.weights.sum(axis=1), 1, atol=1e-12)
    assert garment.weights.min() >= 0
    assert (garment.weights > 0).sum(axis=1).max() <= 6
    part = components(garment.faces, len(garment.vertices))
    assert not part.any() or name in TEST_GARMENTS  # shipped garments have one component
    assert np.bincount(part).min() > 20  # no vertex is left over
    directed = garment.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)[1].max() <= 2  # manifold
    wrong = 1 - len(np.unique(directed, axis=0)) / len(directed)
    assert wrong <= (0.005 if name == "skirt_suit" else 0)  # MakeHuman's file winds its lapels the other way
    assert np.isfinite(garment.components).all()
    middle = garment.vertices[garment.faces].mean(axis=1)
    face, barycentric, _ = closest_on_mesh(middle, body.vertices, body.faces)
    skin = at_barycentric(vertex_normals(body.vertices, body.faces), body.faces, face, barycentric)
    outward = (face_vectors(garment.vertices, garment.faces) * skin).sum(axis=1) > 0
    assert outward.mean() > (0.95 if name in GARMENTS else OUTWARD)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "most", "share"),
    [
        *[("skirt", 0.30, 0.98), ("tights", 0.03, 0.99), ("hair", 0.12, 0.99)],
        *(pytest.param(name, 0.15, 0.99, marks=REAL) for name in TEST_GARMENTS),
    ],
)
def test_garments_are_outside_the_skin_and_near_it_at_rest_and_outside_in_poses(body, name, most, share):
    garment, wearer = load_garment(name, FOLDER), dressed_body(body, (name,), FOLDER)
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


def test_test_garments_are_read_from_a_folder(body, tmp_path):
    folder = write_test_garments(tmp_path)
    dressed = dressed_body(body, ("hair", "skirt_suit"), folder)
    same = dressed_body(body, ("hair", "skirt"))
    assert dressed.name == "human+hair+skirt_suit"
    for field in ("vertices", "faces", "components", "weights"):
        np.testing.assert_array_equal(getattr(dressed, field), getattr(same, field))


def test_unusable_files_of_test_garments_are_refused(body, tmp_path):
    with pytest.raises(
        InputError, match=r"bob: expected the folder of test_dress\.npz, found none; give it with --data"
    ):
        load_garment("bob")
    with pytest.raises(InputError, match=r"expected test_dress\.npz in it, found no such file"):
        load_garment("bob", tmp_path)
    (tmp_path / TEST_FILE).write_bytes(b"PK")
    with pytest.raises(InputError, match=rf"{TEST_FILE}: expected a NumPy archive"):
        load_garment("bob", tmp_path)
    np.savez(tmp_path / TEST_FILE, joints=body.joints)
    with pytest.raises(InputError, match="expected the arrays of the garment bob"):
        load_garment("bob", tmp_path)
    write_test_garments(tmp_path, joints=body.joints.astype(np.float32) + 0.1)
    with pytest.raises(InputError, match="expected garments of the shipped human, found another body's"):
        load_garment("bob", tmp_path)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("vertices", lambda a: np.where(a > a.max() - 0.01, np.nan, a)),
        ("vertices", lambda a: a[:, :2]),
        ("vertices", lambda a: a[:-1]),
        ("vertices", lambda a: np.array(["x"] * len(a))),
        ("vertices", lambda a: a[0, 0]),
        ("faces", lambda a: a + 1),
        ("faces", lambda a: a.astype(np.int64) - 1),
        ("faces", lambda a: a.astype(float)),
        ("faces", lambda a: a[:, :2]),
        ("components", lambda a: a * np.float16(np.inf)),
        ("components", lambda a: a[:-1]),
        ("components", lambda a: a[:, :-1]),
        ("weights", lambda a: 0 * a),
        ("weights", lambda a: -a.astype(float)),
        ("weights", lambda a: np.full(a.shape, np.inf)),
        ("weights", lambda a: a[:, :1]),
        ("weights", lambda a: a[:, 0]),
        ("weight_joints", lambda a: a + 100),
        ("weight_joints", lambda a: a.astype(int) - 1),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_damaged_test_garments_are_refused(key, value, tmp_path):
    write_test_garments(tmp_path)
    array = np.load(tmp_path / TEST_FILE)[f"bob_{key}"]
    write_test_garments(tmp_path, **{f"bob_{key}": value(array)})
    message = rf"{TEST_FILE}: expected .* found .*; build it with research/recipes/build_test_dress\.py"
    with pytest.raises(InputError, match=message):
        load_garment("bob", tmp_path)


def test_files_of_test_garments_have_a_largest_size(tmp_path, monkeypatch):
    monkeypatch.setattr("mimesh.bodies.dress.MAX_BYTES", 1 << 10)
    with pytest.raises(InputError, match=rf"{TEST_FILE}: expected at most 0 MB of arrays"):
        load_garment("bob", write_test_garments(tmp_path))


def test_test_garments_are_not_unpickled(tmp_path):
    write_test_garments(tmp_path, bob_vertices=np.array([Path("x"), None], dtype=object))
    with pytest.raises(InputError, match=rf"{TEST_FILE}: expected a NumPy archive of plain arrays"):
        load_garment("bob", tmp_path)


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
