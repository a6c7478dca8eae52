"""Frame rates of time samples, and positions between two samples."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

RATES = (24.0, 25.0, 30.0, 50.0, 60.0, 15.0, 12.0, 120.0, 10.0)
"""Usual frame rates in frames per second, likeliest first: film, PAL, NTSC, their doubles, and rates of capture."""
ON_GRID = 0.02
"""Frames; a time nearer than this to a whole frame counts as on it."""
DEFAULT_FPS = 30.0
"""Frames per second of files without a frame rate."""
LONGEST = 3600.0
"""Seconds; a longer animation is refused, since its times are most likely damaged."""


def usual_rate(times: Float[np.ndarray, " K"]) -> float | None:
    """Find the first of `RATES` whose frame grid, counted from zero, contains all times (seconds); None if none does.

    Fewer than three times do not determine a rate.
    """
    for rate in RATES:
        if len(times) > 2 and lie_on(times, rate):
            return rate
    return None


def lie_on(times: Float[np.ndarray, " K"], rate: float) -> bool:
    """Return whether all times (seconds) are times of frames of this rate, counted from zero."""
    return bool(np.abs(times * rate - np.round(times * rate)).max(initial=0.0) < ON_GRID)


def sample_rate(times: Float[np.ndarray, " K"]) -> float | None:
    """Return the rate of evenly spaced samples, which may start at any time; None for fewer than two or uneven ones."""
    if len(times) < 2 or times[-1] <= times[0]:
        return None
    rate = (len(times) - 1) / float(times[-1] - times[0])
    even = times[0] + np.arange(len(times)) / rate
    if np.abs(times - even).max() * rate > ON_GRID:
        return None
    return float(round(rate)) if abs(rate - round(rate)) < 1e-3 else rate  # removes rounding of float32 times


def frame_count(seconds: float, fps: float) -> int:
    """Count the frames at k / fps from 0 to `seconds`, both ends included."""
    return int(np.floor(seconds * fps + ON_GRID)) + 1
