"""Displacement of results of methods that predict shapes only: the driving's, in the identity's size."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.normalization import bbox_centre, radius

PoseFunction = Callable[[Float[np.ndarray, "U 3"]], Float[np.ndarray, "V 3"]]
"""Driving vertices of one frame to the identity's vertices in that pose, placed anywhere."""


def with_root_motion(
    frames: Iterable[Float[np.ndarray, "U 3"]], pose: PoseFunction, name: str
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Pose every frame and centre its bounding box at that of the driving frame, times the size of the first result.

    Raises:
        InputError: a frame of the clip `name` without size.
    """
    scale = None
    for vertices in check_size(frames, name):
        result = pose(vertices)
        result = result - bbox_centre(result)
        scale = radius(result) if scale is None else scale
        yield result + bbox_centre(vertices) * scale


def check_size(frames: Iterable[Float[np.ndarray, "U 3"]], name: str) -> Iterator[Float[np.ndarray, "U 3"]]:
    """Yield the frames of the clip `name`, as long as their vertices are not all at one point.

    Raises:
        InputError: they are.
    """
    for t, vertices in enumerate(frames):
        if not np.ptp(vertices, axis=0).any():
            raise InputError(
                f"{name}: expected some size in frame {t} of those taken, found all vertices at one point; "
                "repair that frame, or end the clip before it with --stop"
            )
        yield vertices
