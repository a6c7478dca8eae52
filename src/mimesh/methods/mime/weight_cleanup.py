"""Repair skinning weights: where limbs touch, and of pieces that move rigidly.

A network predicts the weights of a vertex from its position, so a hand that rests on a knee is weighted to the leg. On
the surface, however, the hand is connected to the forearm, and no forearm borders on a knee. Edges between vertices of
joints that far apart in the skeleton are cut; the connected components that this separates from the largest one of
their surface are wrong, and are inpainted from the vertices around them.

Swords, hats, shin guards and the blocks of block figures are pieces of their own, not connected to the rest, which one
joint moves. Predicted weights of such a piece vary over it, which would bend it: it gets the joint of most of it. What
reaches far from the body, such as a sword, gets the joint where it is nearest to the body. A box that stands for a
whole arm or leg has no vertices to bend at: it gets the first joint of this limb.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.geometry import edges, factor, links, vertex_areas
from ...core.rig import descendants
from ..confidence import limb_joints
from .body_fit import NearestBody, sampled_body

RIGID_SHARE, SMALL_SHARE, SMALL_AREA, BODY_SHARE = 0.65, 0.5, 0.01, 0.3
"""A piece moves rigidly if one joint has more than the first share of its weight, or the second of a piece with less
than SMALL_AREA of the surface; BODY_SHARE of what counts are the fitted body's weights. Chosen on 1,875 pieces of
characters (docs/log/mime.md, "Pieces")."""
FAR, ATTACHED = 0.05, 0.1
"""A piece also moves rigidly if its vertices are farther from the fitted body than this (median, metres of the body);
its joint is that of the share of its vertices that is nearest to the body. Of 412 garments and other pieces that bend,
in the pool's `train` and `val` characters, the median is below 0.04 (docs/log/mime.md)."""
BLOCK_VERTICES, BLOCK_AREA, LIMB_SHARE = 24, 0.02, 0.9
"""A piece of at most so many vertices and more than this share of the surface moves rigidly too (of 17 such pieces of
the pool's characters 16 do); its joint is the last one whose subtree has LIMB_SHARE of its weight to its limb."""
LARGEST_PART = 0.5
"""Share of the surface from which on a piece is the figure itself, neither a block of it nor something it holds."""
MAX_BONES = 5
"""Bones between two joints from which on neighbouring vertices cannot be weighted to both; the two hips are 4 apart.
The trunk of an animal may be one joint's, beside those of the legs, so its bones are not counted."""


