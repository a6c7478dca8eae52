"""What every method is: the protocol behind which all of them stand.

A method sees normalised meshes only: the identity in its own Frame, the driving frames in the clip's Frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ..core.mesh import Clip, Mesh

Drive = Callable[[Iterable[Float[np.ndarray, "U 3"]]], Iterator[Float[np.ndarray, "V 3"]]]
"""Takes the driving frames one at a time and gives the identity's vertices for each, in constant memory."""


@runtime_checkable
class Method(Protocol):
    """A way to move an identity."""

    rough: ClassVar[bool]
    """Whether its results are refined unless the user says otherwise (see `refine.py`)."""

    @property
    def name(self) -> str: ...

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """All work that is done once: it may depend on the identity and on glimpses of the driving.

        These are a few frames of it, evenly spread, of which the first is the first frame, in which the mesh stands.
        """
        ...
