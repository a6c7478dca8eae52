"""Prepare surfaces for the network: smooth noisy ones, and flip those that are inside out.

The network takes points sampled by area, and their normals. Noise makes both meaningless, inverted faces the normals.
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

NOISY, SMOOTH = 0.25, 0.05
"""Share of folded edges (more than a right angle between the faces) from which on a surface is smoothed, and down to
which. Meshes without noise have 0.005 to 0.07, coarse ones up to 0.2; noise of 1 % of the size makes 0.4."""
INVERTED = -3e-3
"""Enclosed volume over area to the power of 1.5 below which a mesh is taken to be inside out; people: about 0.03."""
MAX_ROUNDS = 12
"""Rounds of smoothing after which a surface is left as it is."""


@dataclass(frozen=True, eq=False)
class Denoiser:
    """A mesh topology that smooths noisy frames, and returns all others unchanged to the last bit."""

    ranked: CanonicalOrder
    """Distinct positions of the mesh: seams are smoothed as if they were welded."""
    faces: Int[np.ndarray, "F 3"]
    """Faces between distinct positions."""
    adjacent: Int[np.ndarray, "P 2"]
    """Pairs of faces that share an edge; none for a point cloud."""

    @classmethod
    def of(cls, mesh: Mesh, ranked: CanonicalOrder | None = None) -> Denoiser:
        """Make the denoiser for all frames of a mesh; `ranked` is the canonical order of its vertices, if known."""
        ranked = canonical_order(mesh.vertices) if ranked is None else ranked
        faces = ranked.group[mesh.faces]
        return cls(ranked, faces, _adjacent_faces(faces) if len(faces) else np.zeros((0, 2), np.int64))

    @cached_property
    def mean(self) -> csr_array:
        """(W, W): the mean of every point and its neighbours. Made when first needed: few meshes are noisy."""
        from scipy.sparse import csr_array, diags_array, eye_array

        neighbours = links(edges(self.faces), len(self.ranked)) + eye_array(len(self.ranked))
        return csr_array(diags_array(1 / neighbours.sum(axis=1)) @ neighbours)

    def __call__(self, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """Smooth a frame, replacing points by the mean of their neighbourhood until few edges are folded."""
        points = self.ranked.merge(vertices)
        if self.folded_share(points) < NOISY:
            return vertices
        for _ in range(MAX_ROUNDS):
            points = self.mean @ points
            if self.folded_share(points) < SMOOTH:
                break
        return points[self.ranked.group]

    def folded_share(self, points: Float[np.ndarray, "W 3"]) -> float:
        """Return the share of edges whose two faces have normals more than 90 degrees apart."""
        first, second = face_vectors(points, self.faces)[self.adjacent.T]
        return float(((first * second).sum(axis=1) < 0).mean()) if len(self.adjacent) else 0.0


def face_outward(mesh: Mesh) -> Mesh:
    """Reverse all faces of a mesh that is inside out, as meshes are after a mirroring."""
    vectors = face_vectors(mesh.vertices - mesh.vertices.mean(axis=0), mesh.faces)
    corners = mesh.vertices[mesh.faces[:, 0]] - mesh.vertices.mean(axis=0)
    # The signed volumes of the tetrahedra from the centroid to each face add up to the enclosed volume.
    volume, area = (corners * vectors).sum() / 6, np.linalg.norm(vectors, axis=1).sum() / 2
    return dataclasses.replace(mesh, faces=mesh.faces[:, ::-1]) if volume < INVERTED * area**1.5 else mesh


def _adjacent_faces(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "P 2"]:
    """Return pairs of faces that share an edge and wind alike: one has it from a to b, the other from b to a."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    width = faces.max() + 1
    # One number for each directed edge; where the opposite number is found by bisection, two faces share the edge.
    forward, backward = start * width + end, end * width + start
    order = np.argsort(forward, kind="stable")
    position = np.searchsorted(forward[order], backward).clip(max=len(order) - 1)
    opposite = order[position]
    shared = (forward[opposite] == backward) & (start < end)
    return np.stack([np.flatnonzero(shared) // 3, opposite[shared] // 3], axis=1)
