"""JointCorrections: positions of joints that the user has picked on a mesh, in the coordinates of its file."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from .errors import InputError

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
    source: str = "joints"
    """Where they are from, for messages: a path, or the name of an argument."""

    @classmethod
    def of(cls, positions: Mapping[str, Any], source: str = "joints", **fields: Any) -> JointCorrections:
        """Make corrections from any numbers.

        Raises:
            InputError: a position is not three finite numbers.
        """
        return cls({name: _position(name, value, source) for name, value in positions.items()}, source=source, **fields)

    def check(self, vertices: Float[np.ndarray, "V 3"], names: Sequence[str], mesh: str) -> None:
        """Check that joints are among `names`, and belong to a mesh with these vertices.

        Raises:
            InputError: an unknown joint, another number of vertices, or a position far outside of the mesh.
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
        most = MOST_OUTSIDE * float((high - low).max())
        for name, position in self.positions.items():
            if np.maximum(low - position, position - high).max() > most:
                found, box = (" ".join(f"{value:.4g}" for value in row) for row in (position, [*low, *high]))
                raise InputError(
                    f"{self.source}: expected {name} near {mesh}, whose bounding box is {box}, found it at {found}; "
                    "give positions in the axes and unit of the mesh's file"
                )


def _position(name: str, value: Any, source: str) -> Float[np.ndarray, " 3"]:
    """Convert to a position of three finite numbers."""
    try:
        position = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        position = np.zeros(0)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise InputError(f"{source}: expected three finite numbers for {name}, found {str(value)[:60]}; correct them")
    return position
