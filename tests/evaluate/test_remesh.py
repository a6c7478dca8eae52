"""Remeshings: their points are on the body in any pose, and vertex counts and removed parts are as documented."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose
from mimesh.core.geometry import edges, face_areas
from mimesh.evaluate import remesh
from mimesh.evaluate.pairs import human

BODY = human()
POSED = BODY.posed(np.ones(3), rotvec_to_rotmat(sample_pose(BODY, 0, 0)))


def rng():
    return np.random.default_rng(0)


COMPLETE = {
    "decimated": remesh.decimated,
    "retriangulated": remesh.retriangulated,
    "subdivided": remesh.subdivided,
    "points": lambda: remesh.points(BODY, 500, rng()),
}
DAMAGED = {
    "holes": lambda: remesh.holes(BODY, rng()),
    "cropped": lambda: remesh.cropped(BODY, rng()),
    "half": lambda: remesh.half(BODY, POSED, rng()),
}


@pytest.mark.slow
def test_points_lie_on_the_posed_body():
    """Each point is a weighted mean of the corners of one triangle or edge, or is a vertex."""
    parts = {frozenset(corners) for corners in (*BODY.faces.tolist(), *edges(BODY.faces).tolist())}
    parts |= {frozenset([v]) for v in range(len(POSED))}
    for name, make in (COMPLETE | DAMAGED).items():
        remeshed = make()
        assert np.allclose(remeshed.barycentric.sum(axis=1), 1), name
        assert remeshed.barycentric.min() > -1e-9, name
        assert {frozenset(corners) for corners in remeshed.corners.tolist()} <= parts, name
        naive = sum(remeshed.barycentric[7, k] * POSED[remeshed.corners[7, k]] for k in range(3))
        assert np.allclose(remeshed.positions(POSED)[7], naive), name
        assert remeshed.faces.max(initial=0) < len(remeshed.corners), name


@pytest.mark.parametrize("name", COMPLETE)
def test_complete_remeshings_cover_the_body(name):
    gap = KDTree(COMPLETE[name]().positions(POSED)).query(POSED)[0]
    assert gap.max() < 0.25


@pytest.mark.parametrize("name", ["decimated", "retriangulated", "subdivided"])
def test_remeshed_surfaces_keep_their_area_and_stay_closed(name):
    remeshed = COMPLETE[name]()
    assert face_areas(remeshed.positions(BODY.vertices), remeshed.faces).sum() == pytest.approx(
        face_areas(BODY.vertices, BODY.faces).sum(), rel=0.02
    )
    assert len(edges(remeshed.faces)) == pytest.approx(len(remeshed.faces) * 3 / 2, rel=2e-3)


def test_counts_of_vertices_and_triangles():
    assert len(remesh.decimated().faces) == pytest.approx(len(BODY.faces) / 5, abs=3)
    assert (len(remesh.subdivided().corners), len(remesh.subdivided().faces)) == (27_554, 4 * len(BODY.faces))
    assert len(remesh.retriangulated().faces) == pytest.approx(len(BODY.faces), abs=3)
    shared = KDTree(BODY.vertices).query(remesh.retriangulated().positions(BODY.vertices))[0]
    assert (shared < 1e-6).mean() < 0.5


def test_damaged_remeshings_remove_the_documented_share():
    remaining = {name: len(make().corners) / len(BODY.vertices) for name, make in DAMAGED.items()}
    assert 0.5 < remaining["holes"] < 0.97
    assert 0.8 < remaining["cropped"] < 0.97
    assert 0.4 < remaining["half"] < 0.8
    area = face_areas(POSED, BODY.faces).sum()
    one_side = remesh.half(BODY, POSED, rng())
    assert face_areas(one_side.positions(POSED), one_side.faces).sum() == pytest.approx(area / 2, rel=0.15)


def test_nearest_equals_a_naive_search():
    remeshed = remesh.decimated()
    selected = np.array([10, 3000, 6000])
    naive = [np.linalg.norm(remeshed.positions(POSED) - POSED[v], axis=1).argmin() for v in selected]
    assert np.array_equal(remeshed.nearest(POSED, selected), naive)
