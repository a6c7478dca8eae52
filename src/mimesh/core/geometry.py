"""Geometry of triangle meshes: normals, areas, edges, welding, sampling and resampling. NumPy and SciPy only."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

if TYPE_CHECKING:
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import SuperLU

MIRROR = np.array([-1.0, 1.0, 1.0])
"""Factors on coordinates for the reflection at the plane x = 0."""
ORTHOGONAL = 1e-8
"""Largest entry of M^T M - I with which a matrix M needs one Newton step to be a rotation to the last digits."""


def turned(vertices: Float[np.ndarray, "*T V 3"], angle: float) -> Float[np.ndarray, "*T V 3"]:
    """Turn points about y by an angle (radians) from z towards x.

    Number by number: products of matrices may round rows of equal points differently, and `weld` would separate them.
    """
    sine, cosine = np.sin(angle), np.cos(angle)
    x, y, z = (vertices[..., k] for k in range(3))
    return np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)


def face_vectors(vertices: Float[np.ndarray, "*T V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "*T F 3"]:
    """Compute the cross product of two edges of each face: its normal times twice its area."""
    a, b, c = (np.take(vertices, faces[:, k], axis=-2) for k in range(3))
    return np.cross(b - a, c - a)


def face_areas(vertices: Float[np.ndarray, "*T V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "*T F"]:
    """Compute the area of each triangle."""
    return 0.5 * np.linalg.norm(face_vectors(vertices, faces), axis=-1)


def face_centroids(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """Compute the mean of the corners of each triangle."""
    # One corner at a time: the same bits as a mean over (F, 3, 3) in a third of the time.
    a, b, c = (np.take(vertices, faces[:, k], axis=0) for k in range(3))
    return (a + b + c) / 3


def vertex_areas(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, " V"]:
    """Compute the area of each vertex: a third of its triangles'."""
    third = np.repeat(face_areas(vertices, faces) / 3, 3)
    # Without faces, bincount returns integers.
    return np.bincount(faces.ravel(), third, minlength=len(vertices)).astype(vertices.dtype, copy=False)


