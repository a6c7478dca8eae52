"""The joints of identity and driving, as their files have them or as they were predicted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...core.joint_tracks import JointTrack
from ...core.rig import Rig
from ...core.skinning import SkinnedMesh
from ...core.soles import Soles
from ...core.surface_points import SurfacePoints
from ..base import Pose, RestPose
from ..confidence import Confidence
from .ensemble import KeyframePrediction


@dataclass(frozen=True, eq=False)
class IdentityReading:
    """The joints of an identity: of its file, or predicted."""

    vertices: Float[np.ndarray, "W 3"]
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    rig: Rig
    group: Int[np.ndarray, " V"]
    """Index of each vertex of the mesh among `vertices`."""
    legs: tuple[tuple[int, ...], ...]
    leg: float
    confidence: Confidence | None = None
    skinned: SkinnedMesh | None = None
    """The skinned mesh of the file."""


@dataclass(frozen=True, eq=False)
class DrivingReading:
    """The joints of a driving clip: of its file, or predicted and tracked."""

    joints: tuple[str, ...]
    follow: Callable[[Float[np.ndarray, "U 3"]], Pose]
    leg: float
    samples: SurfacePoints
    soles: Soles
    confidence: Confidence | None = None
    keyframes: KeyframePrediction | None = None
    known: JointTrack | None = None
    rest: RestPose | None = None
    """The joints at rest, where the file has them."""
