"""Deformation transfer (Sumner and Popović, SIGGRAPH 2004): the baseline without learning in NPT's Table 1.

It needs what no other method here does: a third mesh, the driving subject in the identity's pose (the reference), and a
correspondence (`correspondence.py`). Every driving triangle has an affine map from the reference to each frame, whose
linear part is the deformation gradient S = V' V^-1 (3 x 3). The columns of V, and of V' in the frame, are two edges of
the triangle and the offset to a fourth vertex along its normal (`triangle_frames`). Each identity triangle takes the S
of its match, and the vertices follow by least squares: its own gradients T minimise the sum of ||T - S||^2.

The fourth vertex that the paper adds to an identity triangle is in no other triangle, so it meets its S exactly and
drops out: only vertices are solved for. Departures from the paper:

* Triangles are weighted by area, not alike (PMD on validation people with true correspondence 2.0e-4 against 2.1e-4 for
  unseen poses, 3.1e-4 against 3.4e-4 for seen ones), and one with several matches takes the mean of their S.
* Connected components are tied to each other, by the driving triangles around them; the paper's meshes have only one.
* Thin triangles are left out of the identity, and replaced by their neighbours in the reference.
* Gradients leave the position open: each frame is centred where the driving's is (`root_motion.py`), where the paper
  constrains the position of a vertex.
* The reference is turned to the identity's heading, so that the result heads as the driving's first frame does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from ..core.canonical_order import canonical_order
from ..core.errors import InputError
from ..core.geometry import edges, face_areas, factor, gradient_operator
from ..core.mesh import Clip, Mesh
from .base import Drive
from .correspondence import match_by_index, match_by_markers, turn_reference, vertex_pairs
from .root_motion import with_root_motion

TIE_WEIGHT = 1e-4
"""Weight of a tie between connected components, where an edge of the mesh has about 1."""
TIE_NEIGHBOURS = 8
"""Nearest points of a vertex among which those of other components are tied to it."""
MAX_SIZE_RATIO = 10.0
"""Ratio of the reference's size to the driving mesh's from which on it is refused: it must be in another unit."""


@dataclass(frozen=True, eq=False)
class DeformationTransfer:
    """The method `deformation-transfer`, for one driving subject."""

    reference: Mesh | None
    """The driving subject in the identity's pose, with the driving's vertices, faces and normalisation; any heading."""
    markers: Int[np.ndarray, "M 2"] | None = None
    """Pairs (identity vertex, reference vertex) that correspond; without them vertex i of both corresponds."""
    rough: ClassVar[bool] = False
    name: str = "deformation-transfer"

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Match triangles and factor the identity's system, once for all frames.

        Raises:
            InputError: no reference, one of another topology or unit than the driving mesh, or nothing to match by.
        """
        reference = _checked(self.reference, driving.mesh)
        reference = turn_reference(reference, identity, vertex_pairs(identity, reference, self.markers))
        if self.markers is None:
            identity_corners, driving_corners = match_by_index(identity, reference, driving.mesh)
        else:
            identity_corners, driving_corners = match_by_markers(identity, reference, driving.mesh, self.markers)
        ranked = canonical_order(identity.vertices)
        rest = reference.vertices[driving_corners]
        solve = deformation_solver(ranked.merge(identity.vertices), ranked.group[identity_corners], rest)

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            return solve(vertices[driving_corners])[ranked.group]

        return lambda frames: with_root_motion(frames, partial(map, pose), driving.mesh.name)


def triangle_frames(triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "P 3 3"]:
    """Return the matrices V of triangles: columns are two edges and the normal over the square root of its length.

    The root makes the third column scale as the edges do (the paper's fourth vertex). Zero where there is no area.
    """
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    third = normal / np.sqrt(np.where(length > 0, length, 1.0))
    return np.stack([triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0], third], axis=-1)


