"""Keys in time: the frame rate they lie on, and what lies between two of them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

RATES = (24.0, 25.0, 30.0, 50.0, 60.0, 15.0, 12.0, 120.0, 10.0)
"""Frames a second that the keys of a file may lie on, likeliest first."""
ON_GRID = 0.02
"""Of a frame: keys this near to whole frames lie on them."""
DEFAULT_FPS = 30.0
"""Of what does not say."""
HIGHEST_FPS = 10_000.0
"""More frames than this, of a second, are asked for by mistake."""
LONGEST = 3600.0
"""Seconds; an animation that lasts longer has broken times."""


def usual_rate(times: Float[np.ndarray, " K"]) -> float | None:
    """The frames a second whose frames all times (seconds) lie on, counted from zero; None if no usual rate's."""
    for rate in RATES:
        if len(times) > 2 and lie_on(times, rate):
            return rate
    return None


def lie_on(times: Float[np.ndarray, " K"], rate: float) -> bool:
    """Whether all times (seconds) are those of frames of this rate, counted from zero."""
    return bool(np.abs(times * rate - np.round(times * rate)).max(initial=0.0) < ON_GRID)


def sample_rate(times: Float[np.ndarray, " K"]) -> float | None:
    """The rate of evenly spaced samples, wherever they begin; None where they are fewer than two or uneven."""
    if len(times) < 2 or times[-1] <= times[0]:
        return None
    rate = (len(times) - 1) / float(times[-1] - times[0])
    even = times[0] + np.arange(len(times)) / rate
    if np.abs(times - even).max() * rate > ON_GRID:
        return None
    return float(round(rate)) if abs(rate - round(rate)) < 1e-3 else rate


def frame_count(seconds: float, fps: float) -> int:
    """Frames from 0 to so many seconds, both included: frame k is at k / fps."""
    return int(np.floor(seconds * fps + ON_GRID)) + 1


def between(
    times: Float[np.ndarray, " K"], wanted: Float[np.ndarray, " T"]
) -> tuple[Int[np.ndarray, " T"], Int[np.ndarray, " T"], Float[np.ndarray, " T"]]:
    """For each wanted time, the samples before and after it and how far it is from one to the other, 0..1.

    Before the first sample and after the last one these hold. `times` rise.
    """
    after = np.clip(np.searchsorted(times, wanted, side="right"), 1, max(len(times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    span = np.where(after > before, times[after] - times[before], 1.0)
    return before, after, np.clip((wanted - times[before]) / span, 0.0, 1.0)
