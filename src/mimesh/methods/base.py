"""The protocol of methods that move vertices: `Method`, and what its `prepare` takes and returns.

Methods work on normalised meshes only: y up, +z front, bounding box centred, largest distance from its centre 1.
The identity has a normalisation of its own; all frames of the driving have that of its first frame. `mime` is none of
them: it finds joints (`mime.model`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ..core.mesh import Clip, Mesh, check_size
from ..core.normalization import bbox_centre, radius

Drive = Callable[[Iterable[Float[np.ndarray, "U 3"]]], Iterator[Float[np.ndarray, "V 3"]]]
"""Maps driving frames to the identity's vertices, one frame at a time, so that memory does not grow with the clip."""
Shapes = Callable[[Iterable[Float[np.ndarray, "U 3"]]], Iterator[Float[np.ndarray, "V 3"]]]
"""Maps driving frames to the identity's vertices in these poses, each at any position."""


@runtime_checkable
class Method(Protocol):
    """A way to give an identity the motion of a driving mesh."""

    rough: ClassVar[bool]
    """Whether results have an uneven surface and are refined by default (see `pipeline.refine`)."""

    @property
    def name(self) -> str:
        """Name of the method in messages and reports."""
        ...

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Do all work that is done once, and return the function that moves the identity.

        Args:
            identity: the mesh to move, normalised.
            driving: keyframes of the driving clip, normalised: a few frames, evenly spread, the clip's first one first.
                Its `mesh` has the vertices of that first frame.
        """
        ...


def with_root_motion(
    frames: Iterable[Float[np.ndarray, "U 3"]], shapes: Shapes, name: str
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Move the centre of each shape's bounding box to that of the driving frame, scaled.

    Driving frames are in the driving's normalisation, where its first frame has radius 1. The scale is the radius of
    the first result, so that a large identity moves as far as a small one in multiples of its own size.
    """
    scale = None
    # Shapes may be made of windows, which read ahead; `tee` keeps the frames between the two.
    given, ahead = itertools.tee(check_size(frames, name))
    for vertices, shape in zip(given, shapes(ahead), strict=True):
        result = shape - bbox_centre(shape)
        scale = radius(result) if scale is None else scale  # of the first frame: a size that does not change over time
        yield result + bbox_centre(vertices) * scale
