"""Tiny named meshes, valid and degenerate, for tests that run over all of them."""

from __future__ import annotations

import numpy as np

from mimesh.core.mesh import Clip, Mesh


def tetrahedron() -> Mesh:
    """Make a closed mesh of 4 vertices and 4 triangles."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    return Mesh(vertices, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]), name="tetrahedron")


def cube() -> Mesh:
    """Make a closed unit cube of 8 vertices and 12 triangles that face outwards."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Mesh(vertices, np.array(faces), name="cube")


def grid(n: int = 5) -> Mesh:
    """Make an open sheet of n x n vertices in the plane z = 0 that faces +z."""
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    vertices = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + n, corner + n + 1], 1), np.stack([corner, corner + n + 1, corner + 1], 1)]
    )
    return Mesh(vertices, faces, name="grid")


def ring() -> Mesh:
    """A torus: no limbs at all."""
    across, along = np.meshgrid(*(np.linspace(0, 2 * np.pi, n, endpoint=False) for n in (10, 30)), indexing="ij")
    radius = 1 + 0.25 * np.cos(across)
    vertices = np.stack([radius * np.cos(along), 0.25 * np.sin(across), radius * np.sin(along)], axis=-1)
    index = np.arange(300).reshape(10, 30)
    corners = [np.roll(index, shift, (0, 1)) for shift in ((0, 0), (-1, 0), (-1, -1), (0, -1))]
    a, b, c, d = (corner.ravel() for corner in corners)
    return Mesh(vertices.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), name="ring")


def boxes(name: str, *pieces: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Mesh:
    """Make a mesh of boxes, each with its middle and its size: furniture, and figures of blocks."""
    box = cube()
    vertices = np.concatenate([(box.vertices - 0.5) * size + middle for middle, size in pieces])
    return Mesh(vertices, np.concatenate([box.faces + 8 * k for k in range(len(pieces))]), name=name)


def table() -> Mesh:
    """A narrow table, whose four legs fit an animal."""
    feet = [((x, 0.5, z), (0.05, 1, 0.05)) for x in (-0.35, 0.35) for z in (-0.1, 0.1)]
    return boxes("table", ((0, 1, 0), (0.8, 0.06, 0.3)), *feet)


def figure() -> Mesh:
    """A person of six boxes, the same from the front and from behind."""
    arms = [((x, 22, 0), (12, 4, 4)) for x in (-10, 10)]
    legs = [((x, 6, 0), (3.9, 12, 4)) for x in (-2, 2)]
    return boxes("figure", ((0, 28, 0), (8, 8, 8)), ((0, 18, 0), (8, 12, 4)), *arms, *legs)


def two_parts() -> Mesh:
    """Make a mesh of two connected components: a tetrahedron and a cube."""
    first, second = tetrahedron(), cube()
    vertices = np.concatenate([first.vertices, second.vertices + [3, 0, 0]])
    return Mesh(vertices, np.concatenate([first.faces, second.faces + 4]), name="two_parts")


def bow_tie() -> Mesh:
    """Make a non-manifold mesh: two triangles that share only a vertex, and three triangles at one edge."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0.5, 0.5, 1]], float)
    return Mesh(vertices, np.array([[0, 1, 2], [0, 3, 4], [0, 1, 5], [0, 1, 6]]), name="bow_tie")


def point_cloud() -> Mesh:
    """Make a mesh of 50 points without faces."""
    return Mesh(np.random.default_rng(0).normal(size=(50, 3)), np.zeros((0, 3), int), name="point_cloud")


ZOO = (tetrahedron, cube, grid, two_parts, bow_tie, point_cloud)
"""All of them."""


def moving_cube(frames: int = 4) -> Clip:
    """Return a cube that is bent more in each frame, at 30 frames a second."""
    mesh = cube()
    bent = [mesh.vertices + t * np.sin(3 * mesh.vertices[:, ::-1]) / 5 for t in range(frames)]
    return Clip(mesh, np.stack(bent), 30.0)
