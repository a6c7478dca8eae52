"""Drives an identity without a rig by any other mesh, from marks at the ends of limbs that are found on both.

The reference, which deformation transfer needs, is the frame of the driving on which the marks are surest.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError, option
from ..core.mesh import Clip, Mesh
from ..core.normalization import ORIENTATIONS, Normalization
from ..methods.base import Method
from ..methods.deformation_transfer import DeformationTransfer
from ..methods.extremities import FoundMarks, find_ends, match_ends
from .known import Axes
from .look import normalised
from .report import ReferenceReport

FRAMES = 12
"""Most frames, evenly spread over a clip, on which marks are looked for."""
SURE = 0.7
"""Confidence below which marks are refused. Chosen by eye on meshes of a pool (docs/log/animals.md)."""


@dataclass(frozen=True, eq=False)
class MarkedFrame:
    """A frame of a driving with marks on it and on the identity."""

    frame: int
    vertices: Float[np.ndarray, "U 3"]
    """Of that frame, in the axes of the driving's file."""
    marks: FoundMarks
    up: str
    front: str
    """Of the driving."""

    def axes(self, norm: Normalization) -> tuple[str, str]:
        """Return up and front of the driving."""
        return self.up, self.front

    def method(self, driving: Mesh, identity: Normalization, norm: Normalization) -> Method:
        """Make the method, from the normalisation of the driving."""
        reference = dataclasses.replace(driving, vertices=norm.apply(self.vertices))
        return DeformationTransfer(reference, self.marks.pairs)

    def facts(self) -> ReferenceReport:
        """Return the figures for the report."""
        return {"frame": self.frame, "confidence": round(self.marks.confidence, 3), "ends": self.marks.ends}

    def note(self, names: tuple[str, str]) -> str:
        """Tell what was done with identity and driving, whose names are given."""
        return (
            f"{self.marks.ends} ends of limbs were found on {names[0]} and on frame {self.frame} of {names[1]}, which "
            f"is taken to have its pose (confidence {self.marks.confidence:.2f}); look at the picture, or give "
            f"{option('markers')} and {option('reference', ...)} with {option('model', 'deformation-transfer')}"
        )


def marked_frame(identity: Mesh, clip: Clip, axes: Axes) -> MarkedFrame:
    """Find the frame of a clip on which the ends of limbs are most like those of the identity.

    Args:
        axes: up and front of both; an unknown front of the driving is looked for.

    Raises:
        InputError: there is one frame only, or the ends do not correspond with certainty.
    """
    if len(clip) == 1:
        raise InputError(
            f"{clip.mesh.name}: expected a rig as in {identity.name}, or a clip in which one frame has about its pose, "
            f"found one pose; give {option('reference', ...)} and {option('markers', ...)} with "
            f"{option('model', 'deformation-transfer')}"
        )
    norm = Normalization.fit(identity, *axes[:2])
    mine = find_ends(normalised(identity, norm))
    first = dataclasses.replace(clip.mesh, vertices=clip.vertices[0].astype(np.float64))
    known = Normalization.fit(first, *axes[2:])
    fronts = [pair[1] for pair in ORIENTATIONS if pair[0] == known.up]
    found = None
    for t in np.unique(np.linspace(0, len(clip) - 1, FRAMES).round().astype(int)):
        mesh = dataclasses.replace(first, vertices=clip.vertices[t].astype(np.float64))
        for front in [known.front] if axes[3] is not None else fronts:
            shown = normalised(mesh, Normalization.fit(mesh, known.up, front))
            marks = match_ends(mine, find_ends(shown))
            # Limbs that bend keep their ends: among frames that are alike, the one nearest in pose is taken.
            if found is None or marks.confidence - marks.distance > found.marks.confidence - found.marks.distance:
                found = MarkedFrame(int(t), mesh.vertices, marks, known.up, front)
    assert found is not None
    if found.marks.confidence < SURE:
        raise InputError(
            f"{identity.name}, {clip.mesh.name}: expected rigs in both files, two shapes of one mesh, or limbs whose "
            f"ends correspond, found {found.marks.ends} ends that do, with a confidence of "
            f"{found.marks.confidence:.2f} (needed: {SURE}); rig both, or give {option('markers', ...)} and "
            f"{option('reference', ...)} "
            f"with {option('model', 'deformation-transfer')}"
        )
    return found
