"""A second surface inside, as image-to-mesh models leave one: the outer one moves as without it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from people import person

from mimesh.core.geometry import vertex_normals
from mimesh.core.mesh import Mesh
from mimesh.pipeline import transfer

DEPTH = 0.01
"""Of the inner surface below the outer one, in metres."""


@pytest.mark.slow
def test_an_inner_shell_stays_inside_and_leaves_the_outer_one():
    outer = dataclasses.replace(person(0, faces=2000), up="+y")
    inner = outer.vertices - DEPTH * vertex_normals(outer.vertices, outer.faces)
    faces = np.concatenate([outer.faces, outer.faces[:, ::-1] + len(inner)])
    shell, driving = Mesh(np.concatenate([outer.vertices, inner]), faces, "shell", up="+y"), person(1, pose=1)
    alone, both = (transfer(mesh, driving).mesh.vertices for mesh in (outer, shell))
    without, within = both[: len(inner)], both[len(inner) :]
    height = np.ptp(outer.vertices[:, 1])
    assert np.linalg.norm(without - alone, axis=1).mean() < 0.01 * height
    assert np.quantile(np.linalg.norm(within - without, axis=1), [0.01, 0.9]) == pytest.approx(DEPTH, rel=0.3)
    below = ((without - within) * vertex_normals(without, outer.faces)).sum(axis=1)
    assert np.quantile(below, 0.05) > DEPTH / 2
