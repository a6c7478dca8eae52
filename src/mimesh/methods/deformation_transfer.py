"""Deformation transfer (Sumner and Popović, SIGGRAPH 2004): the unlearned baseline of NPT's Table 1.

It needs what no other method here does: a third mesh, the driving subject in the identity's pose (the reference), and a
correspondence. From the reference to each frame, every driving triangle has a deformation gradient S (3 x 3). Identity
triangles take those of the triangles matched to them, and the vertices follow by least squares over ||T - S||^2.

The fourth vertex that the paper adds to a target triangle is in no other triangle, so it meets its S exactly and drops
out: vertices alone are solved for. Departures from the paper:

* Triangles count by area, not alike (PMD on validation people with true correspondence 2.0e-4 against 2.1e-4 for unseen
  poses, 3.1e-4 against 3.4e-4 for seen ones), and one with several matches takes the mean of their S.
* Ties between parts that no triangle joins, placed by the driving triangles around them; the paper's meshes are whole.
* Thin triangles are left out of the identity, and replaced by their neighbours in the reference.
* Gradients do not say where the whole stands: each frame is centred where the driving's is (see `travel.py`), where the
  paper constrains a position.
* The reference is turned to the identity's heading, so that the result heads as the driving's first frame does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from ..core.canonical_order import canonical_order
from ..core.errors import InputError
from ..core.geometry import edges, face_areas, factor, gradient_operator
from ..core.mesh import Clip, Mesh
from .base import Drive
from .correspondence import match_by_index, match_by_markers, turned_alike, vertex_pairs
from .root_motion import with_root_motion

TIE = 1e-4
"""Weight of a tie, where an edge of the mesh has about 1."""
NEIGHBOURS = 8
"""How many near points of a vertex are looked at for ones of another part."""
UNITS = 10.0
"""A reference that is larger or smaller than the driving mesh by more than this is in another unit."""


@dataclass(frozen=True, eq=False)
class DeformationTransfer:
    """The method for one driving subject."""

    reference: Mesh | None
    """The driving subject in the identity's pose; vertices, faces and frame of the driving mesh, facing any way."""
    markers: Int[np.ndarray, "M 2"] | None = None
    """Pairs (identity vertex, reference vertex); without them vertex i of both is one point of the body."""
    rough: ClassVar[bool] = False
    name: str = "deformation-transfer"

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Match triangles and factor the identity's system, once for all frames.

        Raises:
            InputError: no reference, one of another topology or unit than the driving mesh, or nothing to match by.
        """
        reference = _checked(self.reference, driving.mesh)
        reference = turned_alike(reference, identity, vertex_pairs(identity, reference, self.markers))
        if self.markers is None:
            own, theirs = match_by_index(identity, reference, driving.mesh)
        else:
            own, theirs = match_by_markers(identity, reference, driving.mesh, self.markers)
        ranked = canonical_order(identity.vertices)
        follow = follower(ranked.merge(identity.vertices), ranked.group[own], reference.vertices[theirs])

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            return follow(vertices[theirs])[ranked.group]

        return lambda frames: with_root_motion(frames, pose, driving.mesh.name)


def triangle_frames(triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "P 3 3"]:
    """Columns: two edges, and the normal over the square root of its length; zero where there is no area."""
    normal = _normals(triangles)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    third = normal / np.sqrt(np.where(length > 0, length, 1.0))
    return np.stack([triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0], third], axis=-1)


def follower(
    vertices: Float[np.ndarray, "W 3"], faces: Int[np.ndarray, "P 3"], rest: Float[np.ndarray, "P 3 3"]
) -> Callable[[Float[np.ndarray, "P 3 3"]], Float[np.ndarray, "W 3"]]:
    """A function from moved driving triangles, one a face and at `rest` before, to the vertices that follow them best.

    They may stand anywhere in space. A face that comes several times follows the mean of its triangles. Ties (see
    `all_ties`) say where parts that no triangle joins stand to each other; they count so little that they bend no part.
    """
    from scipy.sparse import csr_array

    gradient = gradient_operator(vertices, faces)
    share = shares(faces)
    divergence = csr_array(gradient.T.multiply(np.repeat(share * face_areas(vertices, faces), 3)))
    ties = all_ties(vertices, faces)
    targets = tie_targets(vertices, faces, share, rest, ties)
    rows = np.repeat(np.arange(len(ties)), 2)
    tie = csr_array((np.tile([1.0, -1.0], len(ties)), (rows, ties.ravel())), shape=(len(ties), len(vertices)))
    # The first vertex stays at the origin: gradients do not say where the whole stands.
    system = factor(csr_array(divergence @ gradient + TIE * (tie.T @ tie))[1:, 1:])
    undo = np.linalg.inv(triangle_frames(rest))

    def follow(triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "W 3"]:
        wanted = triangle_frames(triangles) @ undo
        right = divergence @ wanted.transpose(0, 2, 1).reshape(-1, 3) + TIE * (tie.T @ targets(wanted, triangles))
        return np.concatenate([np.zeros((1, 3)), system.solve(right[1:])])

    return follow


def shares(faces: Int[np.ndarray, "P 3"]) -> Float[np.ndarray, " P"]:
    """One over how often each face comes: the shares of a face add up to one."""
    _, index, count = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    return 1.0 / count[index.reshape(-1)]


def tie_targets(
    vertices: Float[np.ndarray, "W 3"],
    faces: Int[np.ndarray, "P 3"],
    share: Float[np.ndarray, " P"],
    rest: Float[np.ndarray, "P 3 3"],
    ties: Int[np.ndarray, "T 2"],
) -> Callable[[Float[np.ndarray, "P 3 3"], Float[np.ndarray, "P 3 3"]], Float[np.ndarray, "T 3"]]:
    """A function from gradients and driving triangles to the offset from the second end of each tie to the first.

    Both ends are placed by the driving triangles around them, in the identity's size; what is left of their offset
    turns and stretches with the mean gradient there. So a shoe goes with its foot, and a hand leaves the hip.
    """
    from scipy.sparse import csr_array

    first, second = ties.T
    shape = (len(vertices), len(faces))
    at = csr_array((np.repeat(share, 3), (faces.ravel(), np.repeat(np.arange(len(faces)), 3))), shape=shape)
    count = np.asarray(at.sum(axis=1))[:, None]
    number, known = count[first] + count[second], (count[first] > 0) & (count[second] > 0)
    weight = share * face_areas(vertices, faces)
    ours, theirs = (_spread(triangles, weight) for triangles in (vertices[faces], rest))
    size = ours / theirs if theirs > 1e-9 else 1.0  # all triangles about one point: no size to compare
    aside = vertices - (at @ vertices[faces].mean(axis=1)) / np.maximum(count, 1)

    def apart(triangles: Float[np.ndarray, "P 3 3"], total: Float[np.ndarray, "W 9"]) -> Float[np.ndarray, "T 3"]:
        places = size * (at @ triangles.mean(axis=1)) + np.einsum("wkl,wl->wk", total.reshape(-1, 3, 3), aside)
        places = places / np.maximum(count, 1)
        return (places[first] - places[second]) * known

    left = vertices[first] - vertices[second] - apart(rest, count * np.eye(3).ravel())

    def targets(wanted: Float[np.ndarray, "P 3 3"], triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "T 3"]:
        total = at @ wanted.reshape(-1, 9)
        mean = (total[first] + total[second]) / np.maximum(number, 1)
        turn = np.where(number > 0, mean, np.eye(3).ravel()).reshape(-1, 3, 3)
        return np.einsum("tkl,tl->tk", turn, left) + apart(triangles, total)

    return targets


def all_ties(points: Float[np.ndarray, "W 3"], faces: Int[np.ndarray, "P 3"]) -> Int[np.ndarray, "T 2"]:
    """Pairs of points of different parts: those among each other's near neighbours, and what joins the rest."""
    from scipy.spatial import KDTree

    links = edges(faces)
    label, count = components(links, len(points)), min(NEIGHBOURS + 1, len(points))
    near = np.asarray(KDTree(points).query(points, k=count)[1])
    pairs = np.stack([np.repeat(np.arange(len(points)), count), near.ravel()], axis=1)
    pairs = np.unique(np.sort(pairs[label[pairs[:, 0]] != label[pairs[:, 1]]], axis=1), axis=0)
    return np.concatenate([pairs, component_ties(points, np.concatenate([links, pairs]))])


