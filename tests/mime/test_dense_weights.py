"""Weights of dense surfaces: interpolated smoothly and along the surface, near those of each vertex on its own."""

import dataclasses

import numpy as np
import pytest
from people import person

from mimesh import transfer
from mimesh.core.geometry import edges, links
from mimesh.core.mesh import Mesh, permute_vertices
from mimesh.evaluate.remesh import split_faces
from mimesh.mime import model
from mimesh.mime.weights import CoarseSurface


def divided(mesh: Mesh) -> Mesh:
    """Divide every triangle into four."""
    pairs = edges(mesh.faces)
    vertices = np.concatenate([mesh.vertices, mesh.vertices[pairs].mean(axis=1)])
    return Mesh(vertices, split_faces(mesh.faces, pairs, len(mesh.vertices)), mesh.name)


@pytest.fixture(scope="module")
def dense() -> Mesh:
    return divided(divided(divided(person(0))))


def test_smooth_fields_are_carried_smoothly(dense):
    coarse = CoarseSurface.of(dense.vertices, dense.faces, 2000)
    assert 2000 < len(coarse.points) < len(dense.vertices) / 4
    error = np.linalg.norm(coarse.carried(coarse.points) - dense.vertices, axis=1) / coarse.side
    assert error.max() < 1.5
    neighbours = links(edges(dense.faces), len(dense.vertices))
    steps = error - (neighbours @ error) / neighbours.sum(axis=1)
    assert np.quantile(np.abs(steps), 0.99) < 0.25
    np.testing.assert_allclose(coarse.carried(np.ones((len(coarse.points), 1))), 1.0)


def test_nothing_is_carried_across_a_gap():
    """Two sheets that face each other, nearer than a cell is long."""
    x, z = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60), indexing="ij")
    corner = (np.arange(59)[:, None] * 60 + np.arange(59)).ravel()
    halves = [(corner, corner + 1, corner + 60), (corner + 61, corner + 60, corner + 1)]
    up = np.concatenate([np.stack(half, axis=1) for half in halves])
    sheet = np.stack([x.ravel(), np.zeros(3600), z.ravel()], axis=1)
    faces = np.concatenate([up, up[:, ::-1] + 3600])
    coarse = CoarseSurface.of(np.concatenate([sheet, sheet + [0, 0.02, 0]]), faces, 100)
    carried = coarse.carried((coarse.points[:, 1:2] > 0.01).astype(float))[:, 0]
    assert (carried[:3600] == 0).all()
    assert (carried[3600:] == 1).all()


@pytest.mark.slow
def test_results_are_near_and_do_not_depend_on_the_order(monkeypatch):
    identity, driving = divided(person(0)), person(2, 1)
    plain = transfer(identity, driving).vertices
    monkeypatch.setattr(model, "DENSE", 1000)
    moved = dataclasses.replace(identity, vertices=identity.vertices * (1 + 1e-12))  # results of `identity` are kept
    found = transfer(moved, driving).vertices
    distance = np.linalg.norm(found - plain, axis=1)
    size = np.ptp(plain, axis=0).max()
    assert 0 < np.median(distance) < 2e-3 * size
    assert distance.max() < 0.03 * size
    order = np.random.default_rng(0).permutation(len(moved.vertices))
    np.testing.assert_allclose(transfer(permute_vertices(moved, order), driving).vertices, found[order], atol=1e-9)
