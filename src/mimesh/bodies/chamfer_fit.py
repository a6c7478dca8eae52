"""Fit a rigged body to a point cloud: L-BFGS on the Chamfer distance, from many start poses, coarse to fine.

Only positions are used, and each point is matched with the nearest point of the other set: no vertex index is taken for
a correspondence. Unknowns are scale, translation, joint rotations and the shape coefficients of the given body, in one
vector. The gradient is written out by hand, because the shipped package has no automatic differentiation; tests compare
it with finite differences. The weights of the priors assume lengths of about those of the unit sphere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.rig import descendant_matrix
from ..core.skinning import blend_matrices
from ..core.surface_points import at_barycentric, sample_surface
from .body_model import RiggedBody
from .sampling import JOINT_LIMITS, TABLE_6, limits_rotvec, pose_of, rotvec_to_rotmat

if TYPE_CHECKING:
    from scipy.spatial import KDTree


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


def thin_body(body: RiggedBody, count: int, components: int) -> RiggedBody:
    """Reduce a body to `count` random points of its surface, without faces, and its first shape components."""
    chosen, barycentric = sample_surface(body.vertices, body.faces, count, np.random.default_rng(0))
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


def _split(
    body: RiggedBody, vector: Float[np.ndarray, " P"]
) -> tuple[float, Float[np.ndarray, " 3"], Float[np.ndarray, " K"], Float[np.ndarray, "J 3"]]:
    """Split a vector of `to_vector` into scale, translation, shape and rotation vectors."""
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


POSE_PRIOR = 3e-6
"""Cost (squared distance) of a joint rotated from rest by half of its range; grows with the square of the angle.

This and the next three were tuned on `val` of human-npt.
"""
SHAPE_PRIOR = 3e-7
"""Cost (squared distance) of a shape coefficient of one standard deviation."""
TANGENTIAL_WEIGHT = 0.1
"""Weight of a squared distance along the surface; across it the weight is 1. Matched points are not the same point."""
GOOD_ERROR = 1.2e-4
"""Residual of a successful fit to 4,000 points: on `val` these are below 1.1e-4, and all others above 2e-4."""
MAX_FAILED_RESTARTS = 2
"""Rounds of random restarts in a row that may fail to reduce the residual clearly."""
RESTARTS = 60
"""Random poses of each group of joints in a round of random restarts."""
LEGS, ARMS = ("UpLeg", "Leg"), ("Shoulder", "Arm", "ForeArm")
LIMBS = tuple(tuple(side + bone for bone in bones) for side in ("Left", "Right") for bones in (LEGS, ARMS))
LOWER_HALF = ("Hips", "LowerBack", "Spine", *LIMBS[0], *LIMBS[2])
"""Groups of joints that random restarts draw together: each limb, and the lower half of the body."""
SLACK = np.radians(15)
"""How far (radians) a joint may exceed the tables of limits; with less, people within the limits are fitted worse."""
SHAPE_LIMIT = 3.5
"""Largest shape coefficient (standard deviations)."""
LBFGS_SCALE = 100.0
"""Factor on lengths for SciPy's L-BFGS-B, whose convergence test is relative for values above 1 only."""


def fit_points(
    body: RiggedBody, points: Float[np.ndarray, "N 3"], start: BodyParameters | None = None, seed: int = 0
) -> BodyParameters:
    """Fit `body` (see `thin_body`) to points of a normalised mesh, given in random order.

    `start` is the fit of the previous frame of the same person: its scale and shape are kept. If that gives an error of
    `start.restart_error` or more, the points are also fitted without it, and the better fit is returned. Outliers are
    not rejected. People who stand on their heads are not searched for.
    """
    cloud = target_cloud(points, TANGENTIAL_WEIGHT)
    # The first points of a thinned body are random ones.
    random = np.arange(len(body.vertices))
    coarse = [(body.part(random[:count]), target_cloud(points[:count])) for count in (300, 800)]
    if start is None:
        return _fit_from_start_poses(body, points, cloud, coarse, seed)
    # Coarse points first: they follow large motions at little cost.
    pose_only = _free_unknowns(body, size=False, shape=False)
    tracked = _descend(body, cloud, _descend(*coarse[1], start, pose_only, 4, 15), pose_only, 8, 15)
    tracked = replace(tracked, restart_error=start.restart_error)
    if tracked.error < start.restart_error:
        return tracked
    return min(tracked, _fit_from_start_poses(body, points, cloud, coarse, seed), key=_error)


