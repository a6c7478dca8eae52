"""What a new USD file takes over from the one that a mesh was read from."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Int

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MOST_LAYERS = 1000
"""Files of the folders around a layer that are looked at."""


@dataclass(frozen=True, eq=False)
class UsdSource:
    """The polygons, axis and unit of the USD stage that a Mesh was read from. Satisfies `mesh.Source`."""

    suffix: str
    sizes: Int[np.ndarray, " P"] = field(repr=False)
    """Corners of each polygon; the faces are triangle fans of them."""
    up_axis: str
    """The token Y or Z."""
    meters_per_unit: float
    notes: tuple[str, ...]
    """One line for each thing of the stage that a new file lacks."""

    @property
    def details(self) -> tuple[tuple[str, str], ...]:
        """Rows of name and value for `mimesh look`: the stage's unit and up axis."""
        return (("unit", f"{self.meters_per_unit:g} m, {self.up_axis.lower()} up"),)


def layer_bytes(path: Path) -> int:
    """Return the bytes of a layer and of those in its folder and the folders in that, which it may be composed of."""
    files = itertools.islice(itertools.chain(path.parent.glob("*"), path.parent.glob("*/*")), MOST_LAYERS)
    sizes = [file.stat().st_size for file in files if file.suffix.lower() in SUFFIXES and file.is_file()]
    return max(sum(sizes), path.stat().st_size)