def deformation_solver(
    vertices: Float[np.ndarray, "W 3"], faces: Int[np.ndarray, "P 3"], rest: Float[np.ndarray, "P 3 3"]
) -> Callable[[Float[np.ndarray, "P 3 3"]], Float[np.ndarray, "W 3"]]:
    """Return a function from deformed driving triangles, one a face, to the vertices whose gradients match theirs best.

    `rest` are the same triangles in the reference. The position of the result as a whole is arbitrary. A face that
    occurs several times follows the mean gradient of its triangles. Ties (see `component_ties`) fix the offsets between
    connected components; their weight is too small to deform any.

    With G the gradient operator, A the areas and B the differences at the ties, the vertices x minimise
    ||G x - S||^2 weighted by A, plus TIE_WEIGHT ||B x - offsets||^2. The normal equations are
    (G^T A G + TIE_WEIGHT B^T B) x = G^T A S + TIE_WEIGHT B^T offsets. The matrix is the same in every frame.
    """
    from scipy.sparse import csr_array

    gradient = gradient_operator(vertices, faces)
    share = match_shares(faces)
    divergence = csr_array(gradient.T.multiply(np.repeat(share * face_areas(vertices, faces), 3)))
    ties = component_ties(vertices, faces)
    offsets = tie_offsets(vertices, faces, share, rest, ties)
    rows = np.repeat(np.arange(len(ties)), 2)
    difference = csr_array((np.tile([1.0, -1.0], len(ties)), (rows, ties.ravel())), shape=(len(ties), len(vertices)))
    # The first vertex is fixed at the origin, which makes the matrix invertible: gradients leave the position open.
    system = factor(csr_array(divergence @ gradient + TIE_WEIGHT * (difference.T @ difference))[1:, 1:])
    rest_inverse = np.linalg.inv(triangle_frames(rest))

    def solve(triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "W 3"]:
        gradients = triangle_frames(triangles) @ rest_inverse  # S of each triangle
        tie_side = difference.T @ offsets(gradients, triangles)
        right_side = divergence @ gradients.transpose(0, 2, 1).reshape(-1, 3) + TIE_WEIGHT * tie_side
        return np.concatenate([np.zeros((1, 3)), system.solve(right_side[1:])])

    return solve


def match_shares(faces: Int[np.ndarray, "P 3"]) -> Float[np.ndarray, " P"]:
    """Return one over the number of times that each face occurs, so that the shares of a face add up to one."""
    _, index, count = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    return 1.0 / count[index.reshape(-1)]


def tie_offsets(
    vertices: Float[np.ndarray, "W 3"],
    faces: Int[np.ndarray, "P 3"],
    share: Float[np.ndarray, " P"],
    rest: Float[np.ndarray, "P 3 3"],
    ties: Int[np.ndarray, "T 2"],
) -> Callable[[Float[np.ndarray, "P 3 3"], Float[np.ndarray, "P 3 3"]], Float[np.ndarray, "T 3"]]:
    """Return a function from gradients and driving triangles to the offset of each tie, from second to first end.

    The position of each end is predicted by the driving triangles around it, scaled to the identity's size. What this
    does not explain of the offset at rest is turned and stretched by the mean gradient there. So a shoe moves with its
    foot, and a hand that touches the hip can leave it.
    """
    from scipy.sparse import csr_array

    first, second = ties.T
    shape = (len(vertices), len(faces))
    at = csr_array((np.repeat(share, 3), (faces.ravel(), np.repeat(np.arange(len(faces)), 3))), shape=shape)
    count = np.asarray(at.sum(axis=1))[:, None]
    tie_count, known = count[first] + count[second], (count[first] > 0) & (count[second] > 0)
    weight = share * face_areas(vertices, faces)
    identity_radius, reference_radius = (_rms_radius(triangles, weight) for triangles in (vertices[faces], rest))
    # Where all triangles are at one point there is no size to compare.
    scale = identity_radius / reference_radius if reference_radius > 1e-9 else 1.0
    # Of each vertex, from the mean centroid of its triangles.
    from_centroid = vertices - (at @ vertices[faces].mean(axis=1)) / np.maximum(count, 1)

    def predicted(triangles: Float[np.ndarray, "P 3 3"], total: Float[np.ndarray, "W 9"]) -> Float[np.ndarray, "T 3"]:
        """Offset of the ends as the triangles have them; `total` is the sum of the gradients at each vertex."""
        deformed = np.einsum("wkl,wl->wk", total.reshape(-1, 3, 3), from_centroid)
        positions = (scale * (at @ triangles.mean(axis=1)) + deformed) / np.maximum(count, 1)
        return (positions[first] - positions[second]) * known

    unexplained = vertices[first] - vertices[second] - predicted(rest, count * np.eye(3).ravel())

    def offsets(
        gradients: Float[np.ndarray, "P 3 3"], triangles: Float[np.ndarray, "P 3 3"]
    ) -> Float[np.ndarray, "T 3"]:
        total = at @ gradients.reshape(-1, 9)
        mean = (total[first] + total[second]) / np.maximum(tie_count, 1)
        mean = np.where(tie_count > 0, mean, np.eye(3).ravel()).reshape(-1, 3, 3)
        return np.einsum("tkl,tl->tk", mean, unexplained) + predicted(triangles, total)

    return offsets