def _fit_from_start_poses(
    body: RiggedBody,
    points: Float[np.ndarray, "N 3"],
    cloud: TargetCloud,
    coarse: list[tuple[RiggedBody, TargetCloud]],
    seed: int,
) -> BodyParameters:
    """Fit from the poses of `_start_poses`, selected on few points; then restart from random poses while that helps.

    Restarts (seeded) run while the error exceeds GOOD_ERROR and not more than MAX_FAILED_RESTARTS in a row fail to
    reduce it by a fifth.
    """
    rough = _select_start([_start_poses(coarse[0][0], points)], 12, *coarse)
    fit, rng = _descend(body, cloud, rough, _free_unknowns(body), 8, 30), np.random.default_rng(seed)
    failed = 0
    while fit.error > GOOD_ERROR and failed < MAX_FAILED_RESTARTS:
        restarted = _select_start(
            [_random_poses(coarse[0][0], points, fit, names, rng) for names in (*LIMBS, LOWER_HALF, body.joint_names)],
            2,
            *coarse,
        )
        better = fit
        if restarted.error < rough.error:
            rough = restarted
            better = min(fit, _descend(body, cloud, restarted, _free_unknowns(body), 8, 30), key=_error)
        failed = 0 if better.error < 0.8 * fit.error else failed + 1
        fit = better
    return replace(fit, restart_error=max(3 * fit.error, GOOD_ERROR))


def _select_start(
    groups: list[list[BodyParameters]],
    best: int,
    coarsest: tuple[RiggedBody, TargetCloud],
    coarse: tuple[RiggedBody, TargetCloud],
) -> BodyParameters:
    """Select the best of many start poses after short descents.

    The `best` poses of each group are fitted to the coarsest points, and the best two of these to the coarse ones.
    """
    # Few unknowns suffice to rank the starts: root, legs and arms, with the shape fixed.
    limbs = _free_unknowns(coarsest[0], ("Hips", "Leg", "Arm"), shape=False)
    starts = [
        fit for group in groups for fit in sorted((_with_error(*coarsest, fit) for fit in group), key=_error)[:best]
    ]
    fits = sorted((_descend(*coarsest, fit, limbs, 4, 5) for fit in starts), key=_error)[:2]
    return min((_descend(*coarse, fit, _free_unknowns(coarse[0]), 4, 15) for fit in fits), key=_error)


def _random_poses(
    body: RiggedBody,
    points: Float[np.ndarray, "N 3"],
    fit: BodyParameters,
    names: tuple[str, ...],
    rng: np.random.Generator,
) -> list[BodyParameters]:
    """Draw RESTARTS variants of a fit in which the named joints are uniform within their limits."""
    low, high = limits_rotvec(body, JOINT_LIMITS)
    low[0, 1], high[0, 1] = -1.0, 1.0  # headings (radians), which the table leaves out
    joints, fits = [body.joint(name) for name in names], []
    # All joints are drawn, so that the draws do not depend on which joints are used.
    for drawn in rng.uniform(low, high, (RESTARTS, *low.shape)):
        rotvec = fit.rotvec.copy()
        rotvec[joints] = drawn[joints]
        fits.append(_aligned(body, points, fit.shape, rotvec))
    return fits


def _with_error(body: RiggedBody, cloud: TargetCloud, fit: BodyParameters) -> BodyParameters:
    """Compute the error of parameters."""
    posed = posed_and_pullback(body, to_vector(fit))[0]
    return replace(fit, error=chamfer(cloud, posed, cloud.matches(posed))[0])


def _error(fit: BodyParameters) -> float:
    return fit.error


