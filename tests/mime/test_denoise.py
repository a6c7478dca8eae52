"""Denoising keeps clean surfaces to the last bit, and brings noisy ones near to the clean ones."""

import numpy as np
import pytest
import zoo
from people import person

from mimesh.bodies import load_body
from mimesh.core.mesh import Mesh
from mimesh.mime.prediction import NOISY, Denoiser

BODY = load_body().mesh()


@pytest.mark.parametrize("mesh", [BODY, person(0), person(1, pose=2, faces=600)], ids=["body", "thin", "thinner"])
def test_clean_surfaces_stay(mesh):
    assert Denoiser.of(mesh)(mesh.vertices) is mesh.vertices


@pytest.mark.parametrize("noise", [0.01])
def test_noisy_surfaces_come_near_to_the_clean_ones(noise):
    denoiser, rng = Denoiser.of(BODY), np.random.default_rng(0)
    noisy = BODY.vertices + noise * rng.normal(size=BODY.vertices.shape)
    assert denoiser.folded_share(denoiser.ranked.merge(noisy)) > NOISY
    denoised = denoiser(noisy)
    before, after = (np.linalg.norm(v - BODY.vertices, axis=1).mean() for v in (noisy, denoised))
    assert after < 0.6 * before
    assert denoiser.folded_share(denoiser.ranked.merge(denoised)) < NOISY


@pytest.mark.parametrize("make", zoo.ZOO, ids=lambda make: make.__name__)
def test_denoised_vertices_of_any_mesh_are_finite(make):
    mesh = make()
    assert np.isfinite(Denoiser.of(mesh)(mesh.vertices)).all()


def test_folds_are_counted_over_shared_edges():
    flat = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]), np.array([[0, 1, 2], [2, 1, 3]]))
    denoiser = Denoiser.of(flat)
    assert len(denoiser.adjacent) == 1
    assert denoiser.folded_share(denoiser.ranked.merge(flat.vertices)) == 0
    folded = flat.vertices.copy()
    folded[3] = [0.1, 0.1, 0.2]
    assert denoiser.folded_share(denoiser.ranked.merge(folded)) == 1
