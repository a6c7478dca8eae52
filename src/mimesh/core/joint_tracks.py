"""Motion of joints in a clip: smoothing over time, and paths of the root joint on which feet do not slide."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from .geometry import nearest_rotation
from .rig import Rig
from .skinning import SkinnedMesh

PLANTED_HEIGHT, PLANTED_SPEED = 0.06, 0.15
"""A foot is planted below this height over the ground (leg lengths) and this speed (leg lengths a second)."""
LIFT_SMOOTHING = 0.05
"""Standard deviation (seconds) of the Gaussian that smooths vertical corrections, so that landings do not jolt."""


@dataclass(frozen=True, eq=False)
class JointTrack:
    """World rotations and positions of J joints in T frames."""

    rotation: Float[np.ndarray, "T J 3 3"]
    positions: Float[np.ndarray, "T J 3"]
    fps: float

    def smoothed(self, seconds: float) -> JointTrack:
        """Average rotations and positions over time with a Gaussian of this standard deviation.

        Positions are averaged about the line from the first to the last, so that the way stays as long as it was.
        """
        if seconds <= 0 or len(self.positions) == 1:
            return self
        line = np.linspace(self.positions[0], self.positions[-1], len(self.positions))
        rotation, off = (_blurred(array, seconds * self.fps) for array in (self.rotation, self.positions - line))
        return replace(self, rotation=nearest_rotation(rotation), positions=line + off)

    def foot_heights(self, feet: FootJoints) -> Float[np.ndarray, "T F"]:
        """Height of each foot joint over its height when planted; the lowest of the clip is taken to be planted."""
        height = self.positions[:, list(feet.joints), 1] - feet.driving_height
        return height - height.min()

    def planted(self, feet: FootJoints) -> Bool[np.ndarray, "T F"]:
        """Which foot joints stand on the ground: those that are low and slow."""
        low = self.foot_heights(feet) < PLANTED_HEIGHT * feet.driving_leg
        if len(self.positions) == 1:
            return low
        speed = np.linalg.norm(np.gradient(self.positions[:, list(feet.joints)], axis=0), axis=-1) * self.fps
        return low & (speed < PLANTED_SPEED * feet.driving_leg)


@dataclass(frozen=True)
class FootJoints:
    """Joints that may stand on the ground."""

    joints: tuple[int, ...]
    driving_leg: float
    """Length of the driving's leg."""
    identity_height: Float[np.ndarray, " F"]
    """Height of each of these joints over the identity's ground when its foot is flat on it."""
    driving_height: Float[np.ndarray, " F"]
    """The same of the driving."""


def sole_depths(rig: Rig, vertices: Float[np.ndarray, "V 3"], joints: tuple[int, ...]) -> Float[np.ndarray, " F"]:
    """How far below each joint, in its own frame, the vertices reach whose largest weight it has; 0 without any."""
    strongest = rig.weights.argmax(axis=1)
    down = [-(rig.rotation[j].T @ (vertices[strongest == j] - rig.joints[j]).T)[1] for j in joints]
    return np.array([depth.max(initial=0.0) for depth in down])


def root_path(track: JointTrack, across: float, up: float, in_place: bool) -> Float[np.ndarray, "T 3"]:
    """Positions of the driving's root joint, scaled by `across` over the ground and by `up` vertically.

    With `in_place` it only moves vertically.
    """
    path = np.array([across, up, across]) * track.positions[:, 0]
    return np.where([in_place, False, in_place], path[:1], path)


def grounded_path(
    track: JointTrack, path: Float[np.ndarray, "T 3"], skinned: SkinnedMesh, feet: FootJoints, up: float
) -> Float[np.ndarray, "T 3"]:
    """Correct a root path so that joints planted in the driving do not slide, and stand on the ground.

    Over the ground: from frame to frame the root is moved against the mean slide of the joints planted in both; in the
    air it keeps its displacement. Vertically: planted joints get the driving's height over the ground (times `up`), and
    corrections are interpolated between and smoothed.
    """
    planted = track.planted(feet)
    if not planted.any():
        return path
    reached = np.stack([skinned.places(turned, np.zeros(3))[list(feet.joints)] for turned in track.rotation])
    correction = np.zeros_like(path)
    both = planted[1:] & planted[:-1]
    slide = np.diff(reached + path[:, None], axis=0)
    correction[1:, [0, 2]] = -np.cumsum(_masked_mean(slide, both)[:, [0, 2]], axis=0)
    height = feet.identity_height + up * track.foot_heights(feet) - reached[..., 1]
    known = planted.any(axis=1)
    lift = _masked_mean(height[..., None], planted)[known, 0] - path[known, 1]
    correction[:, 1] = np.interp(np.arange(len(path)), np.flatnonzero(known), lift)
    correction[:, 1] = _blurred(correction[:, 1], LIFT_SMOOTHING * track.fps)
    return path + correction


def foot_skate(
    track: JointTrack, path: Float[np.ndarray, "T 3"], skinned: SkinnedMesh, feet: FootJoints
) -> float | None:
    """Mean speed (a second) over the ground of the identity's joints while planted in the driving; None: never."""
    planted = track.planted(feet)
    both = planted[1:] & planted[:-1]
    if not both.any():
        return None
    reached = np.stack([skinned.places(*pose)[list(feet.joints)] for pose in zip(track.rotation, path, strict=True)])
    return float(np.linalg.norm(np.diff(reached, axis=0)[..., [0, 2]], axis=-1)[both].mean() * track.fps)


def _masked_mean(values: Float[np.ndarray, "T F C"], mask: Bool[np.ndarray, "T F"]) -> Float[np.ndarray, "T C"]:
    """Mean over the feet of the mask; zero where there are none."""
    return (values * mask[..., None]).sum(axis=1) / np.maximum(mask.sum(axis=1), 1)[:, None]


def _blurred(array: Float[np.ndarray, "T *C"], frames: float) -> Float[np.ndarray, "T *C"]:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(array, frames, axis=0, mode="nearest")
