"""Detect when the feet of a driving clip stand on the ground, from contact points on their soles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .geometry import smooth_step
from .joint_tracks import JointTrack
from .soles import Feet

STANDING_SPEED = (0.4, 1.2)
"""Leg lengths a second: a contact point slower than the first stands, one faster than the second does not. Captured
runs slide by up to 0.7 where the foot stands; the foot in the air moves at 4 to 12."""
STANDING_HEIGHT = (0.08, 0.18)
"""Leg lengths over the ground, of a point that stands and of one that does not. Captures are uneven by 0.05."""
NEAR_GROUND = (0.1, 0.35)
"""Leg lengths over the ground: the height of a foot is corrected fully below the first, and not above the second."""
HIPS_HEIGHT = (0.2, 0.35)
"""Leg lengths over the ground: with the hips below the first, nobody stands: people lie, roll or swim."""
GROUND_SHARE = 0.25
"""The ground is the height that the lowest point has, or is below, in this share of the frames in which it stands."""
TREADMILL_SPEED = 0.4
"""Leg lengths a second from which on a ground that moves is looked for."""


@dataclass(frozen=True, eq=False)
class FootContacts:
    """Which contact points of F feet stand on the ground in T frames, from 0 (no) to 1 (yes)."""

    soles: Float[np.ndarray, "T F C 3"]
    """The contact points."""
    standing: Float[np.ndarray, "S F C"]
    """Between each frame and the next one (S = T - 1): low and slow."""
    near: Float[np.ndarray, "T F"]
    """In each frame: low."""
    ground_step: Float[np.ndarray, " 3"]
    """Displacement of the ground from frame to frame: zero, but for a person who walks or runs in place."""

    @property
    def planted(self) -> Bool[np.ndarray, "S F C"]:
        """Whether points stand, yes or no."""
        return self.standing > 0.5


def find_contacts(track: JointTrack, feet: Feet) -> FootContacts | None:
    """Detect contacts from the paths of a clip's contact points and of its root joint; None if it has none."""
    if track.soles is None or len(track.soles) < 3:
        return None
    soles, root = track.soles / feet.driving_leg, track.positions[:, 0] / feet.driving_leg
    velocity = np.diff(soles, axis=0) * track.fps
    height = np.maximum(soles[1:, ..., 1], soles[:-1, ..., 1])
    ground = _ground(height, np.linalg.norm(velocity, axis=-1))
    low = falling(height - ground, STANDING_HEIGHT)
    upright = 1 - falling(root[:, 1] - ground, HIPS_HEIGHT)
    moving = _ground_velocity(velocity, low, np.diff(root, axis=0) * track.fps)
    slow = falling(np.linalg.norm(velocity - moving, axis=-1), STANDING_SPEED)
    standing = low * slow * np.minimum(upright[1:], upright[:-1])[:, None, None]
    if not (standing > 0.5).any():
        return None
    near = falling(soles[..., 1].min(axis=2) - ground, NEAR_GROUND) * upright[:, None]
    return FootContacts(track.soles, standing, near, moving * feet.driving_leg / track.fps)


def _ground(height: Float[np.ndarray, "S F C"], speed: Float[np.ndarray, "S F C"]) -> float:
    """Return the height of the ground: a low quantile of the lowest point's height in frames in which it is slow.

    Not the lowest height of all: feet of captures sink into the ground for moments.
    """
    count = len(height)
    lowest = height.reshape(count, -1).argmin(axis=1)
    height, speed = (array.reshape(count, -1)[np.arange(count), lowest] for array in (height, speed))
    # With a little weight for every frame, for clips in which feet never are slow (a treadmill).
    weight = falling(speed, STANDING_SPEED) + 1e-3
    order = height.argsort(kind="stable")
    share = np.cumsum(weight[order]) / weight.sum()
    return float(height[order][np.searchsorted(share, GROUND_SHARE)])


def _ground_velocity(
    velocity: Float[np.ndarray, "S F C 3"], low: Float[np.ndarray, "S F C"], root: Float[np.ndarray, "S 3"]
) -> Float[np.ndarray, " 3"]:
    """Return the velocity of the ground: zero, but for a person who walks or runs in place.

    Then low points have one common velocity most of the time, which is not that of the root.
    """
    still = np.zeros(3)
    if low.sum() == 0:
        return still

    def agreement(velocity_of_ground: Float[np.ndarray, " 3"]) -> float:
        """Share of the low points that move with this velocity."""
        return float(
            (low * falling(np.linalg.norm(velocity - velocity_of_ground, axis=-1), STANDING_SPEED)).sum() / low.sum()
        )

    common = np.median(velocity[low > 0.5], axis=0) if (low > 0.5).any() else still
    common[1] = 0
    size = np.linalg.norm(common)
    in_place = np.linalg.norm(root.mean(axis=0)[[0, 2]]) < 0.25 * size
    if size > TREADMILL_SPEED and in_place and agreement(common) > max(0.4, 2 * agreement(still)):
        return common
    return still


def falling(values: Float[np.ndarray, "*S"], limits: tuple[float, float]) -> Float[np.ndarray, "*S"]:
    """Map values to 1 below the first limit and 0 above the second, smoothly in between."""
    return 1 - smooth_step(values, limits)
