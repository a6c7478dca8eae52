"""Repair skinning weights where limbs touch.

A network predicts the weights of a vertex from its position, so a hand that rests on a knee is weighted to the leg. On
the surface, however, the hand is connected to the forearm, and no forearm borders on a knee. Edges between vertices of
joints that far apart in the skeleton are cut; the connected components that this separates from the largest one of
their surface are wrong, and are inpainted from the vertices around them.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.geometry import edges, face_areas, factor, links

MAX_BONES = 5
"""Bones between two joints from which on neighbouring vertices cannot be weighted to both; the two hips are 4 apart."""


def clean_weights(
    weights: Float[np.ndarray, "V J"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    parents: tuple[int, ...],
) -> Float[np.ndarray, "V J"]:
    """Return weights without influences far from each vertex's strongest joint, wrong components being inpainted.

    Point clouds have no connectivity: their weights are returned as they are.
    """
    if len(faces) == 0:
        return weights
    distance, pairs = bone_distances(parents), edges(faces)
    strongest = weights.argmax(axis=1)
    cut = distance[strongest[pairs[:, 0]], strongest[pairs[:, 1]]] >= MAX_BONES
    wrong = _disconnected(cut, pairs, vertices, faces)
    # Far influences are removed first: they would spread from the border into the components that are inpainted.
    near = np.where(distance[strongest] < MAX_BONES, weights, 0.0)
    near /= near.sum(axis=1, keepdims=True)
    return _inpainted(near, wrong, pairs) if wrong.any() else near


def bone_distances(parents: tuple[int, ...]) -> Int[np.ndarray, "J J"]:
    """Count the bones on the path between each two joints; -1 is the root's parent."""
    distance = np.zeros((len(parents), len(parents)), np.int64)
    for j, parent in enumerate(parents):
        if parent >= 0:  # parents come before their children: all distances of the parent are known
            distance[j, :j] = distance[:j, j] = distance[parent, :j] + 1
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
    vertex_area = np.bincount(faces.reshape(-1), np.repeat(face_areas(vertices, faces), 3), minlength=len(vertices))
    component_area = np.bincount(component, vertex_area)
    largest_area = np.zeros(surface.max() + 1)
    np.maximum.at(largest_area, surface, component_area[component])
    return component_area[component] < largest_area[surface]


def _inpainted(
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
