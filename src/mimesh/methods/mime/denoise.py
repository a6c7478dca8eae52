"""Surfaces made sound for reading: where triangles fold over their neighbours, area and normals say nothing, and where
they are turned inside out, normals lie.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ...core.canonical_order import CanonicalOrder, canonical_order
from ...core.geometry import edges, face_vectors, links
from ...core.mesh import Mesh

if TYPE_CHECKING:
    from scipy.sparse import csr_array

NOISY, SOUND = 0.25, 0.05
"""Share of edges over which a surface folds by more than a right angle: from the first on it is smoothed, to the other.
Sound meshes here have 0.005 to 0.07, coarse ones up to 0.2; noise of a hundredth of the size makes 0.4."""
HOLLOW = -3e-3
"""Enclosed volume over area to the power of 1.5, from which on a mesh is taken to be inside out. People: about 0.03."""
MOST = 12
"""Rounds of smoothing at most: then a surface is what it is."""


@dataclass(frozen=True, eq=False)
class Denoiser:
    """A mesh whose frames are smoothed where they are noisy, and left to the last bit where they are not."""

    ranked: CanonicalOrder
    faces: Int[np.ndarray, "F 3"]
    beside: Int[np.ndarray, "P 2"]
    """Faces that share an edge; none of a point cloud."""

    @classmethod
    def of(cls, mesh: Mesh) -> Denoiser:
        """For all frames of a mesh."""
        ranked = canonical_order(mesh.vertices)
        faces = ranked.group[mesh.faces]
        return cls(ranked, faces, _beside(faces) if len(faces) else np.zeros((0, 2), np.int64))

    @cached_property
    def mean(self) -> csr_array:
        """(W, W) of every point and its neighbours; few meshes are so noisy that it is wanted."""
        from scipy.sparse import csr_array, diags_array, eye_array

        around = links(edges(self.faces), len(self.ranked)) + eye_array(len(self.ranked))
        return csr_array(diags_array(1 / around.sum(axis=1)) @ around)

    def __call__(self, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """A frame, smoothed as often as it needs."""
        points = self.ranked.merge(vertices)
        if self.folded(points) < NOISY:
            return vertices
        for _ in range(MOST):
            points = self.mean @ points
            if self.folded(points) < SOUND:
                break
        return points[self.ranked.group]

    def folded(self, points: Float[np.ndarray, "W 3"]) -> float:
        """Share of edges over which distinct positions fold."""
        one, other = face_vectors(points, self.faces)[self.beside.T]
        return float(((one * other).sum(axis=1) < 0).mean()) if len(self.beside) else 0.0


def face_outward(mesh: Mesh) -> Mesh:
    """The mesh, its faces turned over if they all look inwards, as after a mirroring."""
    vectors = face_vectors(mesh.vertices - mesh.vertices.mean(axis=0), mesh.faces)
    corners = mesh.vertices[mesh.faces[:, 0]] - mesh.vertices.mean(axis=0)
    volume, area = (corners * vectors).sum() / 6, np.linalg.norm(vectors, axis=1).sum() / 2
    return dataclasses.replace(mesh, faces=mesh.faces[:, ::-1]) if volume < HOLLOW * area**1.5 else mesh


def _beside(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "P 2"]:
    """Pairs of faces over the edges that two of them run along in opposite ways, as on any sound surface."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    width = faces.max() + 1
    there, back = start * width + end, end * width + start
    order = np.argsort(there, kind="stable")
    place = np.searchsorted(there[order], back).clip(max=len(order) - 1)
    twin = order[place]
    found = (there[twin] == back) & (start < end)
    return np.stack([np.flatnonzero(found) // 3, twin[found] // 3], axis=1)