def face_normals(vertices: Float[np.ndarray, "*T V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "*T F 3"]:
    """Compute unit normals of triangles; those without area get +y."""
    return _unit_or_up(face_vectors(vertices, faces))


def vertex_normals(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "V 3"]:
    """Compute area-weighted unit normals; vertices without faces, or whose face normals cancel, get +y."""
    vectors, corners = np.repeat(face_vectors(vertices, faces), 3, axis=0), faces.ravel()
    sums = [np.bincount(corners, vectors[:, k], minlength=len(vertices)) for k in range(3)]
    return _unit_or_up(np.stack(sums, axis=1).astype(float))


def nearest_points(
    points: Float[np.ndarray, "N C"], queries: Float[np.ndarray, "M C"], count: int = 1
) -> tuple[Float[np.ndarray, "M *K"], Int[np.ndarray, "M *K"]]:
    """Find the nearest of some points to each query: distance and index; of several, the nearest comes first."""
    from scipy.spatial import KDTree

    distance, index = KDTree(points).query(queries, k=count)
    return np.asarray(distance), np.asarray(index)


def component_labels(joined: Int[np.ndarray, "L 2"], count: int) -> Int[np.ndarray, " W"]:
    """Label the connected component of each of `count` points, from 0; a point without a link has one of its own."""
    from scipy.sparse.csgraph import connected_components

    return connected_components(links(joined, count), directed=False)[1].astype(np.int64)


def unit_vectors(vectors: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
    """Normalise vectors to length 1; zero vectors stay zero, and those with NaN or infinity become NaN."""
    with np.errstate(over="ignore", invalid="ignore"):  # of damaged files, whose vectors `check_mesh` then refuses
        length = np.linalg.norm(vectors, axis=-1, keepdims=True)
        return vectors / np.where(length == 0, 1.0, np.where(np.isfinite(length), length, np.nan))


def finite_or_zero(rows: Float[np.ndarray, "*N C"]) -> Float[np.ndarray, "*N C"]:
    """Replace rows with NaN or infinity by zeros: what exporters write as normals or texture coordinates of faces
    without area says nothing, and is no reason to refuse a mesh."""
    return np.where(np.isfinite(rows).all(axis=-1, keepdims=True), rows, 0.0)


def continuous_quaternions(
    quaternions: Float[np.ndarray, "T *J 4"], first: Float[np.ndarray, "*J 4"] | None = None
) -> Float[np.ndarray, "T *J 4"]:
    """Choose the signs of unit quaternions so that each is near the one before, and those of frame 0 near `first`.

    q and -q are one rotation, but interpolation between both passes through zero in programs that do not take the
    shorter arc.
    """
    before = np.concatenate([quaternions[:1] if first is None else first[None], quaternions[:-1]])
    flipped = (quaternions * before).sum(axis=-1) < 0
    return quaternions * np.cumprod(np.where(flipped, -1.0, 1.0), axis=0)[..., None]


def smooth_step(values: Float[np.ndarray, "*S"], limits: tuple[float, float]) -> Float[np.ndarray, "*S"]:
    """Map values to 0 below the first limit and 1 above the second, smoothly in between (Hermite's cubic)."""
    x = np.clip((values - limits[0]) / (limits[1] - limits[0]), 0, 1)
    return x * x * (3 - 2 * x)


def gradient_operator(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> csr_array:
    """Build the sparse gradient of functions on the vertices: row 3 f + k is the derivative along axis k in triangle f.

    The derivative along a triangle's normal is zero. With areas as weights, G^T G is the cotangent Laplacian. Every
    triangle must have an area.
    """
    from scipy.sparse import csr_array

    normals = face_vectors(vertices, faces)
    square = np.square(normals).sum(-1, keepdims=True)
    opposite = [vertices[faces[:, k - 1]] - vertices[faces[:, k - 2]] for k in range(3)]
    # The gradient of corner k's hat function: the opposite edge turned by 90 degrees, over twice the area.
    hats = np.stack([np.cross(normals, edge) / square for edge in opposite], axis=-1)
    rows = np.repeat(np.arange(3 * len(faces)), 3)
    columns = np.repeat(faces, 3, axis=0).ravel()
    return csr_array((hats.ravel(), (rows, columns)), shape=(3 * len(faces), len(vertices)))


def edges(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "E 2"]:
    """List each undirected edge once, smaller index first, sorted."""
    first, second, _ = _counted_edges(faces)
    return np.stack([first, second], axis=1)


def border_edges(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "E 2"]:
    """List the undirected edges of one triangle only, smaller index first, sorted."""
    first, second, count = _counted_edges(faces)
    return np.stack([first, second], axis=1)[count == 1]


def _counted_edges(
    faces: Int[np.ndarray, "F 3"],
) -> tuple[Int[np.ndarray, " E"], Int[np.ndarray, " E"], Int[np.ndarray, " E"]]:
    """List the smaller and the larger index of each undirected edge, sorted, and how many sides of faces it is."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    width = np.int64(faces.max(initial=0)) + 1
    # One number for each edge: numbers are sorted many times faster than rows.
    keys = np.minimum(start, end) * width + np.maximum(start, end)
    keys, count = np.unique(keys, return_counts=True)
    return (keys // width).astype(faces.dtype), (keys % width).astype(faces.dtype), count


def distinct_rows(columns: Sequence[np.ndarray]) -> tuple[Int[np.ndarray, " D"], Int[np.ndarray, " N"]]:
    """Find the D distinct rows of a table given as columns of N numbers, sorted by the first column, then the next.

    Returns:
        The index of the first of the equal rows, and the number of each row among the distinct ones: what
        `np.unique(..., axis=0)` returns, without comparing rows byte by byte, which takes several times as long.
    """
    # Equal rows are adjacent once sorted; a new one begins where any column differs from the row before.
    order = np.lexsort(tuple(columns)[::-1])
    new = np.zeros(len(order), bool)
    new[:1] = True
    for column in columns:
        ordered = column[order]
        new[1:] |= ordered[1:] != ordered[:-1]
    number = np.empty(len(order), np.int64)
    number[order] = np.cumsum(new) - 1
    return order[new], number


def links(pairs: Int[np.ndarray, "E 2"], count: int) -> csr_array:
    """Build the symmetric adjacency matrix (V, V) of pairs of vertices; its product sums over neighbours."""
    from scipy.sparse import csr_array

    both = np.concatenate([pairs, pairs[:, ::-1]])
    return csr_array((np.ones(len(both)), both.T), shape=(count, count))


def neighbours(faces: Int[np.ndarray, "F 3"]) -> tuple[Int[np.ndarray, " S"], Int[np.ndarray, " N"]]:
    """List the neighbours of each vertex as (first, index): those of vertex v are `index[first[v]:first[v + 1]]`."""
    both = edges(faces)
    both = np.concatenate([both, both[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    return np.searchsorted(both[:, 0], np.arange(int(faces.max()) + 2)), both[:, 1]


def spatial_order(points: Float[np.ndarray, "N 3"]) -> Int[np.ndarray, " N"]:
    """Order points so that near points have near indices: the leaves of a k-d tree split along the longest side."""
    cells = [np.arange(len(points))]
    while any(len(cell) > 1 for cell in cells):
        axes = [np.ptp(points[cell], axis=0).argmax() for cell in cells]
        ordered = (c[np.argsort(points[c, axis], kind="stable")] for c, axis in zip(cells, axes, strict=True))
        cells = [half for cell in ordered for half in (cell[: len(cell) // 2], cell[len(cell) // 2 :]) if len(half)]
    return np.concatenate(cells)


def weld(vertices: Float[np.ndarray, "V 3"]) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, " V"]]:
    """Merge vertices at equal positions: the W distinct positions, sorted by x, y, z, and each vertex's index in them.

    Positions must be exactly equal: a tolerance would join surfaces that only touch. `merged[index]` are the vertices.
    """
    first, index = distinct_rows(list(vertices.T))
    return vertices[first], index


def first_of_each(group: Int[np.ndarray, " V"]) -> Int[np.ndarray, " W"]:
    """Find the first vertex of each of the groups 0 to W - 1; vertices of number -1 are in none."""
    first, members = np.empty(int(group.max(initial=-1)) + 1, np.int64), np.flatnonzero(group >= 0)[::-1]
    first[group[members]] = members  # of several values for one entry the last one stays
    return first


def normal_turner(
    corner_normals: Float[np.ndarray, "F 3 3"], faces: Int[np.ndarray, "F 3"], before: Float[np.ndarray, "V 3"]
) -> Callable[[Float[np.ndarray, "V 3"]], Float[np.ndarray, "F 3 3"]]:
    """Return the function from moved vertices to turned corner normals; it keeps hard edges and custom normals.

    Corners at one position with one normal form a smooth fan. Each fan has a frame: its area-weighted normal, and its
    first edge projected into the tangent plane. A corner normal keeps its coordinates in the frame of its fan. So a
    rigid motion turns every normal with it, and the normals of an unmoved fan are unchanged to the last bit.
    """
    from scipy.sparse import csr_array

    _, position = weld(before)
    # A key of welded position and rounded normal for each corner: normals of a fan are equal to 1e-4.
    fans = distinct_rows([position[faces.ravel()], *np.round(corner_normals.reshape(-1, 3) * 1e4).T])[1]
    first = np.unique(fans, return_index=True)[1]
    following = first - first % 3 + (first % 3 + 1) % 3
    start, end = faces.ravel()[first], faces.ravel()[following]
    gather = csr_array(
        (np.ones(len(fans)), (fans, np.repeat(np.arange(len(faces)), 3))), shape=(len(first), len(faces))
    )

    def fan_frames(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "S 3 3"]:
        """Compute the frame of each fan; rows are normal, tangent, bitangent."""
        normal = _unit_or_up(np.asarray(gather @ face_vectors(vertices, faces)).reshape(-1, 3))
        edge = vertices[end] - vertices[start]
        tangent = _unit_or_up(edge - normal * (edge * normal).sum(-1, keepdims=True))
        return np.stack([normal, tangent, np.cross(normal, tangent)], axis=1)

    rest, old = corner_normals.reshape(-1, 3), fan_frames(before)
    coordinates = np.einsum("ckd,cd->ck", old[fans], rest)

    def turn(after: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "F 3 3"]:
        new = fan_frames(after)
        # Rounding would change the normals of unmoved fans, so these are copied.
        moved = (new != old).any(axis=(1, 2))[fans]
        turned = np.einsum("ckd,ck->cd", new[fans], coordinates)
        return np.where(moved[:, None], turned, rest).reshape(corner_normals.shape)

    return turn


def rotate_between(
    old: Float[np.ndarray, "N 3"], new: Float[np.ndarray, "N 3"], vectors: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "N 3"]:
    """Rotate each vector by the smallest rotation from unit vector `old` to unit vector `new` (Rodrigues' formula).

    Opposite ones have no unique rotation; there it is half a turn about an axis that depends on `old` alone.
    """
    axis = np.cross(old, new)  # its length is the sine of the angle
    cosine = (old * new).sum(-1, keepdims=True)
    opposite = cosine < -1 + 1e-9
    safe = np.where(opposite, 1.0, 1.0 + cosine)
    turned = vectors * cosine + np.cross(axis, vectors) + axis * (axis * vectors).sum(-1, keepdims=True) / safe
    across = unit_vectors(np.cross(old, np.eye(3)[np.abs(old).argmin(axis=-1)]))
    half = 2 * across * (across * vectors).sum(-1, keepdims=True) - vectors
    return np.where(opposite, half, turned)


def rotation_between(old: Float[np.ndarray, " 3"], new: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Compute the matrix of the smallest rotation from direction `old` to direction `new`."""
    return rotations_between(old[None], new[None])[0]


def rotations_between(old: Float[np.ndarray, "#T 3"], new: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3 3"]:
    """Compute the matrices of the smallest rotations from directions `old` to `new`; none where one has no length."""
    olds, news = (np.repeat(np.broadcast_to(unit_vectors(of), new.shape), 3, axis=0) for of in (old, new))
    # The rotated unit vectors are the columns of the matrices.
    columns = rotate_between(olds, news, np.tile(np.eye(3), (len(new), 1)))
    found = np.swapaxes(columns.reshape(-1, 3, 3), -1, -2)
    known = np.logical_and(old.any(axis=-1), new.any(axis=-1))
    return np.where(np.reshape(known, (-1, 1, 1)), found, np.eye(3))


def frames_along(first: Float[np.ndarray, "*N 3"], second: Float[np.ndarray, "*#N 3"]) -> Float[np.ndarray, "*N 3 3"]:
    """Build frames with the first column along a vector and the second in the plane of both vectors."""
    x = unit_vectors(first)
    y = unit_vectors(second - (second * x).sum(axis=-1, keepdims=True) * x)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def slerp(
    start: Float[np.ndarray, "*B J 3 3"], stop: Float[np.ndarray, "*B J 3 3"], fraction: Float[np.ndarray, "*B 1"]
) -> Float[np.ndarray, "*B J 3 3"]:
    """Interpolate rotations spherically: at `fraction` (0..1) of the smallest rotation from `start` to `stop`."""
    from scipy.spatial.transform import Rotation

    difference = Rotation.from_matrix((np.swapaxes(start, -1, -2) @ stop).reshape(-1, 3, 3)).as_rotvec()
    fractions = np.broadcast_to(fraction, start.shape[:-2]).reshape(-1, 1)
    return start @ Rotation.from_rotvec(difference * fractions).as_matrix().reshape(start.shape)


def angles_between(
    first: Float[np.ndarray, "*#B 3 3"], second: Float[np.ndarray, "*#B 3 3"]
) -> Float[np.ndarray, "*C"]:
    """Compute the angles (degrees) between corresponding rotations."""
    cosine = (np.einsum("...ab,...ab->...", first, second) - 1) / 2  # trace(A^T B) = 1 + 2 cos(angle)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))  # numpy makes a scalar of a single angle


def mirrored_rotations(rotation: Float[np.ndarray, "*B 3 3"]) -> Float[np.ndarray, "*B 3 3"]:
    """Reflect rotations at the plane x = 0: F R F for the reflection F = diag(MIRROR)."""
    return rotation * MIRROR[:, None] * MIRROR


def nearest_rotation(matrix: Float[np.ndarray, "*B 3 3"]) -> Float[np.ndarray, "*B 3 3"]:
    """Compute the rotation nearest to each matrix (Frobenius norm); for a sum of rotations it is their mean."""
    excess = matrix.swapaxes(-1, -2) @ matrix - np.eye(3)
    if np.abs(excess).max(initial=0.0) < ORTHOGONAL and (np.linalg.det(matrix) > 0).all():
        return matrix - matrix @ excess / 2  # a Newton step; it takes a tenth of the time
    u, _, vt = np.linalg.svd(matrix)
    # A negative determinant would be a reflection: flip the direction of the smallest singular value.
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt


def rigid_motion(
    points: Float[np.ndarray, "N 3"], target: Float[np.ndarray, "N 3"], weights: Float[np.ndarray, " N"] | None = None
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Find the rigid motion x -> rotation x + offset that moves points nearest to a target (Kabsch 1976).

    Args:
        weights: of the points, which sum to 1; equal ones by default.
    """
    weights = np.full(len(points), 1 / len(points)) if weights is None else weights
    centre, goal = weights @ points, weights @ target
    rotation = nearest_rotation(np.einsum("n,na,nb->ab", weights, target - goal, points - centre))
    return rotation, goal - rotation @ centre


def factor(matrix: csr_array) -> SuperLU:
    """Factorise a sparse symmetric positive definite matrix once, to solve many right-hand sides."""
    from scipy.sparse.linalg import splu

    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _unit_or_up(vectors: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
    return np.where(vectors.any(axis=-1, keepdims=True), unit_vectors(vectors), [0.0, 1.0, 0.0])


CANDIDATES = 12
"""Faces that `closest_on_mesh` tests for each point."""


def closest_on_mesh(
    points: Float[np.ndarray, "N 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    normals: Float[np.ndarray, "N 3"] | None = None,
) -> tuple[Int[np.ndarray, " N"], Float[np.ndarray, "N 3"], Float[np.ndarray, " N"]]:
    """Find the closest surface point of each query point: face index, barycentric coordinates, distance.

    Only the CANDIDATES faces with the nearest centroids are tested. That is exact if the query is close to a mesh of
    fairly even triangles. With `normals`, faces whose normal is 90 degrees or
    more from the query's are ignored; the distance is infinite if no candidate is left.
    """
    # Candidate columns are tested one after the other, for all points at once.
    near = nearest_points(face_centroids(vertices, faces), points, min(CANDIDATES, len(faces)))[1]
    near = near.reshape(len(points), -1)
    best_distance = np.full(len(points), np.inf)
    best_face, best_weights = near[:, 0].copy(), np.zeros((len(points), 3))
    for column in near.T:
        weights = closest_barycentric(points, vertices[faces[column]])
        distance = np.linalg.norm(np.einsum("nk,nkc->nc", weights, vertices[faces[column]]) - points, axis=1)
        closer = distance < best_distance
        if normals is not None:
            closer &= (face_vectors(vertices, faces[column]) * normals).sum(-1) > 0
        best_distance[closer], best_face[closer], best_weights[closer] = (
            distance[closer],
            column[closer],
            weights[closer],
        )
    return best_face, best_weights, best_distance


def closest_barycentric(
    points: Float[np.ndarray, "N 3"], triangles: Float[np.ndarray, "N 3 3"]
) -> Float[np.ndarray, "N 3"]:
    """Compute the barycentric coordinates of the point of triangle i closest to query point i."""
    # It is the projection to the plane if that is inside the triangle, else the closest point of the three edges.
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    square = np.maximum((normal * normal).sum(-1), np.finfo(float).tiny)
    # Signed areas of the sub-triangles over that of the triangle.
    u = (np.cross(c - b, points - b) * normal).sum(-1) / square
    v = (np.cross(a - c, points - c) * normal).sum(-1) / square
    inside = np.stack([u, v, 1 - u - v], axis=1)
    weights, best = inside, np.where((inside >= 0).all(axis=1), -1.0, np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, end = triangles[:, i], triangles[:, j]
        span = end - start
        length = np.maximum((span * span).sum(-1), np.finfo(float).tiny)
        t = np.clip(((points - start) * span).sum(-1) / length, 0, 1)
        distance = np.linalg.norm(start + t[:, None] * span - points, axis=1)
        on_edge = np.zeros_like(weights)
        on_edge[:, i], on_edge[:, j] = 1 - t, t
        closer = distance < best
        weights, best = np.where(closer[:, None], on_edge, weights), np.where(closer, distance, best)
    return weights
