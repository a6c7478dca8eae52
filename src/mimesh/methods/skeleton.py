"""The baseline `skeleton` (NPT, appendix C.1): fit a body to both meshes, skin the identity to its bones, move those.

The fits use point sets only, and half of the shape components. The identity keeps its own bone lengths: each bone takes
the rotation from its fit to the driving's fit, and starts where its parent ends.

Skinning weights are by heat equilibrium (Baran and Popovic 2007, section 4): -Laplacian w + H w = H p for each bone.
The bone has temperature 1 and all others 0; heat enters each vertex from its nearest bone (p is 1 where that is this
bone) at the rate H = c / distance^2 and spreads over the surface. The temperature w of a vertex is its weight. As in
the paper, k bones at one distance have 1 / k each, at the rate k c / distance^2: where two bones meet at an angle, all
vertices on the outer side have their common joint as nearest point.

Two departures. The paper takes the nearest of all bones, and no heat where the segment to it leaves the body, so that
such a vertex follows its neighbours. Here a vertex is heated by the nearest of the bones behind its surface (on the
inner side of its normal), and by the nearest of all where none is behind. And cotangents are clamped to
0..MAX_COTANGENT, which makes the system an M-matrix: every weight lies between 0 and 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from ..bodies import RiggedBody, load_body
from ..bodies.chamfer_fit import BodyParameters, fit_points, thin_body
from ..core.canonical_order import CanonicalOrder, canonical_order
from ..core.geometry import face_vectors, vertex_areas
from ..core.mesh import Clip, Mesh
from ..core.skinning import place_joints, skin_points
from ..core.surface_points import rounded, surface_sampler
from .base import Drive, with_root_motion

if TYPE_CHECKING:
    from scipy.sparse import csc_array

POINTS = 4000
"""Points of each mesh, and of the body, between which the fits measure distances."""
HEAT = 2.0
"""c of the paper, which takes 1; chosen on human-npt's `val` (0.22, which imitates heat in a volume, is far worse)."""
MAX_COTANGENT = 100.0
"""Largest cotangent: those of slivers would force equal weights on their ends."""
MIN_DISTANCE = 1e-3
"""Smallest distance of a bone to a vertex for its heat, in extents of the mesh: bones may lie in the surface."""
TOLERANCE = 1e-4
"""Share of a distance within which bones count as equally near, and as not in front of the surface."""
CANCELLING = 1e-6
"""Share of the area around a vertex that its summed face normals must exceed; else they cancel: it has no outside."""


@dataclass(frozen=True, eq=False)
class SkeletonBaseline:
    """The method `skeleton`, for people whose shape and pose the body can fit; other results are arbitrary."""

    rough: ClassVar[bool] = False
    name: str = "skeleton"
    seed: int = 0

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Fit a body to the identity, compute its weights, and choose the driving's points, once for all frames."""
        body = load_body()
        thin = thin_body(body, POINTS, len(body.components) // 2)
        sample = surface_sampler(identity, POINTS, np.random.default_rng([self.seed, 0]))
        identity_fit = fit_points(thin, sample(identity.vertices), seed=self.seed)
        # Skinning is done in ranked order: the last bits of a matrix product may depend on the order of its rows.
        ranked = canonical_order(identity.vertices)
        rest, weights = ranked.merge(identity.vertices), bind(identity, ranked, thin, identity_fit)
        driving_sample = surface_sampler(driving.mesh, POINTS, np.random.default_rng([self.seed, 0]))

        # One function for each run over the clip, so that a second run starts without a previous fit.
        def pose_function() -> Callable[[Float[np.ndarray, "U 3"]], Float[np.ndarray, "V 3"]]:
            fit: BodyParameters | None = None

            def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
                nonlocal fit  # the fit to a frame starts from the one before
                fit = fit_points(thin, driving_sample(vertices), fit, self.seed)
                rotation, offset = bone_transforms(thin, identity_fit, fit)
                return skin_points(rest, weights, rotation, offset)[ranked.group]

            return pose

        return lambda frames: with_root_motion(frames, partial(map, pose_function()), driving.mesh.name)


def bind(identity: Mesh, ranked: CanonicalOrder, body: RiggedBody, fit: BodyParameters) -> Float[np.ndarray, "W J"]:
    """Compute heat weights of the identity's distinct positions for the joints of a fit."""
    vertices = rounded(ranked.merge(identity.vertices))
    faces = ranked.group[identity.faces]
    # Faces start at their smallest index and are sorted, so that the result does not depend on their order.
    first_corner = faces.argmin(axis=1)[:, None]
    faces = np.unique(np.take_along_axis(faces, (first_corner + np.arange(3)) % 3, axis=1), axis=0)
    segments, owners = bone_segments(body, fit)
    return heat_weights(vertices, faces, segments, owners, len(body.parents))


def bone_segments(body: RiggedBody, fit: BodyParameters) -> tuple[Float[np.ndarray, "S 2 3"], Int[np.ndarray, " S"]]:
    """Return the segments from each joint to its children, and the joint that owns each.

    The segment of a joint without children is twice as long as the way to the centroid of its points.
    """
    joints = fit.joints(body)
    points = fit.points(body)
    segments, owners = [], []
    for j in range(len(joints)):
        children = [c for c, parent in enumerate(body.parents) if parent == j]
        ends = joints[children] if children else [2 * _centroid(points, body.weights[:, j]) - joints[j]]
        segments += [(joints[j], end) for end in ends]
        owners += [j] * len(ends)
    return np.array(segments), np.array(owners)


def _centroid(points: Float[np.ndarray, "V 3"], weights: Float[np.ndarray, " V"]) -> Float[np.ndarray, " 3"]:
    """Return the mean of points by their weights for one joint."""
    assert weights.sum() > 0, "a joint at the end of a limb moves none of the body's points: take more of them"
    return weights @ points / weights.sum()


def bone_transforms(
    body: RiggedBody, identity_fit: BodyParameters, driving_fit: BodyParameters
) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]]:
    """Return the map x -> rotation x + offset of each bone that gives the identity the driving's pose.

    Bones keep the identity's lengths; the root joint stays.
    """
    rotation = driving_fit.rotations(body) @ identity_fit.rotations(body).transpose(0, 2, 1)
    joints = identity_fit.joints(body)
    bones = joints[1:] - joints[list(body.parents[1:])]
    positions = place_joints(joints[0], bones, rotation, body.parents)
    return rotation, positions - np.einsum("jkl,jl->jk", rotation, joints)


