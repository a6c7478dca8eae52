"""Search other poses of limbs that do not lie on the surface that a body was fitted to.

A fit goes to the nearest minimum, so a folded leg or a twisted forefoot stays as wrong as it was predicted. A limb
alone has few joints: some hundred poses of it, as predicted and at random within the ranges of its joints, are tried
while the rest of the body is held, and the best are changed at random. The fit then goes on from what was found. A limb
keeps its new pose if it lies nearer to the surface than before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...bodies import load_body
from ...bodies.joint_ranges import JointRanges
from ...bodies.sampled_body import BodyState, PosedBody
from ...bodies.sampling import rotvec_to_rotmat
from ..confidence import limb_joints
from .surface_sample import SurfaceSample

SEARCHES = 3
"""How many times limbs are searched at most, each time from what the search before has found."""
LIES_ON = 0.005
"""Gap of a limb (see `limb_gaps`; metres of the body) up to which it is not searched. True poses have 3 to 9 mm, from
the distance between samples; wrong ones 5 to 100 (docs/log/animals.md)."""
LIES_OFF = 0.01
"""Gap from which on a limb is surely wrong. It is searched longer, and the other limbs that lie off do not count as
covering the surface: a tail that lies in a leg would hold the leg away."""


class Effort(NamedTuple):
    """How many poses of a limb are tried."""

    random: int
    """Random poses."""
    generations: int
    """How many times new poses are made of the best ones."""
    children: int
    """Poses that are made each time."""
    parents: int
    """Poses that they are made of."""


SHORT, LONG = Effort(128, 2, 64, 8), Effort(256, 3, 96, 16)
CHANGE = 0.15
"""Standard deviation of the changes, in the width of each joint's range."""
OTHER = 0.01
"""Distance of a limb's points (metres of the body, root of the mean square) from which on a pose is another one."""
WORTH = 1.15
"""Ratio of the distance of another pose to that of the present one up to which it is tried: it has not been fitted."""
GAIN = 0.97
"""Ratio of a limb's new gap to its old one from which on it keeps its old pose."""
UNCOVERED = 0.02
"""Distance (metres of the body) from the rest of the body beyond which a limb has to cover a point of the surface."""
FEWEST, MOST = 20, 150
"""Points of the surface that a mean is taken over: at least FEWEST, so that a single one that is far off does not
decide, and in the search MOST at most."""


def search_limbs(
    posed: PosedBody,
    surface: SurfaceSample,
    predictions: Sequence[Float[np.ndarray, "J 3 3"]],
    ranges: JointRanges,
    refined: Callable[[BodyState], BodyState],
) -> BodyState:
    """Return the state of a fitted body in which its limbs lie on the surface, if the search finds one.

    Args:
        posed: the fitted body.
        surface: with normals that point outward.
        predictions: world rotations, the other poses that are tried first.
        ranges: of the body's joints.
        refined: fits a state more closely.
    """
    state, rng = posed.state, np.random.default_rng(0)
    starts = np.stack([ranges.clipped(world) for world in predictions])
    for _ in range(SEARCHES):
        better = _with_other_limbs(PosedBody(posed.body, state), surface, starts, ranges, refined, rng)
        if better is None:
            break
        state = better
    return state


def limb_gaps(posed: PosedBody, surface: SurfaceSample) -> dict[str, float]:
    """Measure how far each limb of a body is from the surface and the surface next to it from the limb.

    Returns:
        Limb -> sum of both means (metres of the body). The trunk is "trunk".
    """
    size, of_body = posed.state.size, surface.distance_of(posed.points, posed.state.size)
    nearest, of_surface = surface.first(2 * len(posed.points)).nearest_of(posed.points, size)
    masks = {limb: posed.body.weighted_to(joints) for limb, joints in limbs(posed.body.name).items()}
    masks["trunk"] = ~np.any(list(masks.values()), axis=0)
    return {limb: float(of_body[mask].mean() + _mean(of_surface[mask[nearest]])) for limb, mask in masks.items()}