def _start_poses(body: RiggedBody, points: Float[np.ndarray, "N 3"]) -> list[BodyParameters]:
    """List the deterministic starts: mean shape, three headings, legs down, bent or raised, arms out or lowered."""
    fits = []
    legs = ((0, 0), (60, 60), (85, 0))  # degrees of hip and knee: straight down, knee raised, straight to the front
    for heading, left, right, lowered in product((-40, 0, 40), legs, legs, (0, 70)):
        degrees = {"Hips": (0, heading, 0), "LeftArm": (0, 0, -lowered), "RightArm": (0, 0, lowered)}
        degrees |= {"LeftUpLeg": (-left[0], 0, 0), "LeftLeg": (left[1], 0, 0)}
        degrees |= {"RightUpLeg": (-right[0], 0, 0), "RightLeg": (right[1], 0, 0)}
        fits.append(_aligned(body, points, np.zeros(len(body.components)), pose_of(body, degrees)))
    return fits


def _aligned(
    body: RiggedBody,
    points: Float[np.ndarray, "N 3"],
    shape: Float[np.ndarray, " K"],
    rotvec: Float[np.ndarray, "J 3"],
) -> BodyParameters:
    """Choose scale and translation so that centroid and root mean square radius are those of the points."""
    posed = body.posed(shape, rotvec_to_rotmat(rotvec))
    target_size, body_size = (np.sqrt(np.square(x - x.mean(axis=0)).sum(-1).mean()) for x in (points, posed))
    scale = max(float(target_size / body_size), 1e-6)  # a single point has no size
    return BodyParameters(scale, points.mean(axis=0) - scale * posed.mean(axis=0), shape, rotvec)


def _free_unknowns(
    body: RiggedBody, joints: tuple[str, ...] = ("",), size: bool = True, shape: bool = True
) -> Bool[np.ndarray, " P"]:
    """Mask the unknowns to optimise: translation always, scale, shape, and joints whose names end with `joints`."""
    rotations = np.repeat([name.endswith(joints) for name in body.joint_names], 3)
    return np.concatenate([[size], np.ones(3, bool), np.full(len(body.components), shape), rotations])


