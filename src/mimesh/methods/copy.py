"""The baseline `copy`: the driving vertices themselves, where both meshes have one topology."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.mesh import Clip, Mesh
from .base import Drive


@dataclass(frozen=True)
class CopyMethod:
    """The method `copy`: vertex i of the result is vertex i of the driving."""

    rough: ClassVar[bool] = False
    name: str = "copy"

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Check that the vertex counts agree, which is all that can be checked, and return the driving frames.

        Raises:
            InputError: the vertex counts differ.
        """
        count = len(driving.mesh.vertices)
        if len(identity.vertices) != count:
            raise InputError(
                f"{driving.mesh.name}: expected {len(identity.vertices)} vertices as in {identity.name} for model "
                f"copy, found {count}; choose another model"
            )
        return _copy


def _copy(frames: Iterable[Float[np.ndarray, "V 3"]]) -> Iterator[Float[np.ndarray, "V 3"]]:
    yield from frames