@cache
def limbs(name: str) -> dict[str, list[int]]:
    """Return the joints of head, limbs and tail of a shipped body."""
    body = load_body(name)
    tail = [j for j, joint in enumerate(body.joint_names) if joint.startswith("Tail")]
    return limb_joints(body.joint_names, body.parents) | ({"tail": tail} if tail else {})


def _mean(values: Float[np.ndarray, "*C N"]) -> Float[np.ndarray, "*C"]:
    """Compute the mean of at least FEWEST values; those that lack are 0."""
    return np.asarray(values.sum(axis=-1) / max(values.shape[-1], FEWEST))


def _with_other_limbs(
    posed: PosedBody,
    surface: SurfaceSample,
    starts: Float[np.ndarray, "P B 3"],
    ranges: JointRanges,
    refined: Callable[[BodyState], BodyState],
    rng: np.random.Generator,
) -> BodyState | None:
    """Search all limbs that do not lie on the surface, fit again, and keep the poses that are better; None: none is."""
    state, before = posed.state, limb_gaps(posed, surface)
    rotation, found = state.rotation.copy(), []
    points, placed = posed.points.copy(), np.ones(len(posed.points), dtype=bool)
    joints_of = limbs(posed.body.name)
    worst_first = sorted(joints_of, key=before.__getitem__, reverse=True)
    searched = {limb: LimbPoses.of(posed, joints_of[limb]) for limb in worst_first if before[limb] > LIES_ON}
    for limb, poses in searched.items():
        placed[poses.mask] = before[limb] < LIES_OFF
    for limb, poses in searched.items():
        effort = SHORT if before[limb] < LIES_OFF else LONG
        distance = _distance_to_surface(poses, points[placed & ~poses.mask], surface)
        pose = _other_pose(poses, distance, starts, ranges, effort, rng)
        placed |= poses.mask
        if pose is not None:
            points[poses.mask], rotation[poses.joints] = poses.points(pose[None])[0], poses.world(pose[None])[0]
            found.append(limb)
    if not found:
        return None
    tried = refined(replace(state, rotation=rotation))
    after = limb_gaps(PosedBody(posed.body, tried), surface)
    kept = [limb for limb in found if after[limb] < GAIN * before[limb]]
    if kept and kept != found:
        back = [j for limb in found if limb not in kept for j in joints_of[limb]]
        tried = refined(replace(tried, rotation=_turned_back(tried.rotation, state.rotation, back, posed.body.parents)))
        after = limb_gaps(PosedBody(posed.body, tried), surface)
    return tried if kept and sum(after.values()) < sum(before.values()) else None


def _turned_back(
    rotation: Float[np.ndarray, "J 3 3"],
    before: Float[np.ndarray, "J 3 3"],
    joints: list[int],
    parents: tuple[int, ...],
) -> Float[np.ndarray, "J 3 3"]:
    """Give some joints, parents first, the rotation from their parents that they had before."""
    rotation = rotation.copy()
    for j in joints:
        rotation[j] = rotation[parents[j]] @ before[parents[j]].T @ before[j]
    return rotation


def _other_pose(
    limb: LimbPoses,
    distance: Callable[[Float[np.ndarray, "C K 3"]], Float[np.ndarray, " C"]],
    starts: Float[np.ndarray, "P B 3"],
    ranges: JointRanges,
    effort: Effort,
    rng: np.random.Generator,
) -> Float[np.ndarray, "K 3"] | None:
    """Find the best pose of a limb that is another than the present one; None if it is much farther from the surface.

    Args:
        limb: poses the limb.
        distance: of poses from the surface.
        starts: rotation vectors of all joints but the root, from their parents, of poses to begin with.
        ranges: of the joints.
        effort: how many poses are tried.
        rng: draws them.
    """
    index = np.array(limb.joints) - 1
    low, high = ranges.low[index], ranges.high[index]
    present = ranges.local(limb.posed.state.rotation)[None, index]
    poses = np.concatenate([present, starts[:, index], rng.uniform(low, high, (effort.random, *low.shape))])
    costs = distance(poses)
    now = costs[0]
    for _ in range(effort.generations):
        best = np.argsort(costs)[: effort.parents]
        parents = poses[best][rng.integers(len(best), size=effort.children)]
        children = np.clip(parents + CHANGE * (high - low) * rng.standard_normal(parents.shape), low, high)
        poses, costs = np.concatenate([poses[best], children]), np.concatenate([costs[best], distance(children)])
    moved = np.square(limb.points(poses) - limb.points(present)).sum(axis=-1).mean(axis=-1)
    costs = np.where(np.sqrt(moved) > OTHER * limb.posed.state.size, costs, np.inf)
    k = int(np.argmin(costs))
    return poses[k] if costs[k] < WORTH * now else None