def _descend(
    body: RiggedBody, cloud: TargetCloud, fit: BodyParameters, free: Bool[np.ndarray, " P"], rounds: int, steps: int
) -> BodyParameters:
    """Alternate `rounds` times: match nearest points, then run up to `steps` L-BFGS iterations on the free unknowns."""
    from scipy.optimize import minimize

    # Unknowns are scaled by how far they move points, so that their steps are comparable.
    vector, unit = to_vector(fit), LBFGS_SCALE * _leverage(body)[free]
    low, high = _limits(body)
    weight = _prior_weight(body, low, high)

    def objective(scaled: Float[np.ndarray, " M"]) -> tuple[float, Float[np.ndarray, " M"]]:
        """Compute the error with priors, and its gradient, of the scaled free unknowns."""
        trial = vector.copy()
        trial[free] = scaled / unit
        posed, pullback = posed_and_pullback(body, trial)
        error, gradient = chamfer(cloud, posed, matches)
        slope = pullback(gradient) + 2 * weight * trial
        return LBFGS_SCALE**2 * (error + float(weight @ trial**2)), LBFGS_SCALE**2 * slope[free] / unit

    bounds = np.stack([low[free] * unit, high[free] * unit], axis=1)
    options = {"maxiter": steps, "maxcor": 20, "ftol": 1e-5, "gtol": 1e-7}
    for _ in range(rounds):
        matches = cloud.matches(posed_and_pullback(body, vector)[0])
        found = minimize(objective, vector[free] * unit, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        vector[free] = found.x / unit
    return _with_error(body, cloud, BodyParameters(*_split(body, vector)))


def _leverage(body: RiggedBody) -> Float[np.ndarray, " P"]:
    """Estimate how far (root mean square over the points) one unit of each unknown moves the points."""
    weighted = body.weights @ descendant_matrix(body.parents).T  # weight of each joint's subtree at each point
    joints = np.sqrt((weighted * np.square(body.vertices[:, None] - body.joints).sum(-1)).mean(axis=0))
    size = np.sqrt(np.square(body.vertices - body.vertices.mean(axis=0)).sum(-1).mean())
    shape = np.sqrt(np.square(body.components).sum(-1).mean(-1))
    return np.maximum(np.concatenate([[size], np.ones(3), shape, np.repeat(joints, 3)]), 3e-3)


def _limits(body: RiggedBody) -> tuple[Float[np.ndarray, " P"], Float[np.ndarray, " P"]]:
    """Compute the bounds of all unknowns; joints without range are fixed, scale, translation and root are free."""
    tables = np.stack([limits_rotvec(body, table) for table in (TABLE_6, JOINT_LIMITS)])
    low, high = tables[:, 0].min(axis=0), tables[:, 1].max(axis=0)
    # Joints without any range in the tables stay fixed: they get no slack.
    slack = SLACK * (high > low).any(axis=1, keepdims=True)
    low, high = low - slack, high + slack
    low[0], high[0] = -np.inf, np.inf
    similarity, shape = np.full(4, np.inf), np.full(len(body.components), SHAPE_LIMIT)
    return np.concatenate([-similarity, -shape, low.ravel()]), np.concatenate([similarity, shape, high.ravel()])


def _prior_weight(
    body: RiggedBody, low: Float[np.ndarray, " P"], high: Float[np.ndarray, " P"]
) -> Float[np.ndarray, " P"]:
    """Compute the cost of the square of each unknown; zero for scale, translation and the root's rotation."""
    k = len(body.components)
    # Fixed joints have no range and the root an infinite one: both cost nothing.
    half = (high[4 + k :] - low[4 + k :]) / 2
    return np.concatenate([np.zeros(4), np.full(k, SHAPE_PRIOR), POSE_PRIOR / np.where(half > 0, half, np.inf) ** 2])


@dataclass(frozen=True, eq=False)
class TargetCloud:
    """Points to fit to, with the normals of the surface that they sample."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    """Unit normals of either sign; zero if distances in all directions count alike."""
    tangential_weight: float
    """Weight of the squared distance in all directions; the part along the normal has the rest of 1 in addition."""
    tree: KDTree

    def matches(self, others: Float[np.ndarray, "V 3"]) -> tuple[Int[np.ndarray, " V"], Int[np.ndarray, " N"]]:
        """Find the nearest cloud point of each of `others`, and the nearest of `others` to each cloud point."""
        from scipy.spatial import KDTree

        return np.asarray(self.tree.query(others)[1]), np.asarray(KDTree(others).query(self.points)[1])


def target_cloud(points: Float[np.ndarray, "N 3"], tangential_weight: float = 1.0) -> TargetCloud:
    """Build a cloud; if `tangential_weight` is below 1, normals are of planes through the 16 nearest points."""
    from scipy.spatial import KDTree

    tree, normals = KDTree(points), np.zeros_like(points)
    if tangential_weight < 1:
        near = points[tree.query(points, k=min(16, len(points)))[1].reshape(len(points), -1)]
        near = near - near.mean(axis=1, keepdims=True)
        # The eigenvector of the smallest eigenvalue of the covariance is the normal of the plane.
        normals = np.linalg.eigh(near.transpose(0, 2, 1) @ near)[1][:, :, 0]
    return TargetCloud(points, normals, tangential_weight, tree)


def chamfer(
    cloud: TargetCloud, others: Float[np.ndarray, "V 3"], matches: tuple[Int[np.ndarray, " V"], Int[np.ndarray, " N"]]
) -> tuple[float, Float[np.ndarray, "V 3"]]:
    """Compute the Chamfer distance for fixed matches, and its gradient with respect to `others`.

    It is the mean squared distance of `others` to their matches plus that of the cloud's points to theirs, with the
    tangential weight t: d^T (t I + (1 - t) n n^T) d for a difference d and the cloud's normal n.
    """
    nearest_cloud, nearest_other = matches
    error, gradient = 0.0, np.zeros_like(others)
    for cloud_index, other_index in ((nearest_cloud, slice(None)), (slice(None), nearest_other)):
        normals, difference = cloud.normals[cloud_index], others[other_index] - cloud.points[cloud_index]
        across = (difference * normals).sum(-1, keepdims=True)
        pull = cloud.tangential_weight * difference + (1 - cloud.tangential_weight) * across * normals
        error += float((difference * pull).sum()) / len(difference)
        if isinstance(other_index, slice):
            gradient += 2 / len(difference) * pull
        else:
            summed = np.stack([np.bincount(other_index, p, len(others)) for p in pull.T], axis=1)
            gradient += 2 / len(difference) * summed
    return error, gradient
