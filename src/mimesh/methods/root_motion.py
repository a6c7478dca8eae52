"""Give methods that predict centred shapes the displacement of the driving clip, scaled to the identity's size."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.normalization import bbox_centre, radius

Shapes = Callable[[Iterable[Float[np.ndarray, "U 3"]]], Iterator[Float[np.ndarray, "V 3"]]]
"""Maps driving frames to the identity's vertices in these poses, each at any position."""


def with_root_motion(
    frames: Iterable[Float[np.ndarray, "U 3"]], shapes: Shapes, name: str
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Move the centre of each shape's bounding box to that of the driving frame, scaled.

    Driving frames are in the driving's normalisation, where its first frame has radius 1. The scale is the radius of
    the first result, so that a large identity moves as far as a small one in multiples of its own size.

    Raises:
        InputError: all vertices of a frame of the clip `name` are at one point.
    """
    scale = None
    # Shapes may be made of windows, which read ahead; `tee` keeps the frames between the two.
    given, ahead = itertools.tee(check_size(frames, name))
    for vertices, shape in zip(given, shapes(ahead), strict=True):
        result = shape - bbox_centre(shape)
        scale = radius(result) if scale is None else scale  # of the first frame: a size that does not change over time
        yield result + bbox_centre(vertices) * scale


def check_size(frames: Iterable[Float[np.ndarray, "U 3"]], name: str) -> Iterator[Float[np.ndarray, "U 3"]]:
    """Yield the frames of the clip `name`, checking that they have a size.

    Raises:
        InputError: all vertices of a frame are at one point.
    """
    for t, vertices in enumerate(frames):
        if not (vertices != vertices[0]).any():
            raise InputError(
                f"{name}: expected some size in frame {t} of those taken, found all vertices at one point; "
                "repair that frame, or end the clip before it with --stop"
            )
        yield vertices
