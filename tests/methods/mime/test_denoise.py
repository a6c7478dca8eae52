"""Smoothing for reading: sound surfaces stay to the last bit, noisy ones come near to what they were."""

import numpy as np
import pytest
import zoo
from people import person

from mimesh.bodies import load_body
from mimesh.core.mesh import Mesh
from mimesh.methods.mime.denoise import NOISY, Denoiser

BODY = load_body().mesh()


@pytest.mark.parametrize("mesh", [BODY, person(0), person(1, pose=2, faces=600)], ids=["body", "thin", "thinner"])
def test_sound_surfaces_stay(mesh):
    assert Denoiser.of(mesh)(mesh.vertices) is mesh.vertices


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_noisy_surfaces_come_near_to_what_they_were(noise):
    calm, rng = Denoiser.of(BODY), np.random.default_rng(0)
    rough = BODY.vertices + noise * rng.normal(size=BODY.vertices.shape)
    assert calm.folded(calm.ranked.merge(rough)) > NOISY
    found = calm(rough)
    before, after = (np.linalg.norm(v - BODY.vertices, axis=1).mean() for v in (rough, found))
    assert after < 0.6 * before
    assert calm.folded(calm.ranked.merge(found)) < NOISY


def test_order_does_not_matter():
    rough = BODY.vertices + 0.02 * np.random.default_rng(1).normal(size=BODY.vertices.shape)
    order = np.random.default_rng(2).permutation(len(rough))
    mixed = Mesh(BODY.vertices[order], np.argsort(order)[BODY.faces])
    assert np.array_equal(Denoiser.of(mixed)(rough[order]), Denoiser.of(BODY)(rough)[order])


@pytest.mark.parametrize("make", zoo.ZOO, ids=lambda make: make.__name__)
def test_any_surface_will_do(make):
    mesh = make()
    assert np.isfinite(Denoiser.of(mesh)(mesh.vertices)).all()


def test_folds_are_counted_over_shared_edges():
    flat = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]), np.array([[0, 1, 2], [2, 1, 3]]))
    calm = Denoiser.of(flat)
    assert len(calm.beside) == 1
    assert calm.folded(calm.ranked.merge(flat.vertices)) == 0
    folded = flat.vertices.copy()
    folded[3] = [0.1, 0.1, 0.2]
    assert calm.folded(calm.ranked.merge(folded)) == 1
