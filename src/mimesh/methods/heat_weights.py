"""Skinning weights by bounded heat equilibrium (Baran and Popovic 2007, section 4): -Laplacian w + H w = H p.

Each bone in turn is warm; its heat enters the surface where it is the nearest bone (p), at a rate H = c / distance^2,
and spreads along it. As in the paper, k bones at one distance have 1 / k each, at the rate k c / distance^2: where two
bones bend, all vertices outside the bend have the joint of both as nearest point.

Two departures. The paper takes the nearest of all bones, and no heat where the segment to it leaves the body, so that
such a vertex follows its neighbours. Here a vertex is heated by the nearest of the bones behind its surface, which its
normal tells, and by the nearest of all where none is behind. And cotangents are clamped to 0..STEEPEST, which makes
the system an M-matrix: every weight lies between 0 and 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.geometry import face_areas, face_vectors

if TYPE_CHECKING:
    from scipy.sparse import csc_array

HEAT = 2.0
"""c of the paper, which takes 1; chosen on human-npt's `val` (0.22, which imitates heat in a volume, is far worse)."""
STEEPEST = 100.0
"""Largest cotangent: slivers would otherwise weld their ends."""
TOUCHING = 1e-3
"""Nearest that a bone comes to the surface, for its heat, in sizes of the mesh: it may lie in the surface."""
ROUNDING = 1e-4
"""Part of a distance within which bones are equally near, and not in front of the surface."""
FLAT = 1e-6
"""Part of their areas that the faces around a vertex leave, below which they cancel: it has no outside."""


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

    nearest, distance = nearest_segments(vertices, faces, segments)
    warm = nearest.astype(float) @ (owners[:, None] == np.arange(bones)) > 0
    each = vertex_areas(vertices, faces) * HEAT / distance**2
    system = (cotangent_laplacian(vertices, faces) + diags_array(each * warm.sum(axis=1))).tocsc()
    weights = splu(system, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(each[:, None] * warm)
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


def nearest_segments(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], segments: Float[np.ndarray, "S 2 3"]
) -> tuple[Bool[np.ndarray, "V S"], Float[np.ndarray, " V"]]:
    """The nearest segments behind the surface at each vertex, or of all where none is; and their distance.

    There are several where they are equally near: two that share a joint often are, and rounding must not choose.
    """
    normals = outward_normals(vertices, faces)
    touching = TOUCHING * np.ptp(vertices, axis=0).max()
    distance, seen = np.empty((len(vertices), len(segments))), np.empty((len(vertices), len(segments)), bool)
    for s, (start, end) in enumerate(segments):
        away = closest_on_segment(vertices, start, end) - vertices
        distance[:, s] = np.maximum(np.linalg.norm(away, axis=1), touching)
        seen[:, s] = (away * normals).sum(-1) <= ROUNDING * distance[:, s]
    seen |= ~seen.any(axis=1, keepdims=True)
    distance[~seen] = np.inf
    nearest = distance.min(axis=1)
    return distance <= (1 + ROUNDING) * nearest[:, None], nearest


def outward_normals(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "V 3"]:
    """Vertex normals, those of each connected part turned around if it encloses a negative volume.

    Zero where there is no outside: at vertices without a face, and where faces cancel (a sheet with both windings).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    where = faces.ravel(), np.repeat(np.arange(len(faces)), 3)
    around = coo_array((np.ones(3 * len(faces)), where), shape=(len(vertices), len(faces))).tocsr()
    vectors = face_vectors(vertices, faces)
    total, size = around @ vectors, around @ np.linalg.norm(vectors, axis=1)
    part = connected_components(around @ around.T, directed=False)[1]
    heights = ((vertices - vertices.mean(axis=0))[faces].mean(axis=1) * vectors).sum(-1)
    volume = np.bincount(part[faces[:, 0]], heights, minlength=len(vertices))[part]
    length = np.linalg.norm(total, axis=1)
    safe = np.where(length > FLAT * size, length, np.inf)
    return np.where(volume < 0, -1.0, 1.0)[:, None] * total / safe[:, None]


def closest_on_segment(
    points: Float[np.ndarray, "N 3"], start: Float[np.ndarray, " 3"], end: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "N 3"]:
    """Closest point of a segment to each point; its ends may coincide."""
    along = end - start
    length = max(float(along @ along), np.finfo(float).tiny)
    return start + np.clip((points - start) @ along / length, 0.0, 1.0)[:, None] * along
