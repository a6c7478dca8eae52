"""Where results stand: a method that knows shapes only lets them walk as the driving does, in the identity's size."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.normalization import bbox_centre, radius

Pose = Callable[[Float[np.ndarray, "U 3"]], Float[np.ndarray, "V 3"]]
"""Driving vertices of one frame to the identity's vertices in that pose, standing anywhere."""


def travelling(frames: Iterable[Float[np.ndarray, "U 3"]], pose: Pose, name: str) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Pose every frame, its bounding box centred where the driving's is.

    The first result's size says how large the identity is beside its driving, whose path is scaled by it.

    Raises:
        InputError: a frame without size, called by the clip's name.
    """
    travel = None
    for vertices in sized(frames, name):
        result = pose(vertices)
        result = result - bbox_centre(result)
        travel = radius(result) if travel is None else travel
        yield result + bbox_centre(vertices) * travel


def sized(frames: Iterable[Float[np.ndarray, "U 3"]], name: str) -> Iterator[Float[np.ndarray, "U 3"]]:
    """The frames, as long as each has some size.

    Raises:
        InputError: one has none, called by the clip's name.
    """
    for t, vertices in enumerate(frames):
        if not np.ptp(vertices, axis=0).any():
            raise InputError(
                f"{name}: expected some size in frame {t} of those taken, found all vertices at one point; "
                "repair that frame, or end the clip before it with --stop"
            )
        yield vertices