def _distance_to_surface(
    limb: LimbPoses, rest: Float[np.ndarray, "R 3"], surface: SurfaceSample
) -> Callable[[Float[np.ndarray, "C K 3"]], Float[np.ndarray, " C"]]:
    """Return the function that measures how far poses of a limb are from the surface (metres of the body).

    It adds the mean over the limb's points, and the mean over the part of the surface that the points `rest` of the
    other body leave uncovered.
    """
    from scipy.spatial import KDTree

    posed, size = limb.posed, limb.posed.state.size
    sample = surface.first(2 * len(posed.points))
    uncovered = KDTree(rest).query(sample.points)[0] > UNCOVERED * size
    part = SurfaceSample(sample.points[uncovered], sample.normals[uncovered]).first(MOST)
    _, from_rest = part.nearest_of(rest, size)

    def distance(poses: Float[np.ndarray, "C K 3"]) -> Float[np.ndarray, " C"]:
        points = limb.points(poses)
        of_limb = surface.distance_of(points.reshape(-1, 3), size).reshape(len(poses), -1).mean(axis=1)
        covered = np.minimum(part.distance_to_each(points, size), from_rest)
        return of_limb + _mean(covered)

    return distance


@dataclass(frozen=True, eq=False)
class LimbPoses:
    """Poses K joints of a limb in C ways at once, while the rest of the body is held."""

    posed: PosedBody
    joints: list[int]
    """The limb's joints, parents first."""
    mask: Bool[np.ndarray, " N"]
    """The body's points that are weighted mostly to them."""
    held: Float[np.ndarray, "M 3"]
    """What the other joints contribute to the limb's points."""

    @classmethod
    def of(cls, posed: PosedBody, joints: list[int]) -> LimbPoses:
        """Take the joints of a limb of a posed body."""
        mask = posed.body.weighted_to(joints)
        own = posed.contributions[mask]
        return cls(posed, joints, mask, own.sum(axis=1) - own[:, joints].sum(axis=1))

    def world(self, poses: Float[np.ndarray, "C K 3"]) -> Float[np.ndarray, "C K 3 3"]:
        """Turn rotation vectors from the parents into world rotations."""
        rotation = dict(enumerate(self.posed.state.rotation))
        for k, j in enumerate(self.joints):
            rotation[j] = rotation[self.posed.body.parents[j]] @ rotvec_to_rotmat(poses[:, k])
        return np.stack([rotation[j] for j in self.joints], axis=1)

    def points(self, poses: Float[np.ndarray, "C K 3"]) -> Float[np.ndarray, "C M 3"]:
        """Compute the limb's points; poses are rotation vectors from the parents."""
        posed, body, joints = self.posed, self.posed.body, self.joints
        # Size, lengths and girths of the bones stay: L = R R0^T L0, with R0 and L0 of the posed body.
        linear = self.world(poses) @ posed.state.rotation[joints].swapaxes(-1, -2) @ posed.linear[joints]
        maps, position = dict(enumerate(posed.linear)) | dict(zip(joints, linear.swapaxes(0, 1), strict=True)), {}
        for j in joints:
            parent = body.parents[j]
            bone = maps[parent] @ (posed.rest_joints[j] - posed.rest_joints[parent])
            position[j] = np.broadcast_to(position.get(parent, posed.joints[parent]) + bone, (len(poses), 3))
        weights, offset = body.weights[self.mask][:, joints], posed.offset[self.mask][:, joints]
        moved = np.einsum("ckab,mkb->cmka", linear, offset, optimize=True)
        placed = np.stack([position[j] for j in joints], axis=1)
        return self.held + np.einsum("mk,cmka->cma", weights, moved, optimize=True) + weights @ placed
