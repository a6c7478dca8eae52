"""What joints do in a clip: calmed over time, and a path for the root joint on which feet do not slide."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from .geometry import nearest_rotation
from .rig import Rig, Skinned

LOW, SLOW = 0.06, 0.15
"""A foot stands where it is no higher over the ground (leg lengths), nor faster (leg lengths a second)."""
LANDING = 0.05
"""Standard deviation (seconds) over which a path that feet correct is smoothed up and down."""


@dataclass(frozen=True, eq=False)
class Track:
    """T frames of J joints, in the world."""

    rotation: Float[np.ndarray, "T J 3 3"]
    places: Float[np.ndarray, "T J 3"]
    fps: float

    def smoothed(self, seconds: float) -> Track:
        """Rotations and places averaged over time, with weights of a Gaussian of this standard deviation.

        Places are averaged about the line from the first to the last, so that the way is as long as before.
        """
        if seconds <= 0 or len(self.places) == 1:
            return self
        line = np.linspace(self.places[0], self.places[-1], len(self.places))
        rotation, off = (_blurred(array, seconds * self.fps) for array in (self.rotation, self.places - line))
        return replace(self, rotation=nearest_rotation(rotation), places=line + off)

    def above(self, feet: Feet) -> Float[np.ndarray, "T F"]:
        """How high each foot joint is over where it is when it stands; the ground is where the lowest of all stands."""
        height = self.places[:, list(feet.joints), 1] - feet.theirs
        return height - height.min()

    def standing(self, feet: Feet) -> Bool[np.ndarray, "T F"]:
        """Which of the feet's joints stand on the ground: low and slow, as this clip goes."""
        low = self.above(feet) < LOW * feet.leg
        if len(self.places) == 1:
            return low
        speed = np.linalg.norm(np.gradient(self.places[:, list(feet.joints)], axis=0), axis=-1) * self.fps
        return low & (speed < SLOW * feet.leg)


@dataclass(frozen=True)
class Feet:
    """Joints that may stand on the ground."""

    joints: tuple[int, ...]
    leg: float
    """Length of the driving's leg."""
    soles: Float[np.ndarray, " F"]
    """Height of each of these joints over the identity's ground when its foot is flat on it."""
    theirs: Float[np.ndarray, " F"]
    """The same of the driving."""


def soles(rig: Rig, vertices: Float[np.ndarray, "V 3"], joints: tuple[int, ...]) -> Float[np.ndarray, " F"]:
    """How far the surface that each joint holds most reaches below it, as it sees down: zero for what holds nothing."""
    most = rig.weights.argmax(axis=1)
    down = [-(rig.rotation[j].T @ (vertices[most == j] - rig.joints[j]).T)[1] for j in joints]
    return np.array([depth.max(initial=0.0) for depth in down])


def straight(track: Track, across: float, up: float, drop: bool) -> Float[np.ndarray, "T 3"]:
    """The root joint's way: the driving's, so many times as long across the ground and up and down.

    With `drop` it goes up and down alone.
    """
    path = np.array([across, up, across]) * track.places[:, 0]
    return np.where([drop, False, drop], path[:1], path)


def grounded(track: Track, path: Float[np.ndarray, "T 3"], skinned: Skinned, feet: Feet, up: float) -> np.ndarray:
    """A path near the given one on which joints that stand in the driving do not slide, and stand on the ground.

    Sideways, what stands keeps its place and what is in the air keeps its way. Up and down, what stands is as high over
    the ground as in the driving (`up` times that), and the way between is blended.

    Returns:
        Root joint, (T, 3).
    """
    stands = track.standing(feet)
    if not stands.any():
        return path
    own = np.stack([skinned.places(turned, np.zeros(3))[list(feet.joints)] for turned in track.rotation])
    off = np.zeros_like(path)
    both = stands[1:] & stands[:-1]
    slide = np.diff(own + path[:, None], axis=0)
    off[1:, [0, 2]] = -np.cumsum(_mean(slide, both)[:, [0, 2]], axis=0)
    height = feet.soles + up * track.above(feet) - own[..., 1]
    known = stands.any(axis=1)
    lift = _mean(height[..., None], stands)[known, 0] - path[known, 1]
    off[:, 1] = np.interp(np.arange(len(path)), np.flatnonzero(known), lift)
    off[:, 1] = _blurred(off[:, 1], LANDING * track.fps)
    return path + off


def skate(track: Track, path: Float[np.ndarray, "T 3"], skinned: Skinned, feet: Feet) -> float | None:
    """Mean speed (a second) along the ground of the identity's joints while they stand in the driving; None: never."""
    stands = track.standing(feet)
    both = stands[1:] & stands[:-1]
    if not both.any():
        return None
    own = np.stack([skinned.places(*frame)[list(feet.joints)] for frame in zip(track.rotation, path, strict=True)])
    return float(np.linalg.norm(np.diff(own, axis=0)[..., [0, 2]], axis=-1)[both].mean() * track.fps)


def _mean(values: Float[np.ndarray, "T F C"], which: Bool[np.ndarray, "T F"]) -> Float[np.ndarray, "T C"]:
    """Mean over some of the feet; zero where there are none."""
    return (values * which[..., None]).sum(axis=1) / np.maximum(which.sum(axis=1), 1)[:, None]


def _blurred(array: Float[np.ndarray, "T *C"], frames: float) -> Float[np.ndarray, "T *C"]:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(array, frames, axis=0, mode="nearest")
