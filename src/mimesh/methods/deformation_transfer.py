"""Deformation transfer (Sumner and Popović, SIGGRAPH 2004): the unlearned baseline of NPT's Table 1.

It needs what no other method here does: a third mesh, the driving subject in the identity's pose (the reference), and a
correspondence. From the reference to each frame, every driving triangle has a deformation gradient S (3 x 3). Identity
triangles take those of the triangles matched to them, and the vertices follow by least squares over ||T - S||^2.

Two departures. The fourth vertex that the paper adds to a target triangle is in no other triangle, so it meets its S
exactly and drops out: vertices alone are solved for. Triangles count by area, not alike (PMD on validation people with
true correspondence 2.0e-4 against 2.1e-4 for unseen poses, 3.1e-4 against 3.4e-4 for seen ones).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..geometry import edges, face_areas, gradient_operator
from ..mesh import InputError, Mesh
from . import Drive
from .correspondence import factor, match_by_index, match_by_markers
from .pairing import rank_vertices
from .travel import travelling

if TYPE_CHECKING:
    from scipy.spatial import KDTree

FEW = 64
"""Parts of fewer points look for their neighbours among all points, larger ones in a tree of the others."""


@dataclass(frozen=True, eq=False)
class DeformationTransfer:
    """The method for one driving subject."""

    reference: Mesh | None
    """The driving subject in the identity's pose and heading; vertices, faces and frame of the driving mesh."""
    markers: Int[np.ndarray, "M 2"] | None = None
    """Pairs (identity vertex, reference vertex); without them vertex i of both is one point of the body."""
    name: str = "deformation-transfer"

    def prepare(self, identity: Mesh, driving: Mesh) -> Drive:
        """Match triangles and factor the identity's system, once for all frames.

        Raises:
            InputError: no reference, one with another topology than the driving mesh, or nothing to match by.
        """
        reference = _checked(self.reference, driving)
        if self.markers is None:
            own, theirs = match_by_index(identity, reference, driving)
        else:
            own, theirs = match_by_markers(identity, reference, driving, self.markers)
        ranked = rank_vertices(identity.vertices)
        follow = follower(ranked.merge(identity.vertices), ranked.group[own])
        undo = np.linalg.inv(triangle_frames(reference.vertices[theirs]))

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            return follow(triangle_frames(vertices[theirs]) @ undo)[ranked.group]

        return lambda frames: travelling(frames, pose, driving.name)


def triangle_frames(triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "P 3 3"]:
    """Columns: two edges, and the normal over the square root of its length; zero where there is no area."""
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(first, second)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([first, second, normal / np.sqrt(np.where(length > 0, length, 1.0))], axis=-1)


def follower(
    vertices: Float[np.ndarray, "W 3"], faces: Int[np.ndarray, "P 3"]
) -> Callable[[Float[np.ndarray, "P 3 3"]], Float[np.ndarray, "W 3"]]:
    """A function from the triangles' wanted gradients to vertices that come nearest to them, anywhere in space.

    Parts that no triangle joins keep their offset at the nearest pair of vertices, which turns and stretches as the
    triangles there do.
    """
    from scipy.sparse import csr_array

    gradient = gradient_operator(vertices, faces)
    divergence = csr_array(gradient.T.multiply(np.repeat(face_areas(vertices, faces), 3)))
    ties = component_ties(vertices, faces)
    offset = vertices[ties[:, 0]] - vertices[ties[:, 1]]
    around = _mean_around(ties, faces, len(vertices))
    rows = np.repeat(np.arange(len(ties)), 2)
    tie = csr_array((np.tile([1.0, -1.0], len(ties)), (rows, ties.ravel())), shape=(len(ties), len(vertices)))
    # The first vertex stays at the origin: gradients do not say where the whole stands.
    system = factor(csr_array(divergence @ gradient + tie.T @ tie)[1:, 1:])

    def follow(wanted: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "W 3"]:
        turned = np.einsum("tkl,tl->tk", around(wanted), offset)
        right = divergence @ wanted.transpose(0, 2, 1).reshape(-1, 3) + tie.T @ turned
        return np.concatenate([np.zeros((1, 3)), system.solve(right[1:])])

    return follow


