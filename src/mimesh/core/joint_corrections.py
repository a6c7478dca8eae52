"""JointCorrections: positions of joints that the user has picked on a mesh, in the coordinates of its file."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from .errors import InputError

OTHER_UNIT = 2.0
"""Ratio of the sizes of two meshes from which on they are in different units: inches and centimetres have 2.54, and a
person who crouches is more than half as large as one who stands."""
AT_ORIGIN = 0.02
"""Distance from the origin, in the longest side of the box, within which all joints of another unit lie: those of a
person in metres are within 1 % of a mesh in centimetres."""
MOST_OUTSIDE = 0.5
"""Largest distance of a joint from the bounding box of its mesh, in the longest side of that box."""


@dataclass(frozen=True, eq=False)
class JointCorrections:
    """Joint -> position in the axes, unit and position of the mesh's file; further joints are left to the model."""

    positions: Mapping[str, Float[np.ndarray, " 3"]] = field(default_factory=dict)
    frame: int = 0
    """Frame of a clip that the positions are in, counted from 0 in its file."""
    mesh: str = ""
    """Name of the mesh's file; empty if it is not known."""
    vertices: int | None = None
    """Number of vertices of the mesh; None if it is not known."""
    size: float | None = None
    """Longest side of the mesh's bounding box; None if it is not known."""
    source: str = "joints"
    """Where they are from, for messages: a path, or the name of an argument."""

    @classmethod
    def of(cls, positions: Mapping[str, Any], source: str = "joints", **fields: Any) -> JointCorrections:
        """Make corrections from any numbers."""
        return cls({name: _position(name, value, source) for name, value in positions.items()}, source=source, **fields)

    @classmethod
    def found_on(
        cls,
        vertices: Float[np.ndarray, "V 3"],
        positions: Mapping[str, Float[np.ndarray, " 3"]],
        frame: int = 0,
        mesh: str = "",
    ) -> JointCorrections:
        """Make corrections of joints that were found on a mesh, with what tells it from others."""
        return cls(positions, frame, mesh, len(vertices), float(np.ptp(vertices, axis=0).max()))

    def check(self, vertices: Float[np.ndarray, "V 3"], names: Sequence[str], mesh: str) -> None:
        """Check that joints are among `names`, and belong to a mesh with these vertices.

        Raises:
            InputError: an unknown joint, another number of vertices, another unit, or a position far outside of the
                mesh.
        """
        for name in self.positions:
            if name not in names:
                close = difflib.get_close_matches(name, names, n=1)
                hint = f"did you mean {close[0]}?" if close else f"use one of {', '.join(names)}"
                raise InputError(f"{self.source}: expected names of joints, found {name!r}; {hint}")
        if self.vertices is not None and self.vertices != len(vertices):
            raise InputError(
                f"{self.source}: expected corrections of {mesh} with {len(vertices)} vertices, found those of a mesh "
                f"with {self.vertices}; correct the joints again, or leave the joints out"
            )
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        longest = float((high - low).max())
        if self.size is not None and not longest / OTHER_UNIT < self.size < longest * OTHER_UNIT:
            raise InputError(
                f"{self.source}: expected joints of {mesh}, whose longest side is {longest:.4g}, found those of a mesh "
                f"of {self.size:.4g}; give positions in the unit of the mesh's file"
            )
        reach = max((float(np.abs(position).max()) for position in self.positions.values()), default=np.inf)
        # Of a mesh around its origin, the hips alone may be there.
        if self.size is None and reach < AT_ORIGIN * longest and self.positions.keys() != {"Hips"}:
            raise InputError(
                f"{self.source}: expected joints of {mesh}, whose longest side is {longest:.4g}, found all within "
                f"{reach:.4g} of the origin; give positions in the unit of the mesh's file"
            )
        most = MOST_OUTSIDE * longest
        for name, position in self.positions.items():
            if np.maximum(low - position, position - high).max() > most:
                found, box = (" ".join(f"{value:.4g}" for value in row) for row in (position, [*low, *high]))
                raise InputError(
                    f"{self.source}: expected {name} near {mesh}, whose bounding box is {box}, found it at {found}; "
                    "give positions in the axes and unit of the mesh's file"
                )


def _position(name: str, value: Any, source: str) -> Float[np.ndarray, " 3"]:
    try:
        position = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        position = np.zeros(0)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise InputError(f"{source}: expected three finite numbers for {name}, found {str(value)[:60]}; correct them")
    return position
