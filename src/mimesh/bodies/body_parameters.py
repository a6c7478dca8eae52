"""Parameters of a posed body as one vector, and the gradient of its points with respect to that vector.

The gradient is written out by hand, because the shipped package has no automatic differentiation; tests compare it with
finite differences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from ..core.rig import descendant_matrix
from ..core.skinning import blend_matrices
from ..core.surface_points import at_barycentric, sample_surface
from .body_model import RiggedBody
from .sampling import rotvec_to_rotmat


@dataclass(frozen=True, eq=False)
class BodyParameters:
    """Shape, pose, size and position of a body model: its points are `scale * posed + translation`."""

    scale: float
    translation: Float[np.ndarray, " 3"]
    shape: Float[np.ndarray, " K"]
    """Shape coefficients (standard deviations)."""
    rotvec: Float[np.ndarray, "J 3"]
    """Local rotation vector of each joint (radians)."""
    error: float = np.inf
    """Residual of the fit: mean squared distance to the target points plus that of the target points to the body."""
    restart_error: float = np.inf
    """Residual from which on a later frame of the same clip is fitted from the start poses again; set by the first."""

    def joints(self, body: RiggedBody) -> Float[np.ndarray, "J 3"]:
        """Compute the joint positions."""
        _, joints = body.shaped(self.shape)
        rotation, translation = body.skinning_transforms(joints, rotvec_to_rotmat(self.rotvec))
        return self.scale * (np.einsum("jkl,jl->jk", rotation, joints) + translation) + self.translation

    def points(self, body: RiggedBody) -> Float[np.ndarray, "V 3"]:
        """Compute the vertices of the body."""
        return self.scale * body.posed(self.shape, rotvec_to_rotmat(self.rotvec)) + self.translation

    def rotations(self, body: RiggedBody) -> Float[np.ndarray, "J 3 3"]:
        """Compute the world rotation of each joint from rest."""
        _, joints = body.shaped(self.shape)
        return body.skinning_transforms(joints, rotvec_to_rotmat(self.rotvec))[0]


def thin_body(body: RiggedBody, count: int, components: int, seed: int = 0) -> RiggedBody:
    """Reduce a body to `count` random points of its surface, without faces, and its first shape components."""
    chosen, barycentric = sample_surface(body.vertices, body.faces, count, np.random.default_rng(seed))
    samples = (body.faces, chosen, barycentric)
    return replace(
        body,
        vertices=at_barycentric(body.vertices, *samples),
        faces=np.zeros((0, 3), np.int64),
        components=at_barycentric(body.components[:components], *samples),
        joint_components=body.joint_components[:components],
        weights=np.einsum("nk,nkj->nj", barycentric, body.weights[body.faces[chosen]]),
    )


def to_vector(parameters: BodyParameters) -> Float[np.ndarray, " P"]:
    """Pack parameters in one vector: logarithm of the scale, translation, shape, rotation vectors."""
    return np.concatenate(
        [[np.log(parameters.scale)], parameters.translation, parameters.shape, parameters.rotvec.ravel()]
    )


def from_vector(body: RiggedBody, vector: Float[np.ndarray, " P"], error: float = np.inf) -> BodyParameters:
    """Unpack parameters from a vector: the inverse of `to_vector`."""
    return BodyParameters(*_split(body, vector), error)


def _split(
    body: RiggedBody, vector: Float[np.ndarray, " P"]
) -> tuple[float, Float[np.ndarray, " 3"], Float[np.ndarray, " K"], Float[np.ndarray, "J 3"]]:
    """Split a vector into scale, translation, shape and rotation vectors."""
    k = 4 + len(body.components)
    return float(np.exp(vector[0])), vector[1:4], vector[4:k], vector[k:].reshape(-1, 3)


def posed_and_pullback(
    body: RiggedBody, vector: Float[np.ndarray, " P"]
) -> tuple[Float[np.ndarray, "V 3"], Callable[[Float[np.ndarray, "V 3"]], Float[np.ndarray, " P"]]]:
    """Compute the points of a body given by its vector, and return the map from their gradient to the vector's.

    Point v is scale * sum_j w_vj (R_j x_v + t_j) + translation, with the world rotation R_j of joint j. The pullback
    (vector-Jacobian product, reverse mode) treats each joint as a rigid body: the gradients of the points are forces,
    which add up to a force and a torque on each joint and are passed on to its parent.
    """
    scale, translation, shape, rotvec = _split(body, vector)
    points = body.vertices + np.tensordot(shape, body.components, 1)
    joints = body.joints + np.tensordot(shape, body.joint_components, 1)
    rotation, parent_rotation = _world_rotations(body.parents, rotvec)
    descendants = descendant_matrix(body.parents)
    # t_j = t_parent + (R_parent - R_j) joint_j, because both maps take joint_j to the same position. So t_j is the sum
    # of these differences over the ancestors of j.
    offset = descendants.T @ np.einsum("jkl,jl->jk", parent_rotation - rotation, joints)
    blended = blend_matrices(body.weights, rotation)
    skinned = np.einsum("vkl,vl->vk", blended, points) + body.weights @ offset

    def pullback(gradient: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " P"]:
        """Map the gradient with respect to the points to the gradient with respect to the vector."""
        scaled = scale * gradient
        to_points = np.einsum("vkl,vk->vl", blended, scaled)
        to_rotation = (body.weights.T @ (scaled[:, :, None] * points[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
        force = body.weights.T @ scaled
        # Torque about the origin: the rotation's part, and that of the offset t_j.
        torque = _axial(to_rotation @ rotation.transpose(0, 2, 1)) + np.cross(offset, force)
        # A joint moves all its descendants: sum forces and torques over subtrees.
        force, torque = descendants @ force, descendants @ torque
        position = np.einsum("jkl,jl->jk", rotation, joints) + offset
        # Torque about the joint's own position, in the frame of its parent, in which the joint's rotation is given.
        spin = np.einsum("jkl,jk->jl", parent_rotation, torque - np.cross(position, force))
        to_joints = np.einsum("jkl,jk->jl", parent_rotation - rotation, force)
        to_shape = np.tensordot(body.components, to_points) + np.tensordot(body.joint_components, to_joints)
        to_scale = [(scaled * skinned).sum()]  # with respect to the logarithm of the scale
        return np.concatenate([to_scale, gradient.sum(axis=0), to_shape, rotvec_pullback(rotvec, spin).ravel()])

    return scale * skinned + translation, pullback


def rotvec_pullback(rotvec: Float[np.ndarray, "J 3"], torque: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "J 3"]:
    """Compute the gradient with respect to rotation vectors from that with respect to small rotations after them.

    This is the product with the transposed left Jacobian of SO(3):
    torque - (1 - cos a) / a^2 r x torque + (a - sin a) / a^3 r x (r x torque), with a = |r|.
    """
    angle = np.linalg.norm(rotvec, axis=1, keepdims=True)
    small = angle < 1e-4  # the quotients would cancel; their limits are off by less than 1e-9
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6, (safe - np.sin(safe)) / safe**3)
    crossed = np.cross(rotvec, torque)
    return torque - first * crossed + second * np.cross(rotvec, crossed)


def _world_rotations(
    parents: tuple[int, ...], rotvec: Float[np.ndarray, "J 3"]
) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3 3"]]:
    """Compute the world rotation of each joint, and that of its parent, one level of the tree at a time."""
    rotation = rotvec_to_rotmat(rotvec)
    parent_rotation = np.broadcast_to(np.eye(3), rotation.shape).copy()
    for joints, above in _levels(parents):
        parent_rotation[joints] = rotation[above]
        rotation[joints] = parent_rotation[joints] @ rotation[joints]
    return rotation, parent_rotation


@cache
def _levels(parents: tuple[int, ...]) -> tuple[tuple[Int[np.ndarray, " L"], Int[np.ndarray, " L"]], ...]:
    """List the joints at each depth below the root, and their parents; read-only."""
    depth = descendant_matrix(parents).sum(axis=0)
    levels = [np.flatnonzero(depth == d) for d in range(2, int(depth.max()) + 1)]
    return tuple((_read_only(level), _read_only(np.array(parents)[level])) for level in levels)


def _read_only(cached: np.ndarray) -> np.ndarray:
    """Protect a cached array, which all callers share."""
    cached.setflags(write=False)
    return cached


def _axial(matrices: Float[np.ndarray, "J 3 3"]) -> Float[np.ndarray, "J 3"]:
    """Compute the axial vector of each matrix: for a sum of outer products w v^T it is the sum of v x w."""
    rows = [(2, 1), (0, 2), (1, 0)]
    return np.stack([matrices[:, i, j] - matrices[:, j, i] for i, j in rows], axis=1)
