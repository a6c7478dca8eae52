"""The protocols of methods: what `prepare` gets and what it returns.

A method gets normalised meshes only: the identity in its own normalisation, the driving frames in the clip's (y up, +z
front, bounding box of the first frame centred, largest distance from there 1).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from ..core.joint_tracks import FootJoints, JointTrack, grounded_path, root_path
from ..core.mesh import Clip, Mesh
from ..core.rig import Rig
from ..core.skinning import SkinnedMesh
from .confidence import Confidence
from .root_motion import check_size

Drive = Callable[[Iterable[Float[np.ndarray, "U 3"]]], Iterator[Float[np.ndarray, "V 3"]]]
"""Takes the driving frames one at a time and gives the identity's vertices for each, in constant memory."""
Pose = tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]]
"""World rotation and position of every joint."""


@runtime_checkable
class Method(Protocol):
    """A way to move an identity."""

    rough: ClassVar[bool]
    """Whether its results are refined unless the user says otherwise (see `pipeline.refine`)."""

    @property
    def name(self) -> str: ...

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """All work that is done once; it may depend on the identity and on keyframes of the driving.

        These are a few frames, evenly spread. The first of them is the clip's first frame, in which `driving.mesh`
        is.
        """
        ...


@runtime_checkable
class SkinnedMethod(Method, Protocol):
    """A method that moves joints: `--skinned`, `--root`, `--ground` and `--smooth` are for these."""

    skinned: ClassVar[bool]
    """True; methods without joints lack the attribute."""

    def prepare(self, identity: Mesh, driving: Clip) -> SkinnedDrive: ...


@runtime_checkable
class QuickPredictor(Protocol):
    """A method that can say at little cost how well it recognises a mesh: it then decides which way the mesh faces."""

    def quick_predict(self, mesh: Mesh) -> tuple[float, Float[np.ndarray, "3 3"]]:
        """Mean entropy (nats) of a normalised mesh's skinning weights, and the world rotation of its root joint."""
        ...


@dataclass(frozen=True, eq=False)
class SkinnedDrive:
    """An identity with joints, ready to be driven: a `Drive` that also gives the motion of its joints."""

    joints: tuple[str, ...]
    """Their names."""
    rig: Rig
    """Of all vertices, in the identity's normalisation."""
    skinned: SkinnedMesh
    """Of the identity's distinct positions."""
    follow: Callable[[Float[np.ndarray, "U 3"]], Pose]
    """From the vertices of a driving frame to the pose of its joints."""
    stride: float
    """The identity's displacement over the driving's, in the normalisation of each: the ratio of leg lengths."""
    feet: FootJoints
    group: Int[np.ndarray, " V"]
    """Index of each vertex among the distinct positions."""
    name: str
    """Of the driving, for errors."""
    confidence: tuple[Confidence, Confidence]
    """In the identity and in the driving."""

    def __call__(self, frames: Iterable[Float[np.ndarray, "U 3"]]) -> Iterator[Float[np.ndarray, "V 3"]]:
        return (self.posed(rotation, self.stride * places[0]) for rotation, places in self._poses(frames))

    def track(self, frames: Iterable[Float[np.ndarray, "U 3"]], fps: float) -> JointTrack:
        """Motion of the driving's joints in all frames."""
        rotation, positions = (np.stack(arrays) for arrays in zip(*self._poses(frames), strict=True))
        return JointTrack(rotation, positions, fps)

    def path(self, track: JointTrack, across: float | None, in_place: bool, ground: bool) -> Float[np.ndarray, "T 3"]:
        """Positions of the identity's root joint.

        Args:
            across: displacement over the ground, in multiples of the driving's; None scales it by leg length.
            in_place: no displacement over the ground.
            ground: correct the path so that planted feet stand still on the ground.
        """
        path = root_path(track, self.stride if across is None else across, self.stride, in_place)
        if not ground:
            return path
        corrected = grounded_path(track, path, self.skinned, self.feet, self.stride)
        return np.where([in_place, False, in_place], path, corrected)

    def posed(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "V 3"]:
        """All vertices of the identity where its joints have these world rotations and the root joint is at `root`."""
        return self.skinned.posed(rotation, root)[self.group]

    def _poses(self, frames: Iterable[Float[np.ndarray, "U 3"]]) -> Iterator[Pose]:
        return (self.follow(vertices) for vertices in check_size(frames, self.name))