def heat_weights(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    segments: Float[np.ndarray, "S 2 3"],
    owners: Int[np.ndarray, " S"],
    bones: int,
) -> Float[np.ndarray, "V J"]:
    """Compute the weights of `bones` bones, each made of the segments that it owns; rows sum to 1, all lie in 0..1.

    Vertices that no face uses (point clouds) follow only their nearest bone. One sparse factorisation for all bones.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    nearest, distance = nearest_segments(vertices, faces, segments)
    heated = nearest.astype(float) @ (owners[:, None] == np.arange(bones)) > 0  # (V, J): bone j is nearest to vertex v
    rate = heated_areas(vertices, faces) * HEAT / distance**2
    # All bones have the same matrix: one factorisation, one right-hand side for each bone.
    system = (cotangent_laplacian(vertices, faces) + diags_array(rate * heated.sum(axis=1))).tocsc()
    weights = splu(system, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(rate[:, None] * heated)
    weights = np.clip(weights, 0.0, 1.0)  # rounding only: an M-matrix keeps them there
    return weights / weights.sum(axis=1, keepdims=True)


def cotangent_laplacian(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> csc_array:
    """Return the positive semi-definite stiffness matrix (V, V); cotangents are clamped to 0..MAX_COTANGENT."""
    from scipy.sparse import coo_array

    double_area = np.linalg.norm(face_vectors(vertices, faces), axis=1)
    tiny = np.finfo(float).tiny
    rows, columns, values = [], [], []
    for k in range(3):
        corner, i, j = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        # The cotangent at a corner is the dot product of its two edges over the length of their cross product.
        dot = ((vertices[i] - vertices[corner]) * (vertices[j] - vertices[corner])).sum(-1)
        half = 0.5 * np.clip(dot / np.maximum(double_area, tiny), 0.0, MAX_COTANGENT)
        rows += [i, j, i, j]
        columns += [j, i, i, j]
        values += [-half, -half, half, half]
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return coo_array(entries, shape=(len(vertices), len(vertices))).tocsc()


def heated_areas(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, " V"]:
    """Return the area of each vertex, or a small value, so that heat enters every vertex."""
    area = vertex_areas(vertices, faces)
    smallest = 1e-6 * area.mean() if area.any() else 1.0
    return np.maximum(area, smallest)


def nearest_segments(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], segments: Float[np.ndarray, "S 2 3"]
) -> tuple[Bool[np.ndarray, "V S"], Float[np.ndarray, " V"]]:
    """Find the nearest segments behind the surface at each vertex, or of all where none is; and their distance.

    All segments that are equally near are returned: two that share a joint often are, and rounding must not choose.
    """
    normals = outward_normals(vertices, faces)
    smallest = MIN_DISTANCE * np.ptp(vertices, axis=0).max()
    distance, behind = np.empty((len(vertices), len(segments))), np.empty((len(vertices), len(segments)), bool)
    for s, (start, end) in enumerate(segments):
        offset = closest_on_segment(vertices, start, end) - vertices
        distance[:, s] = np.maximum(np.linalg.norm(offset, axis=1), smallest)
        behind[:, s] = (offset * normals).sum(-1) <= TOLERANCE * distance[:, s]
    behind |= ~behind.any(axis=1, keepdims=True)
    distance[~behind] = np.inf
    nearest = distance.min(axis=1)
    return distance <= (1 + TOLERANCE) * nearest[:, None], nearest


def outward_normals(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "V 3"]:
    """Compute vertex normals, reversed in each connected component that encloses a negative volume.

    Zero where there is no outside: at vertices without a face, and where faces cancel (a sheet with both windings).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    vertex_and_face = faces.ravel(), np.repeat(np.arange(len(faces)), 3)
    incidence = coo_array((np.ones(3 * len(faces)), vertex_and_face), shape=(len(vertices), len(faces))).tocsr()
    vectors = face_vectors(vertices, faces)
    total, area = incidence @ vectors, incidence @ np.linalg.norm(vectors, axis=1)
    component = connected_components(incidence @ incidence.T, directed=False)[1]
    # Six times the signed volume of the tetrahedron between a face and the mean vertex.
    face_volume = ((vertices - vertices.mean(axis=0))[faces].mean(axis=1) * vectors).sum(-1)
    volume = np.bincount(component[faces[:, 0]], face_volume, minlength=len(vertices))[component]
    length = np.linalg.norm(total, axis=1)
    divisor = np.where(length > CANCELLING * area, length, np.inf)
    return np.where(volume < 0, -1.0, 1.0)[:, None] * total / divisor[:, None]


def closest_on_segment(
    points: Float[np.ndarray, "N 3"], start: Float[np.ndarray, " 3"], end: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "N 3"]:
    """Return the point of a segment that is closest to each point; its ends may coincide."""
    direction = end - start
    square = max(float(direction @ direction), np.finfo(float).tiny)
    return start + np.clip((points - start) @ direction / square, 0.0, 1.0)[:, None] * direction