def component_ties(points: Float[np.ndarray, "W 3"], links: Int[np.ndarray, "L 2"]) -> Int[np.ndarray, "T 2"]:
    """Pairs of nearest points that join linked parts into one: C parts give C - 1 pairs (Borůvka's tree).

    A round joins every part but the largest to its nearest one.
    """
    label, ties = components(links, len(points)), np.zeros((0, 2), np.int64)
    while label.any():
        asked = np.flatnonzero(label != np.bincount(label).argmax())
        other, distance = nearest_outside(points, label, asked)
        order = np.lexsort((asked, distance))
        order = order[np.unique(label[asked[order]], return_index=True)[1]]
        pairs = np.stack([asked[order], other[order]], axis=1)
        ties = np.concatenate([ties, without_rings(pairs, distance[order], label)])
        label = components(np.concatenate([links, ties]), len(points))
    return ties


def nearest_outside(
    points: Float[np.ndarray, "W 3"], label: Int[np.ndarray, " W"], asked: Int[np.ndarray, " N"]
) -> tuple[Int[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """The nearest point of another label to each one asked for, and its distance.

    Labels that differ do so in some bit: for each bit, points are looked for among those with the other one. So L
    labels cost about log L k-d trees of all points, where a tree for each label would cost L.
    """
    from scipy.spatial import KDTree

    best, other = np.full(len(asked), np.inf), np.zeros(len(asked), np.int64)
    for bit in range(int(label.max()).bit_length()):
        side = label >> bit & 1
        for value in (0, 1):
            here, there = (np.flatnonzero(found) for found in (side[asked] == value, side != value))
            distance, near = map(np.asarray, KDTree(points[there]).query(points[asked[here]]))
            closer = distance < best[here]
            best[here[closer]], other[here[closer]] = distance[closer], there[near[closer]]
    return other, best


def without_rings(
    pairs: Int[np.ndarray, "T 2"], distance: Float[np.ndarray, " T"], label: Int[np.ndarray, " W"]
) -> Int[np.ndarray, "S 2"]:
    """Those of the pairs that join labels into trees: each once, and of a ring of equal distances not the last."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import minimum_spanning_tree

    pairs = pairs[np.lexsort((pairs[:, 0], distance))]
    sides, first = np.unique(np.sort(label[pairs], axis=1), axis=0, return_index=True)
    count = int(label.max()) + 1
    tree = minimum_spanning_tree(csr_array((first + 1.0, sides.T), shape=(count, count)))
    return pairs[tree.data.astype(np.int64) - 1]


def components(links: Int[np.ndarray, "L 2"], count: int) -> Int[np.ndarray, " W"]:
    """Which connected part each of `count` points is in, from 0; a point without a link is one by itself."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    graph = csr_array((np.ones(len(links)), links.T), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _spread(triangles: Float[np.ndarray, "P 3 3"], weight: Float[np.ndarray, " P"]) -> float:
    """Root mean square distance of triangles from their centroid: how many and how small they are does not matter."""
    points, weight = triangles.mean(axis=1), weight / weight.sum()
    return float(np.sqrt(weight @ np.square(points - weight @ points).sum(axis=1)))


def _normals(triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "P 3"]:
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def _checked(reference: Mesh | None, driving: Mesh) -> Mesh:
    """The reference, which must be the driving mesh in another pose, in one unit."""
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
    size, ours = (_length(mesh) for mesh in (driving, reference))
    if not size / UNITS <= ours <= size * UNITS:
        raise InputError(
            f"--reference: expected the size of {driving.name}, found {ours / size:.3g} times the driving's size; "
            "export both poses from one file, in one unit"
        )
    return reference


def _length(mesh: Mesh) -> float:
    """Of all sides of all faces: the same in every pose, nearly."""
    return float(
        np.linalg.norm(mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)], axis=-1).sum()
    )
