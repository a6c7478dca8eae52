"""Repair skinning weights of a tail that hangs between the hind legs and was taken for them.

A network predicts the weights of a vertex from its position, so the lower part of a long tail gets those of the nearer
hind leg, its left half those of the left one. On the surface no left shin borders on a right one: where they do, that
is a tail. It is the part around its tip up to where the surface is held by joints of the tail, and gets their weights.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from ...bodies.anatomy import QUADRUPED
from ...bodies.character_limbs import SIDES
from ...core.geometry import edges, vertex_areas
from ...core.rig import descendants
from .weight_cleanup import inpainted

TAIL = "Tail1"
"""First joint of a tail."""
LARGEST_TAIL = 0.06
"""Share of the surface that the part of a tail has at most: that of the shipped animals' tails is below 0.05."""
SMALLEST_LEG = 0.005
"""Share of the surface that each hind leg below its knee has beside it at least."""


def with_whole_tail(
    weights: Float[np.ndarray, "V J"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    names: tuple[str, ...],
    parents: tuple[int, ...],
) -> Float[np.ndarray, "V J"]:
    """Return weights in which no tail is held by hind legs; the same where there is none, and of other bodies."""
    if TAIL not in names or len(faces) == 0:
        return weights
    wrong = taken_for_legs(weights.argmax(axis=1), vertices, faces, names, parents)
    return inpainted(weights, wrong, edges(faces)) if wrong.any() else weights


def taken_for_legs(
    strongest: Int[np.ndarray, " V"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    names: tuple[str, ...],
    parents: tuple[int, ...],
) -> Bool[np.ndarray, " V"]:
    """Find the vertices of a tail that are held by both hind legs, and those of it from there to its tip.

    Args:
        strongest: joint with the largest weight of each vertex.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components, dijkstra

    nothing, pairs = np.zeros(len(vertices), bool), edges(faces)
    knees = {leg[0].removesuffix("Thigh"): leg[1] for leg in QUADRUPED.legs if leg[0].endswith("Thigh")}
    left, right = (np.isin(strongest, descendants([names.index(knees[side])], parents)) for side in SIDES)
    tail = np.isin(strongest, descendants([names.index(TAIL)], parents))
    first, second = pairs.T
    border = pairs[(left[first] & right[second]) | (right[first] & left[second])]
    if len(border) == 0 or not tail.any():
        return nothing
    low = left | right
    within = pairs[low[first] & low[second]]
    graph = coo_array((np.ones(len(within)), tuple(within.T)), shape=(len(vertices),) * 2)
    part = connected_components(graph, directed=False)[1]
    both = np.isin(part, part[border[:, 0]]) & low
    length = np.linalg.norm(vertices[first] - vertices[second], axis=1)
    surface = coo_array((np.maximum(length, 1e-9), (first, second)), shape=graph.shape).tocsr()
    from_tail = dijkstra(surface, directed=False, indices=np.flatnonzero(tail), min_only=True)
    tip = int(np.where(both & np.isfinite(from_tail), from_tail, -1.0).argmax())
    from_tip = dijkstra(surface, directed=False, indices=tip)
    found = from_tip < from_tip[tail].min()
    area = vertex_areas(vertices, faces)
    whole = min(area[of_leg & ~found].sum() for of_leg in (left, right)) > SMALLEST_LEG * area.sum()
    return found if both[tip] and whole and area[found].sum() < LARGEST_TAIL * area.sum() else nothing
