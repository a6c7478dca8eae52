"""Optional refinement of a result on the identity's own surface: as rigid as possible, and near what the method made.

Sorkine and Alexa 2007 with a pull to a target in place of fixed points. One matrix, factorised once for an identity;
a frame is a few solves. Edges are all it knows of the surface, with one weight each, so open, non-manifold and
many-parted meshes will do; vertices without an edge stay where the method put them.
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
"""How far roughness is smoothed away, in units of the identity's radius."""
ROUNDS = 3
"""Of turning neighbourhoods, then moving vertices."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """An identity's surface, ready to pull results back to its shape."""

    ranked: CanonicalOrder
    """Vertices at one place are one: a seam cannot open."""
    pairs: Int[np.ndarray, "E 2"]
    rest: Float[np.ndarray, "E 3"]
    """Each edge as it was."""
    gather: csr_array
    """(W, E) sums over the edges of each vertex, whichever end it is."""
    spread: csr_array
    """(W, E) the same with signs: forces along edges to forces on vertices."""
    system: SuperLU
    pull: Float[np.ndarray, "W 1"]
    """Of each vertex towards its target, in units of an edge's weight."""

    @classmethod
    def of(cls, identity: Mesh, reach: float = REACH) -> Refinement | None:
        """For an identity; None for a point cloud, which has no surface to keep."""
        from scipy.sparse import csr_array, diags_array

        ranked = canonical_order(identity.vertices)
        faces = ranked.group[identity.faces]
        pairs = edges(faces) if len(faces) else np.zeros((0, 2), np.int64)
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        if len(pairs) == 0:
            return None
        vertices = ranked.merge(identity.vertices)
        count, one = len(vertices), np.ones(len(pairs))
        index, edge = pairs.T.reshape(-1), np.tile(np.arange(len(pairs)), 2)
        shape = (count, len(pairs))
        gather = csr_array((np.tile(one, 2), (index, edge)), shape=shape)
        spread = csr_array((np.concatenate([one, -one]), (index, edge)), shape=shape)
        rest = vertices[pairs[:, 0]] - vertices[pairs[:, 1]]
        pull = _pull(gather, rest, reach * radius(vertices - bbox_centre(vertices)))
        system = factor(csr_array(spread @ spread.T + diags_array(pull)))
        return cls(ranked, pairs, rest, gather, spread, system, pull[:, None])

    def __call__(self, result: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """The result, its edges turned and stretched less unevenly."""
        target = self.ranked.merge(result)
        points = target
        for _ in range(ROUNDS):
            now = points[self.pairs[:, 0]] - points[self.pairs[:, 1]]
            products = (now[:, :, None] * self.rest[:, None]).reshape(len(now), 9)
            turn = nearest_rotation((self.gather @ products).reshape(-1, 3, 3))
            wanted = ((turn[self.pairs[:, 0]] + turn[self.pairs[:, 1]]) @ self.rest[..., None])[..., 0] / 2
            points = self.system.solve(self.spread @ wanted + self.pull * target)
        return points[self.ranked.group]


def _pull(gather: csr_array, rest: Float[np.ndarray, "E 3"], reach: float) -> Float[np.ndarray, " W"]:
    """A grid of springs carries a change as far as its edge over the root of this; of loose vertices it is 1."""
    count = gather.sum(axis=1)
    length = gather @ np.square(rest).sum(axis=1) / np.maximum(count, 1)
    return np.where(count > 0, np.maximum(length / reach**2, 1e-4), 1.0)
