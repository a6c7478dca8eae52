"""Skinning weights from the fitted body, for limbs whose joints the user has corrected.

Where the network puts a knee on the other leg, it also weights the skin there to the other leg. The body that was
fitted to corrected joints knows better: each vertex gets the weights of the nearest points of the body.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...bodies.sampled_body import PosedBody

NEAREST = 32
"""Points of the body among which the nearest ones are looked for."""
NORMAL_DISTANCE, BLUR = 0.1, 0.03
"""Distance (metres of the body) that opposite normals count as, twice; and scale over which weights are averaged."""
MOVED = 0.03
"""Displacement (metres of the body) of a joint from which on the weights of its bones are those of the body."""


def corrected_weights(
    weights: Float[np.ndarray, "N J"],
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    displacement: Float[np.ndarray, "J 3"],
    posed: PosedBody,
) -> Float[np.ndarray, "N J"]:
    """Replace predicted weights by those of the fitted body, around the joints that are not where they were predicted.

    Args:
        weights: predicted for the points.
        points: of the surface.
        normals: of the surface, zero where they are not known.
        displacement: of the joints from where they were predicted.
        posed: the fitted body.
    """
    far = np.linalg.norm(displacement, axis=1) > MOVED * posed.state.size
    # A joint turns the bones below it: those of the parent of a displaced joint have changed, too.
    changed = far.copy()
    changed[[posed.body.parents[j] for j in np.flatnonzero(far) if j > 0]] = True
    of_body = body_weights(points, normals, posed)
    share = np.maximum(weights[:, changed].sum(axis=1), of_body[:, changed].sum(axis=1))[:, None].clip(0, 1)
    return (1 - share) * weights + share * of_body


def body_weights(
    points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"], posed: PosedBody
) -> Float[np.ndarray, "N J"]:
    """Average the weights of the points of a body that are nearest to each point, and whose normals agree."""
    from scipy.spatial import KDTree

    size = posed.state.size
    distance, nearest = KDTree(posed.points).query(points, k=NEAREST)
    agreement = np.einsum("nkc,nc->nk", posed.normals[nearest], normals)
    cost = distance + NORMAL_DISTANCE * size * (1 - agreement)
    share = np.exp(-np.square((cost - cost.min(axis=1, keepdims=True)) / (BLUR * size)))
    share /= share.sum(axis=1, keepdims=True)
    return np.einsum("nk,nkj->nj", share, posed.body.weights[nearest])
