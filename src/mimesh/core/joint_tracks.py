"""Motion of a clip's joints: smoothing over time, and correction of the root path so that planted feet do not slide."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from .geometry import nearest_rotation
from .rig import Rig
from .skinning import SkinnedMesh

PLANTED_HEIGHT, PLANTED_SPEED = 0.06, 0.15
"""A foot is planted below this height over the ground (leg lengths) and this speed (leg lengths per second)."""
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

        Positions are averaged relative to the line from the first to the last, which keeps the length of the path.
        """
        if seconds <= 0 or len(self.positions) == 1:
            return self
        line = np.linspace(self.positions[0], self.positions[-1], len(self.positions))
        rotation, offset = (_blur(array, seconds * self.fps) for array in (self.rotation, self.positions - line))
        return replace(self, rotation=nearest_rotation(rotation), positions=line + offset)

    def foot_heights(self, feet: FootJoints) -> Float[np.ndarray, "T F"]:
        """Compute each foot joint's height above the planted foot; the lowest foot of the clip counts as planted."""
        height = self.positions[:, list(feet.joints), 1] - feet.driving_height
        return height - height.min()

    def planted(self, feet: FootJoints) -> Bool[np.ndarray, "T F"]:
        """Detect which foot joints stand on the ground: those that are low and slow."""
        low = self.foot_heights(feet) < PLANTED_HEIGHT * feet.driving_leg
        if len(self.positions) == 1:
            return low
        speed = np.linalg.norm(np.gradient(self.positions[:, list(feet.joints)], axis=0), axis=-1) * self.fps
        return low & (speed < PLANTED_SPEED * feet.driving_leg)


@dataclass(frozen=True)
class FootJoints:
    """Foot joints that may stand on the ground."""

    joints: tuple[int, ...]
    """Indices of the F foot joints."""
    driving_leg: float
    """Leg length of the driving mesh."""
    identity_height: Float[np.ndarray, " F"]
    """Height of each of these joints above the ground when the identity's foot is flat on it."""
    driving_height: Float[np.ndarray, " F"]
    """The same for the driving mesh."""


def sole_depths(rig: Rig, vertices: Float[np.ndarray, "V 3"], joints: tuple[int, ...]) -> Float[np.ndarray, " F"]:
    """Measure how far the vertices with their largest weight on a joint extend below it, along -y of its frame.

    0 for a joint without such vertices.
    """
    strongest = rig.weights.argmax(axis=1)
    down = [-(rig.rotation[j].T @ (vertices[strongest == j] - rig.joints[j]).T)[1] for j in joints]
    return np.array([depth.max(initial=0.0) for depth in down])


def root_path(track: JointTrack, across: float, up: float, in_place: bool) -> Float[np.ndarray, "T 3"]:
    """Scale the path of the driving's root joint by `across` horizontally and by `up` vertically.

    With `in_place` the horizontal position stays that of the first frame.
    """
    path = np.array([across, up, across]) * track.positions[:, 0]
    return np.where([in_place, False, in_place], path[:1], path)


def grounded_path(
    track: JointTrack, path: Float[np.ndarray, "T 3"], skinned: SkinnedMesh, feet: FootJoints, up: float
) -> Float[np.ndarray, "T 3"]:
    """Correct a root path so that joints planted in the driving clip stand on the ground and do not slide.

    Horizontally: between two frames the root is moved against the mean slide of the joints planted in both; in the air
    it keeps its displacement. Vertically: planted joints get the driving joint's height above the ground (times `up`);
    corrections are interpolated in between and smoothed.
    """
    planted = track.planted(feet)
    if not planted.any():
        return path
    # Foot positions of the identity relative to its root joint.
    reached = np.stack(
        [skinned.joint_positions(rotation, np.zeros(3))[list(feet.joints)] for rotation in track.rotation]
    )
    correction = np.zeros_like(path)
    # Horizontal: accumulate the slide of joints that are planted in two frames in a row.
    both = planted[1:] & planted[:-1]
    slide = np.diff(reached + path[:, None], axis=0)
    correction[1:, [0, 2]] = -np.cumsum(_masked_mean(slide, both)[:, [0, 2]], axis=0)
    height = feet.identity_height + up * track.foot_heights(feet) - reached[..., 1]
    # Vertical: where joints are planted, their mean height error; interpolated in between.
    known = planted.any(axis=1)
    lift = _masked_mean(height[..., None], planted)[known, 0] - path[known, 1]
    correction[:, 1] = np.interp(np.arange(len(path)), np.flatnonzero(known), lift)
    correction[:, 1] = _blur(correction[:, 1], LIFT_SMOOTHING * track.fps)
    return path + correction


def foot_skate(
    track: JointTrack, path: Float[np.ndarray, "T 3"], skinned: SkinnedMesh, feet: FootJoints
) -> float | None:
    """Measure the mean horizontal speed (per second) of the identity's feet while the driving's are planted.

    None if they never are.
    """
    planted = track.planted(feet)
    both = planted[1:] & planted[:-1]
    if not both.any():
        return None
    reached = np.stack(
        [skinned.joint_positions(*pose)[list(feet.joints)] for pose in zip(track.rotation, path, strict=True)]
    )
    return float(np.linalg.norm(np.diff(reached, axis=0)[..., [0, 2]], axis=-1)[both].mean() * track.fps)


def _masked_mean(values: Float[np.ndarray, "T F C"], mask: Bool[np.ndarray, "T F"]) -> Float[np.ndarray, "T C"]:
    """Average over the feet where the mask is set; zero in frames without any."""
    return (values * mask[..., None]).sum(axis=1) / np.maximum(mask.sum(axis=1), 1)[:, None]


def _blur(array: Float[np.ndarray, "T *C"], frames: float) -> Float[np.ndarray, "T *C"]:
    """Filter along time with a Gaussian of this standard deviation (frames)."""
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(array, frames, axis=0, mode="nearest")
