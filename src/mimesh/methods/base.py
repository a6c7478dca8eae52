"""Interfaces of methods: `Method`, and what its `prepare` takes and returns.

Methods work on normalised meshes only: y up, +z front, bounding box centred, largest distance from its centre 1.
The identity has a normalisation of its own; all frames of the driving have that of its first frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from ..core.foot_planting import PosedJoints, plant_feet
from ..core.joint_tracks import JointTrack, root_path
from ..core.mesh import Clip, Mesh
from ..core.rig import Rig
from ..core.skinning import SkinnedMesh
from ..core.soles import Feet
from ..core.surface_points import SurfacePoints
from .confidence import Confidence
from .root_motion import check_size

Drive = Callable[[Iterable[Float[np.ndarray, "U 3"]]], Iterator[Float[np.ndarray, "V 3"]]]
"""Maps driving frames to the identity's vertices, one frame at a time, so that memory does not grow with the clip."""
Pose = tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]]
"""World rotation and position of every joint."""
SurfaceMotion = Callable[[SurfacePoints], Float[np.ndarray, "T N 3"]]
"""Maps points of the driving's surface to their positions in frames of the whole clip, normalised."""


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


@runtime_checkable
class SkinnedMethod(Method, Protocol):
    """A method that moves joints. Only these support `--skinned`, `--root`, `--ground` and `--smooth`."""

    skinned: ClassVar[bool]
    """True. Methods without joints do not have this attribute."""

    def prepare(self, identity: Mesh, driving: Clip) -> SkinnedDrive:
        """As `Method.prepare`; the function that is returned also gives the motion of the joints."""
        ...


@runtime_checkable
class QuickPredictor(Protocol):
    """A method with a cheap prediction, which corrects wrongly detected axes (see `pipeline.run.reorient`)."""

    def quick_predict(self, mesh: Mesh) -> tuple[float, Float[np.ndarray, "3 3"]]:
        """Predict mean entropy (nats) of a normalised mesh's skinning weights, and world rotation of its root joint."""
        ...


@runtime_checkable
class MotionMethod(Method, Protocol):
    """A method that looks at more frames of a clip than its keyframes, at a few points of the surface."""

    def with_motion(self, motion: SurfaceMotion) -> Method:
        """Return this method with the motion of the surface of the driving that it is prepared for."""
        ...


@runtime_checkable
class CorrectableMethod(SkinnedMethod, Protocol):
    """A method with joints that takes known positions of some of them. Only these support `--joints`."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        ...

    def with_joints(
        self, identity: Mapping[str, Float[np.ndarray, " 3"]], driving: Mapping[str, Float[np.ndarray, " 3"]]
    ) -> Method:
        """Return this method with known joints of the identity, and of the driving in its last keyframe, normalised."""
        ...


@dataclass(frozen=True, eq=False)
class SkinnedDrive:
    """An identity with joints, ready to be driven: a `Drive` that also gives the motion of its joints."""

    joints: tuple[str, ...]
    """Names of the joints."""
    rig: Rig
    """Joints, and skinning weights of all V vertices, in the identity's normalisation."""
    skinned: SkinnedMesh
    """The identity's distinct positions (W <= V), skinned."""
    follow: Callable[[Float[np.ndarray, "U 3"]], Pose]
    """Maps the vertices of a driving frame to the pose of the driving's joints."""
    stride: float
    """The identity's displacement over the driving's, each in its normalisation: the ratio of leg lengths."""
    feet: Feet | None
    """Contact points of the soles; None if there are none, and then nothing is planted."""
    group: Int[np.ndarray, " V"]
    """Index of each vertex among the distinct positions."""
    name: str
    """Name of the driving, for error messages."""
    confidence: tuple[Confidence, Confidence] | None = None
    """Confidence of the predictions for the identity and for the driving; None from a method that gives none."""

    def __call__(self, frames: Iterable[Float[np.ndarray, "U 3"]]) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Yield the identity's vertices for every driving frame."""
        return (self.posed(rotation, self.stride * positions[0]) for rotation, positions in self._poses(frames))

    def limited(self, vertices: Float[np.ndarray, "V 3"], influences: int) -> SkinnedDrive:
        """Return this drive with only the largest weights of each vertex; `vertices` is the identity, normalised."""
        _, first = np.unique(self.group, return_index=True)
        rig = self.rig.limited(influences)
        distinct = replace(rig, weights=rig.weights[first])
        return replace(self, rig=rig, skinned=SkinnedMesh.of(vertices[first], distinct, self.skinned.parents))

    def track(self, frames: Iterable[Float[np.ndarray, "U 3"]], fps: float) -> JointTrack:
        """Return the motion of the driving's joints and soles over all frames."""
        poses, soles = [], []
        for vertices in check_size(frames, self.name):
            poses.append(self.follow(vertices))
            if self.feet is not None:
                soles.append(self.feet.driving_soles(vertices))
        rotation, positions = (np.stack(arrays) for arrays in zip(*poses, strict=True))
        return JointTrack(rotation, positions, fps, np.stack(soles) if soles else None)

    def motion(self, track: JointTrack, across: float | None, in_place: bool, ground: bool) -> PosedJoints:
        """Return the motion of the identity's joints.

        Args:
            track: motion of the driving's joints.
            across: scale from the driving's displacement over the ground (x and z) to the identity's, which is kept
                then; None is `stride`.
            in_place: no displacement over the ground.
            ground: correct root path and legs so that soles stand where the driving's do.
        """
        scale = (self.stride if across is None else across, self.stride)
        posed = PosedJoints(track.rotation, root_path(track, *scale, in_place))
        if not ground or self.feet is None:
            return posed
        # In place, feet slide as they should: only heights are corrected.
        return plant_feet(posed, track, self.skinned, self.feet, scale, across is None, not in_place)

    def posed(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "V 3"]:
        """Return the identity's vertices for world rotations of the joints and a position of the root joint."""
        return self.skinned.posed(rotation, root).take(self.group, axis=0)

    def _poses(self, frames: Iterable[Float[np.ndarray, "U 3"]]) -> Iterator[Pose]:
        return (self.follow(vertices) for vertices in check_size(frames, self.name))
