"""Refinement keeps rigid motions, smooths noise, and accepts any surface."""

import numpy as np
import pytest
import zoo
from people import person
from scipy.spatial.transform import Rotation

from mimesh.core.geometry import edges
from mimesh.core.mesh import Mesh
from mimesh.evaluate.metrics import pmd_aligned
from mimesh.pipeline.refine import Refinement
from mimesh.pipeline.report import edge_lengths, edge_stretch

IDENTITY, POSED = person(0), person(0, pose=2)


def test_rigid_motions_of_the_identity_are_kept():
    refine = Refinement.of(IDENTITY)
    turn = Rotation.from_rotvec([0.4, 1.3, -0.2]).as_matrix()
    for moved in (IDENTITY.vertices, 3 + IDENTITY.vertices @ turn.T):
        assert np.allclose(refine(moved), moved, atol=1e-9)


def test_noise_is_smoothed_and_the_pose_is_kept():
    noise = 0.01 * np.random.default_rng(0).normal(size=POSED.vertices.shape)
    rough = POSED.vertices + noise
    refined = Refinement.of(IDENTITY)(rough)
    pairs = edges(IDENTITY.faces)
    assert pmd_aligned(refined, POSED.vertices) < 1.2 * pmd_aligned(rough, POSED.vertices)
    posed = edge_lengths(POSED.vertices, pairs)
    before, after = (edge_stretch(posed, edge_lengths(v, pairs)).mean() - 1 for v in (rough, refined))
    assert after < 0.5 * before
    clean = Refinement.of(IDENTITY)(POSED.vertices)
    assert pmd_aligned(clean, POSED.vertices) < 1e-4


@pytest.mark.parametrize("make", zoo.ZOO, ids=lambda make: make.__name__)
def test_refined_vertices_of_any_mesh_are_finite(make):
    mesh = make()
    refine = Refinement.of(mesh)
    moved = mesh.vertices + 0.01 * np.random.default_rng(2).normal(size=mesh.vertices.shape)
    if refine is None:
        assert len(mesh.faces) == 0
        return
    assert np.isfinite(refine(moved)).all()
    used = np.unique(mesh.faces)
    loose = np.setdiff1d(np.arange(len(mesh.vertices)), used)
    assert np.allclose(refine(moved)[loose], moved[loose], atol=1e-9) or len(loose) == 0


def test_seams_stay_closed():
    count = len(IDENTITY.vertices)
    doubled = Mesh(np.tile(IDENTITY.vertices, (2, 1)), np.concatenate([IDENTITY.faces, IDENTITY.faces[::2] + count]))
    refined = Refinement.of(doubled)(np.tile(POSED.vertices, (2, 1)))
    assert np.array_equal(refined[:count], refined[count:])
