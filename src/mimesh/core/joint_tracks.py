"""Motion of a clip's joints: smoothing over time, and the path of the root joint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from .geometry import nearest_rotation


@dataclass(frozen=True, eq=False)
class JointTrack:
    """World rotations and positions of J joints in T frames, and contact points of F feet."""

    rotation: Float[np.ndarray, "T J 3 3"]
    positions: Float[np.ndarray, "T J 3"]
    fps: float
    soles: Float[np.ndarray, "T F C 3"] | None = None
    """Positions of the contact points on the soles, of the surface itself; smoothing does not change them."""
    lowest: Float[np.ndarray, " T"] | None = None
    """Height of the lowest point of the rest of the surface."""

    def at(self, frames: Int[np.ndarray, " N"], fps: float) -> JointTrack:
        """Select some frames."""
        soles, lowest = (None if of is None else of[frames] for of in (self.soles, self.lowest))
        return JointTrack(self.rotation[frames], self.positions[frames], fps, soles, lowest)

    def without_hands(self, hands: int) -> JointTrack:
        """Leave out the contact points of the last feet, which are hands."""
        return self if self.soles is None else replace(self, soles=self.soles[:, : self.soles.shape[1] - hands])

    def smoothed(self, seconds: float) -> JointTrack:
        """Average rotations and positions over time with a Gaussian of this standard deviation.

        Positions are averaged relative to the line from the first to the last, which keeps the length of the path.
        """
        if seconds <= 0 or len(self.positions) == 1:
            return self
        line = np.linspace(self.positions[0], self.positions[-1], len(self.positions))
        rotation, offset = (_blur(array, seconds * self.fps) for array in (self.rotation, self.positions - line))
        return replace(self, rotation=nearest_rotation(rotation), positions=line + offset)


def root_path(track: JointTrack, across: float, up: float, in_place: bool) -> Float[np.ndarray, "T 3"]:
    """Scale the path of the driving's root joint by `across` horizontally and by `up` vertically.

    With `in_place` the horizontal position stays that of the first frame.
    """
    path = np.array([across, up, across]) * track.positions[:, 0]
    return np.where([in_place, False, in_place], path[:1], path)


def _blur(array: Float[np.ndarray, "T *C"], frames: float) -> Float[np.ndarray, "T *C"]:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(array, frames, axis=0, mode="nearest")
