"""Skinning weights by bounded heat equilibrium (Baran and Popovic 2007, section 4): -Laplacian w + H w = H p.

Each bone in turn is warm; its heat enters the surface where it is the nearest bone (p), at a rate H = c / distance^2,
and spreads along it. Cotangents are kept from going below zero, so the system is an M-matrix and every weight lies
between 0 and 1. Where the paper asks for the nearest bone that a vertex sees through the inside, the surface's normal
answers: a bone in front of the surface is not seen.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..geometry import face_areas, face_vectors, vertex_normals

if TYPE_CHECKING:
    from scipy.sparse import csc_array

HEAT = 2.0
"""c of the paper, which takes 1; chosen on human-npt's `val` (0.22, which imitates heat in a volume, is far worse)."""
STEEPEST = 100.0
"""Largest cotangent: slivers would otherwise weld their ends."""


def heat_weights(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    segments: Float[np.ndarray, "S 2 3"],
    owners: Int[np.ndarray, " S"],
    bones: int,
) -> Float[np.ndarray, "V J"]:
    """Weights of `bones` bones, each made of the segments that it owns; rows sum to 1, all lie in 0..1.

    Vertices that no face uses (point clouds) follow their nearest bone alone. One sparse factorisation for all bones.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    nearest, distance = nearest_segment(vertices, faces, segments)
    warm = np.zeros((len(vertices), bones))
    warm[np.arange(len(vertices)), owners[nearest]] = 1.0
    area = vertex_areas(vertices, faces)
    # A bone may touch the surface: the rate is capped at that of a thousandth of the mesh's size.
    close = 1e-3 * np.ptp(vertices, axis=0).max()
    rate = area * HEAT / np.maximum(distance, close) ** 2
    system = (cotangent_laplacian(vertices, faces) + diags_array(rate)).tocsc()
    weights = splu(system, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(rate[:, None] * warm)
    weights = np.clip(weights, 0.0, 1.0)  # rounding only: an M-matrix keeps them there
    return weights / weights.sum(axis=1, keepdims=True)


def cotangent_laplacian(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> csc_array:
    """Positive semi-definite stiffness matrix; each angle's cotangent is clamped to 0..STEEPEST."""
    from scipy.sparse import coo_array

    double_area = np.linalg.norm(face_vectors(vertices, faces), axis=1)
    floor = np.finfo(float).tiny
    rows, columns, values = [], [], []
    for k in range(3):
        corner, i, j = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        along = ((vertices[i] - vertices[corner]) * (vertices[j] - vertices[corner])).sum(-1)
        half = 0.5 * np.clip(along / np.maximum(double_area, floor), 0.0, STEEPEST)
        rows += [i, j, i, j]
        columns += [j, i, i, j]
        values += [-half, -half, half, half]
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return coo_array(entries, shape=(len(vertices), len(vertices))).tocsc()


def vertex_areas(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, " V"]:
    """A third of the area around each vertex; a trifle where there is none, so that no vertex is without heat."""
    third = np.repeat(face_areas(vertices, faces) / 3, 3)
    area = np.bincount(faces.ravel(), third, minlength=len(vertices))
    trifle = 1e-6 * area.mean() if area.any() else 1.0
    return np.maximum(area, trifle)


def nearest_segment(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], segments: Float[np.ndarray, "S 2 3"]
) -> tuple[Int[np.ndarray, " V"], Float[np.ndarray, " V"]]:
    """The nearest segment behind the surface at each vertex, or the nearest one where none is; and its distance."""
    normals = outward_normals(vertices, faces)
    distance, seen = np.empty((2, len(segments), len(vertices)))
    for s, (start, end) in enumerate(segments):
        away = closest_on_segment(vertices, start, end) - vertices
        distance[s] = np.linalg.norm(away, axis=1)
        seen[s] = np.where((away * normals).sum(-1) <= 0, distance[s], np.inf)
    chosen = np.where(np.isfinite(seen).any(axis=0), seen.argmin(axis=0), distance.argmin(axis=0))
    return chosen, distance[chosen, np.arange(len(vertices))]


def outward_normals(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "V 3"]:
    """Vertex normals, turned around if the mesh encloses a negative volume; zero for vertices without a face."""
    normals = np.where(np.isin(np.arange(len(vertices)), faces)[:, None], vertex_normals(vertices, faces), 0.0)
    centred = vertices - vertices.mean(axis=0)
    volume = (face_vectors(vertices, faces) * centred[faces].mean(axis=1)).sum()
    return -normals if volume < 0 else normals


def closest_on_segment(
    points: Float[np.ndarray, "N 3"], start: Float[np.ndarray, " 3"], end: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "N 3"]:
    """Closest point of a segment to each point; its ends may coincide."""
    along = end - start
    length = max(float(along @ along), np.finfo(float).tiny)
    return start + np.clip((points - start) @ along / length, 0.0, 1.0)[:, None] * along