def component_ties(points: Float[np.ndarray, "W 3"], faces: Int[np.ndarray, "P 3"]) -> Int[np.ndarray, "T 2"]:
    """Return pairs of points of different connected components: near neighbours, and a spanning tree for the rest."""
    from scipy.spatial import KDTree

    links = edges(faces)
    label, count = component_labels(links, len(points)), min(TIE_NEIGHBOURS + 1, len(points))
    near = np.asarray(KDTree(points).query(points, k=count)[1])
    pairs = np.stack([np.repeat(np.arange(len(points)), count), near.ravel()], axis=1)
    pairs = np.unique(np.sort(pairs[label[pairs[:, 0]] != label[pairs[:, 1]]], axis=1), axis=0)
    return np.concatenate([pairs, spanning_ties(points, np.concatenate([links, pairs]))])


def spanning_ties(points: Float[np.ndarray, "W 3"], links: Int[np.ndarray, "L 2"]) -> Int[np.ndarray, "T 2"]:
    """Return pairs of nearest points that join all components of a graph: a minimum spanning tree (Borůvka's).

    C components give C - 1 pairs. In each round every component but the largest is joined to its nearest one.
    """
    label, ties = component_labels(links, len(points)), np.zeros((0, 2), np.int64)
    while label.any():
        source = np.flatnonzero(label != np.bincount(label).argmax())
        nearest, distance = nearest_of_other_label(points, label, source)
        order = np.lexsort((source, distance))
        order = order[np.unique(label[source[order]], return_index=True)[1]]  # the shortest pair of each component
        pairs = np.stack([source[order], nearest[order]], axis=1)
        ties = np.concatenate([ties, without_cycles(pairs, distance[order], label)])
        label = component_labels(np.concatenate([links, ties]), len(points))
    return ties


def nearest_of_other_label(
    points: Float[np.ndarray, "W 3"], label: Int[np.ndarray, " W"], source: Int[np.ndarray, " N"]
) -> tuple[Int[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Find the nearest point of another label to each source point; return its index and its distance.

    Labels that differ do so in some bit: for each bit, the nearest is searched among the points with the other value.
    So L labels need about 2 log2 L k-d trees, where a tree for each label would need L.
    """
    from scipy.spatial import KDTree

    best, nearest = np.full(len(source), np.inf), np.zeros(len(source), np.int64)
    for bit in range(int(label.max()).bit_length()):
        side = label >> bit & 1
        for value in (0, 1):
            queries, others = (np.flatnonzero(mask) for mask in (side[source] == value, side != value))
            distance, index = map(np.asarray, KDTree(points[others]).query(points[source[queries]]))
            closer = distance < best[queries]
            best[queries[closer]], nearest[queries[closer]] = distance[closer], others[index[closer]]
    return nearest, best


def without_cycles(
    pairs: Int[np.ndarray, "T 2"], distance: Float[np.ndarray, " T"], label: Int[np.ndarray, " W"]
) -> Int[np.ndarray, "S 2"]:
    """Return the pairs that join labels into trees: two labels once, and of a cycle of equal distances not the last."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import minimum_spanning_tree

    pairs = pairs[np.lexsort((pairs[:, 0], distance))]
    sides, first = np.unique(np.sort(label[pairs], axis=1), axis=0, return_index=True)
    count = int(label.max()) + 1
    tree = minimum_spanning_tree(csr_array((first + 1.0, sides.T), shape=(count, count)))
    return pairs[tree.data.astype(np.int64) - 1]


def component_labels(links: Int[np.ndarray, "L 2"], count: int) -> Int[np.ndarray, " W"]:
    """Label the connected component of each of `count` points, from 0; a point without a link has one of its own."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    graph = csr_array((np.ones(len(links)), links.T), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _rms_radius(triangles: Float[np.ndarray, "P 3 3"], weight: Float[np.ndarray, " P"]) -> float:
    """Return the weighted root mean square distance of triangles from their centroid, whatever their number."""
    points, weight = triangles.mean(axis=1), weight / weight.sum()
    return float(np.sqrt(weight @ np.square(points - weight @ points).sum(axis=1)))


def _checked(reference: Mesh | None, driving: Mesh) -> Mesh:
    """Return the reference, checking that it has the driving mesh's topology and unit."""
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
    size, reference_size = (_edge_length(mesh) for mesh in (driving, reference))
    if not size / MAX_SIZE_RATIO <= reference_size <= size * MAX_SIZE_RATIO:
        raise InputError(
            f"--reference: expected the size of {driving.name}, found {reference_size / size:.3g} times the driving's "
            "size; export both poses from one file, in one unit"
        )
    return reference


def _edge_length(mesh: Mesh) -> float:
    """Return the sum of the lengths of all sides of all faces: a size that hardly depends on the pose."""
    return float(
        np.linalg.norm(mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)], axis=-1).sum()
    )
