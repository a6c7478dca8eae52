"""Skinning weights that a touching limb has spoilt: the surface knows what the place does not.

A network weighs a vertex by where it is, so a hand on a knee is half a knee. Over the surface the hand hangs on the
forearm, and no forearm ends in a knee: parts that such borders cut off from the rest of their surface are islands. They
are weighed anew from their shores.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.geometry import edges, face_areas, factor, links

FAR = 5
"""Joints so many bones apart do not hold neighbouring vertices."""


def clean_weights(
    weights: Float[np.ndarray, "V J"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    parents: tuple[int, ...],
) -> Float[np.ndarray, "V J"]:
    """Weights where no vertex is held by joints far from its strongest one, and islands take those of their shores."""
    if len(faces) == 0:
        return weights
    apart, pairs = bone_distances(parents), edges(faces)
    holder = weights.argmax(axis=1)
    lost = _islands(apart[holder[pairs[:, 0]], holder[pairs[:, 1]]] >= FAR, pairs, vertices, faces)
    near = np.where(apart[holder] < FAR, weights, 0.0)
    near /= near.sum(axis=1, keepdims=True)
    return _filled(near, lost, pairs) if lost.any() else near


def bone_distances(parents: tuple[int, ...]) -> Int[np.ndarray, "J J"]:
    """How many bones lie between each two joints; -1 is the root's parent."""
    apart = np.zeros((len(parents), len(parents)), np.int64)
    for j, parent in enumerate(parents):
        if parent >= 0:
            apart[j, :j] = apart[:j, j] = apart[parent, :j] + 1
    return apart


def _islands(
    border: Bool[np.ndarray, " E"],
    pairs: Int[np.ndarray, "E 2"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
) -> Bool[np.ndarray, " V"]:
    """Vertices that borders cut off from the largest part of their surface."""
    from scipy.sparse.csgraph import connected_components

    surface, part = (
        connected_components(links(kept, len(vertices)), directed=False)[1] for kept in (pairs, pairs[~border])
    )
    area = np.bincount(faces.reshape(-1), np.repeat(face_areas(vertices, faces), 3), minlength=len(vertices))
    size = np.bincount(part, area)
    largest = np.zeros(surface.max() + 1)
    np.maximum.at(largest, surface, size[part])
    return size[part] < largest[surface]


def _filled(
    weights: Float[np.ndarray, "V J"], lost: Bool[np.ndarray, " V"], pairs: Int[np.ndarray, "E 2"]
) -> Float[np.ndarray, "V J"]:
    """The lost vertices take the mean of their neighbours, which take the mean of theirs (Laplace's equation)."""
    from scipy.sparse import csr_array, diags_array

    around = links(pairs, len(weights))[lost]
    system = diags_array(around.sum(axis=1)) - around[:, lost]
    filled = weights.copy()
    filled[lost] = factor(csr_array(system)).solve(around[:, ~lost] @ weights[~lost])
    return filled
