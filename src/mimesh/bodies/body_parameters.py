"""A body somewhere in space as one vector of unknowns, and the gradient of its points by them.

Written out by hand because the shipped package has no automatic differentiation; tests hold it to finite differences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from ..core.skinning import blend_matrices
from ..core.surface_points import at_barycentric, sample_surface
from .body_model import RiggedBody
from .sampling import rotvec_to_rotmat


@dataclass(frozen=True, eq=False)
class BodyParameters:
    """A person of a body model somewhere in space: `scale * body + translation`."""

    scale: float
    translation: Float[np.ndarray, " 3"]
    shape: Float[np.ndarray, " K"]
    rotvec: Float[np.ndarray, "J 3"]
    error: float = np.inf
    """Mean squared distance to the points plus that of the points to the body."""
    lost: float = np.inf
    """Error from which on a frame that follows this one in a clip is fitted anew; carried along unchanged."""

    def joints(self, body: RiggedBody) -> Float[np.ndarray, "J 3"]:
        """Where the joints are."""
        _, joints = body.shaped(self.shape)
        rotation, translation = body.skinning_transforms(joints, rotvec_to_rotmat(self.rotvec))
        return self.scale * (np.einsum("jkl,jl->jk", rotation, joints) + translation) + self.translation

    def points(self, body: RiggedBody) -> Float[np.ndarray, "V 3"]:
        """Where the body's vertices are."""
        return self.scale * body.posed(self.shape, rotvec_to_rotmat(self.rotvec)) + self.translation

    def rotations(self, body: RiggedBody) -> Float[np.ndarray, "J 3 3"]:
        """Rotation of each joint from the body at rest, about the world's axes."""
        _, joints = body.shaped(self.shape)
        return body.skinning_transforms(joints, rotvec_to_rotmat(self.rotvec))[0]


def thin_body(body: RiggedBody, count: int, components: int, seed: int = 0) -> RiggedBody:
    """The body as `count` points spread evenly over its surface, without faces, with its first shape components."""
    chosen, weights = sample_surface(body.vertices, body.faces, count, np.random.default_rng(seed))
    at = (body.faces, chosen, weights)
    return replace(
        body,
        vertices=at_barycentric(body.vertices, *at),
        faces=np.zeros((0, 3), np.int64),
        components=at_barycentric(body.components[:components], *at),
        joint_components=body.joint_components[:components],
        weights=np.einsum("nk,nkj->nj", weights, body.weights[body.faces[chosen]]),
    )


def unknowns_of(fit: BodyParameters) -> Float[np.ndarray, " P"]:
    """One vector: logarithm of the scale, translation, shape, rotation vectors."""
    return np.concatenate([[np.log(fit.scale)], fit.translation, fit.shape, fit.rotvec.ravel()])


def fit_of(body: RiggedBody, unknowns: Float[np.ndarray, " P"], error: float = np.inf) -> BodyParameters:
    """The inverse of `unknowns_of`."""
    return BodyParameters(*_parts(body, unknowns), error)


def _parts(
    body: RiggedBody, unknowns: Float[np.ndarray, " P"]
) -> tuple[float, Float[np.ndarray, " 3"], Float[np.ndarray, " K"], Float[np.ndarray, "J 3"]]:
    k = 4 + len(body.components)
    return float(np.exp(unknowns[0])), unknowns[1:4], unknowns[4:k], unknowns[k:].reshape(-1, 3)


def posed_and_pullback(
    body: RiggedBody, unknowns: Float[np.ndarray, " P"]
) -> tuple[Float[np.ndarray, "V 3"], Callable[[Float[np.ndarray, "V 3"]], Float[np.ndarray, " P"]]]:
    """Points of a fit given as one vector (see `unknowns_of`), and the map from their gradient to the vector's."""
    scale, place, shape, rotvec = _parts(body, unknowns)
    points = body.vertices + np.tensordot(shape, body.components, 1)
    joints = body.joints + np.tensordot(shape, body.joint_components, 1)
    rotation, above = _world_rotations(body.parents, rotvec)
    below = descendants(body.parents)
    # offset = that of the parent + (rotation of the parent - rotation) joint, down from the root
    offset = below.T @ np.einsum("jkl,jl->jk", above - rotation, joints)
    blended = blend_matrices(body.weights, rotation)
    skinned = np.einsum("vkl,vl->vk", blended, points) + body.weights @ offset

    def pullback(gradient: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " P"]:
        inner = scale * gradient
        to_points = np.einsum("vkl,vk->vl", blended, inner)
        to_rotation = (body.weights.T @ (inner[:, :, None] * points[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
        force = body.weights.T @ inner
        torque = _axial(to_rotation @ rotation.transpose(0, 2, 1)) + np.cross(offset, force)
        # A joint turns and carries all that hangs on it: forces and torques add up from the leaves.
        force, torque = below @ force, below @ torque
        position = np.einsum("jkl,jl->jk", rotation, joints) + offset
        spin = np.einsum("jkl,jk->jl", above, torque - np.cross(position, force))
        to_joints = np.einsum("jkl,jk->jl", above - rotation, force)
        to_shape = np.tensordot(body.components, to_points) + np.tensordot(body.joint_components, to_joints)
        to_scale = [(inner * skinned).sum()]
        return np.concatenate([to_scale, gradient.sum(axis=0), to_shape, rotvec_pullback(rotvec, spin).ravel()])

    return scale * skinned + place, pullback


def rotvec_pullback(rotvec: Float[np.ndarray, "J 3"], torque: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "J 3"]:
    """Gradient by rotation vectors from that by small turns applied after them: the transposed left Jacobian."""
    angle = np.linalg.norm(rotvec, axis=1, keepdims=True)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6, (safe - np.sin(safe)) / safe**3)
    turned = np.cross(rotvec, torque)
    return torque - first * turned + second * np.cross(rotvec, turned)


def _world_rotations(
    parents: tuple[int, ...], rotvec: Float[np.ndarray, "J 3"]
) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3 3"]]:
    """Rotation of each joint from rest about the world's axes, and that of its parent."""
    rotation = rotvec_to_rotmat(rotvec)
    above = np.broadcast_to(np.eye(3), rotation.shape).copy()
    for level, over in _levels(parents):
        above[level] = rotation[over]
        rotation[level] = above[level] @ rotation[level]
    return rotation, above


@cache
def _levels(parents: tuple[int, ...]) -> tuple[tuple[Int[np.ndarray, " L"], Int[np.ndarray, " L"]], ...]:
    """Joints at each depth below the root, and their parents; read-only."""
    depth = descendants(parents).sum(axis=0)
    levels = [np.flatnonzero(depth == d) for d in range(2, int(depth.max()) + 1)]
    return tuple((_frozen(level), _frozen(np.array(parents)[level])) for level in levels)


@cache
def descendants(parents: tuple[int, ...]) -> Float[np.ndarray, "J J"]:
    """1 at [j, k] where joint k is j or hangs on it; read-only."""
    below = np.eye(len(parents))
    for j in range(len(parents) - 1, -1, -1):
        if parents[j] >= 0:
            below[parents[j]] += below[j]
    return _frozen(below)


def _frozen(cached: np.ndarray) -> np.ndarray:
    cached.setflags(write=False)
    return cached


def _axial(matrices: Float[np.ndarray, "J 3 3"]) -> Float[np.ndarray, "J 3"]:
    """Sum of v x w over the outer products w v^T that each matrix is made of."""
    rows = [(2, 1), (0, 2), (1, 0)]
    return np.stack([matrices[:, i, j] - matrices[:, j, i] for i, j in rows], axis=1)