def clean_weights(
    weights: Float[np.ndarray, "V J"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    parents: tuple[int, ...],
    nearest: NearestBody | None = None,
    trunk: Collection[int] = (),
) -> Float[np.ndarray, "V J"]:
    """Return weights without influences far from each vertex's strongest joint, wrong components being inpainted.

    Args:
        trunk: joints at the ends of bones that are not counted.
        nearest: of each vertex, on the body that was fitted to the surface; None if there is none.

    Point clouds have no connectivity: their weights are returned as they are.
    """
    if len(faces) == 0:
        return weights
    distance, pairs = bone_distances(parents, trunk), edges(faces)
    strongest = weights.argmax(axis=1)
    cut = distance[strongest[pairs[:, 0]], strongest[pairs[:, 1]]] >= MAX_BONES
    wrong = _disconnected(cut, pairs, vertices, faces)
    # Far influences are removed first: they would spread from the border into the components that are inpainted.
    near = np.where(distance[strongest] < MAX_BONES, weights, 0.0)
    near /= near.sum(axis=1, keepdims=True)
    whole = inpainted(near, wrong, pairs) if wrong.any() else near
    return _rigid_pieces(whole, vertices, faces, pairs, nearest)


def _rigid_pieces(
    weights: Float[np.ndarray, "V J"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    pairs: Int[np.ndarray, "E 2"],
    nearest: NearestBody | None,
) -> Float[np.ndarray, "V J"]:
    """Give pieces of the surface that one joint moves to this joint alone."""
    from scipy.ndimage import median
    from scipy.sparse.csgraph import connected_components

    count, piece = connected_components(links(pairs, len(vertices)), directed=False)
    vertex_area = vertex_areas(vertices, faces)
    area = np.bincount(piece, vertex_area, minlength=count)
    mixed = weights if nearest is None else (1 - BODY_SHARE) * weights + BODY_SHARE * nearest.weights
    columns = (np.bincount(piece, column * vertex_area, minlength=count) for column in mixed.T)
    summed = np.stack(list(columns), axis=1)
    joint, share = summed.argmax(axis=1), summed.max(axis=1) / np.maximum(area, 1e-30)
    small = area < SMALL_AREA * area.sum()
    rigid = (area > 0) & ((share > RIGID_SHARE) | (small & (share > SMALL_SHARE)))
    if nearest is not None:
        parts = ~rigid & (area > 0) & (area < LARGEST_PART * area.sum())
        size = np.bincount(piece)
        blocks = parts & (size <= BLOCK_VERTICES) & (area > BLOCK_AREA * area.sum())
        for k in np.flatnonzero(blocks):
            joint[k], rigid[k] = _block_joint(summed[k], nearest.body), True
        far = parts & ~blocks & (median(nearest.distance, piece, np.arange(count)) > FAR)
        members = np.split(np.argsort(piece, kind="stable"), np.cumsum(size)[:-1])
        for k in np.flatnonzero(far):
            joint[k], rigid[k] = _attachment(members[k], mixed, nearest.distance), True
    if not rigid.any():
        return weights
    moved_by_one = np.flatnonzero(rigid[piece])
    weights = weights.copy()
    weights[moved_by_one] = np.eye(weights.shape[1])[joint[piece[moved_by_one]]]
    return weights


def _block_joint(weights: Float[np.ndarray, " J"], body: str) -> int:
    """Find the joint of a block from its summed weights."""
    limb = max(_limbs(body), key=lambda joints: weights[joints].sum())
    parents, total = sampled_body(body).parents, weights[limb].sum()
    shares = {j: weights[np.intersect1d(limb, descendants([int(j)], parents))].sum() for j in limb}
    return int(max(j for j, share in shares.items() if share >= LIMB_SHARE * total))  # children come after parents


@cache
def _limbs(name: str) -> list[Int[np.ndarray, " L"]]:
    """List the joints of the trunk and of each limb of a shipped body."""
    body = sampled_body(name)
    limbs = [np.array(joints) for joints in limb_joints(body.names, body.parents).values()]
    return [np.setdiff1d(np.arange(len(body.parents)), np.concatenate(limbs)), *limbs]


def _attachment(
    vertices: Int[np.ndarray, " P"], weights: Float[np.ndarray, "V J"], distance: Float[np.ndarray, " V"]
) -> int:
    """Find the joint of a piece where it is nearest to the body."""
    near = vertices[np.argsort(distance[vertices])[: max(3, int(ATTACHED * len(vertices)))]]
    return int(weights[near].sum(axis=0).argmax())


def bone_distances(parents: tuple[int, ...], uncounted: Collection[int] = ()) -> Int[np.ndarray, "J J"]:
    """Count the bones on the path between each two joints, but for those from the parents of some joints.

    The root's parent is -1.
    """
    distance = np.zeros((len(parents), len(parents)), np.int64)
    for j, parent in enumerate(parents):
        if parent >= 0:  # parents come before their children: all distances of the parent are known
            distance[j, :j] = distance[:j, j] = distance[parent, :j] + (j not in uncounted)
    return distance


def _disconnected(
    cut: Bool[np.ndarray, " E"],
    pairs: Int[np.ndarray, "E 2"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
) -> Bool[np.ndarray, " V"]:
    """Find the vertices that are separated from the largest component (by area) of their surface when edges are cut.

    Components of the mesh as it was (eyes, shoes) are surfaces of their own, each with its own largest component.
    """
    from scipy.sparse.csgraph import connected_components

    surface, component = (
        connected_components(links(uncut, len(vertices)), directed=False)[1] for uncut in (pairs, pairs[~cut])
    )
    component_area = np.bincount(component, vertex_areas(vertices, faces))
    largest_area = np.zeros(surface.max() + 1)
    np.maximum.at(largest_area, surface, component_area[component])
    return component_area[component] < largest_area[surface]


def inpainted(
    weights: Float[np.ndarray, "V J"], wrong: Bool[np.ndarray, " V"], pairs: Int[np.ndarray, "E 2"]
) -> Float[np.ndarray, "V J"]:
    """Replace wrong weights by the solution of Laplace's equation, the weights of all other vertices being fixed.

    Each replaced weight is then the mean of those of its neighbours: n w_i = sum of w_j over the n neighbours j. With
    the unknown neighbours on the left and the known ones on the right this is one sparse linear system.
    """
    from scipy.sparse import csr_array, diags_array

    adjacency = links(pairs, len(weights))[wrong]
    laplacian = diags_array(adjacency.sum(axis=1)) - adjacency[:, wrong]
    inpainted = weights.copy()
    inpainted[wrong] = factor(csr_array(laplacian)).solve(adjacency[:, ~wrong] @ weights[~wrong])
    return inpainted