def component_ties(points: Float[np.ndarray, "W 3"], faces: Int[np.ndarray, "P 3"]) -> Int[np.ndarray, "T 2"]:
    """Pairs of nearest points that join the parts of a mesh into one: C parts give C - 1 pairs (Borůvka's forest)."""
    from scipy.spatial import KDTree

    label, tree, ties = components(faces, len(points)), KDTree(points), []
    while label.any():
        parts = np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label))[:-1])
        largest = max(parts, key=len)
        found = sorted(_nearest_outside(tree, part) for part in parts if part is not largest)
        for _, inside, outside in found:
            if label[inside] != label[outside]:
                ties.append((inside, outside))
                label[label == label[outside]] = label[inside]
        label = np.unique(label, return_inverse=True)[1]
    return np.array(ties, np.int64).reshape(-1, 2)


def components(faces: Int[np.ndarray, "P 3"], count: int) -> Int[np.ndarray, " W"]:
    """Which connected part each of `count` vertices is in, from 0; a vertex without a face is one by itself."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    pairs = edges(faces)
    return connected_components(csr_array((np.ones(len(pairs)), pairs.T), shape=(count, count)))[1].astype(np.int64)


def _nearest_outside(tree: KDTree, part: Int[np.ndarray, " N"]) -> tuple[float, int, int]:
    """Distance, point of the part and point outside it, of the nearest such pair."""
    points, few = np.asarray(tree.data), len(part) < FEW
    others = np.arange(len(points)) if few else np.delete(np.arange(len(points)), part)
    # Among one more neighbour than a part has points, one is outside.
    search, count = (tree, len(part) + 1) if few else (type(tree)(points[others]), 1)
    distance, near = (np.asarray(found).reshape(len(part), count) for found in search.query(points[part], k=count))
    distance = np.where(np.isin(others[near], part), np.inf, distance)
    row, column = divmod(int(distance.argmin()), count)
    return float(distance[row, column]), int(part[row]), int(others[near[row, column]])


def _mean_around(
    ties: Int[np.ndarray, "T 2"], faces: Int[np.ndarray, "P 3"], count: int
) -> Callable[[Float[np.ndarray, "P 3 3"]], Float[np.ndarray, "T 3 3"]]:
    """A function from one matrix a face to their mean over the faces at both ends of each tie (no face: identity)."""
    from scipy.sparse import csr_array

    at = csr_array((np.ones(faces.size), (faces.ravel(), np.repeat(np.arange(len(faces)), 3))), (count, len(faces)))
    both = at[ties[:, 0]] + at[ties[:, 1]]
    number = both.sum(axis=1)[:, None, None]

    def mean(matrices: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "T 3 3"]:
        total = (both @ matrices.reshape(-1, 9)).reshape(-1, 3, 3)
        return np.where(number > 0, total / np.maximum(number, 1), np.eye(3))

    return mean


def _checked(reference: Mesh | None, driving: Mesh) -> Mesh:
    """The reference, which must be the driving mesh in another pose."""
    if reference is None:
        raise InputError(
            f"{driving.name}: expected the same subject in the identity's pose beside it for model "
            "deformation-transfer, found none; give that mesh with --reference"
        )
    if len(reference.vertices) != len(driving.vertices) or not np.array_equal(reference.faces, driving.faces):
        raise InputError(
            f"{reference.name}: expected the vertices and faces of {driving.name} ({len(driving.vertices)} and "
            f"{len(driving.faces)}), found others ({len(reference.vertices)} and {len(reference.faces)}); "
            "export both poses from one file"
        )
    return reference
