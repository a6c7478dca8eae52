"""Refine results: as-rigid-as-possible deformation of the identity's surface towards what the method made.

Sorkine and Alexa (2007), with a quadratic term that pulls each vertex to its target in place of fixed points. The
matrix is factored once for an identity; a frame is a few solves. Only the edges of the surface are used, all with one
weight, so open and non-manifold meshes and those of several components are refined too. Vertices without an edge stay
where the method put them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..core.canonical_order import CanonicalOrder, canonical_order
from ..core.geometry import edges, factor, nearest_rotation
from ..core.mesh import Mesh
from ..core.normalization import bbox_centre, radius

if TYPE_CHECKING:
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import SuperLU

REACH = 0.07
"""Distance over which roughness is smoothed away, in radii of the identity."""
ROUNDS = 3
"""Alternations between rotating neighbourhoods (local step) and moving vertices (global step)."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """An identity's surface with its factored matrix, ready to refine results."""

    ranked: CanonicalOrder
    """Distinct positions of the identity: vertices at one position stay together, so that seams cannot open."""
    pairs: Int[np.ndarray, "E 2"]
    """Edges between distinct positions."""
    rest: Float[np.ndarray, "E 3"]
    """Each edge vector in the identity, from its second end to its first."""
    gather: csr_array
    """(W, E): sums over the edges at each vertex."""
    spread: csr_array
    """(W, E): the same with the sign of the end, which is the transpose of the difference operator."""
    system: SuperLU
    """Factors of the graph Laplacian plus `pull`."""
    pull: Float[np.ndarray, "W 1"]
    """Weight of each vertex's distance from its target, where an edge has 1."""

    @classmethod
    def of(cls, identity: Mesh, reach: float = REACH) -> Refinement | None:
        """Prepare an identity; None for a point cloud, which has no surface."""
        from scipy.sparse import csr_array, diags_array

        ranked = canonical_order(identity.vertices)
        faces = ranked.group[identity.faces]
        pairs = edges(faces) if len(faces) else np.zeros((0, 2), np.int64)
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        if len(pairs) == 0:
            return None
        vertices = ranked.merge(identity.vertices)
        count, ones = len(vertices), np.ones(len(pairs))
        index, edge = pairs.T.reshape(-1), np.tile(np.arange(len(pairs)), 2)
        shape = (count, len(pairs))
        gather = csr_array((np.tile(ones, 2), (index, edge)), shape=shape)
        spread = csr_array((np.concatenate([ones, -ones]), (index, edge)), shape=shape)
        rest = vertices[pairs[:, 0]] - vertices[pairs[:, 1]]
        pull = _pull(gather, rest, reach * radius(vertices - bbox_centre(vertices)))
        system = factor(csr_array(spread @ spread.T + diags_array(pull)))
        return cls(ranked, pairs, rest, gather, spread, system, pull[:, None])

    def __call__(self, result: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """Refine a result: edges get lengths nearer to the identity's, vertices stay near their targets."""
        target = self.ranked.merge(result)
        points = target
        for _ in range(ROUNDS):
            # Local step: the rotation of each vertex that maps its edges at rest best onto those of now (Kabsch).
            edge = points[self.pairs[:, 0]] - points[self.pairs[:, 1]]
            products = (edge[:, :, None] * self.rest[:, None]).reshape(len(edge), 9)
            rotation = nearest_rotation((self.gather @ products).reshape(-1, 3, 3))
            # Global step: least squares for the positions, with the edges at rest, rotated as their ends are.
            rotated = ((rotation[self.pairs[:, 0]] + rotation[self.pairs[:, 1]]) @ self.rest[..., None])[..., 0] / 2
            points = self.system.solve(self.spread @ rotated + self.pull * target)
        return points[self.ranked.group]


def _pull(gather: csr_array, rest: Float[np.ndarray, "E 3"], reach: float) -> Float[np.ndarray, " W"]:
    """Return the weight of each vertex's target by which roughness is smoothed over the distance `reach`.

    On a grid with edges of length l, a Laplacian with the weight (l / reach)^2 damps a change over that distance.
    Vertices without an edge have the weight 1.
    """
    count = gather.sum(axis=1)
    length = gather @ np.square(rest).sum(axis=1) / np.maximum(count, 1)
    return np.where(count > 0, np.maximum(length / reach**2, 1e-4), 1.0)
