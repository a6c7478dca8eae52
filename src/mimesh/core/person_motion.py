"""PersonMotion: the joints of a person over time, where a file has them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class PersonMotion:
    """Joints of a person in T frames of a clip, in the clip's axes and unit."""

    joints: tuple[str, ...]
    """Names: joints of the shipped body and of fingers, the hips first. Joints that the file lacks are left out."""
    rotation: Float[np.ndarray, "T J 3 3"]
    """World rotation of each joint since the T-pose of the shipped body (y up, +z front)."""
    positions: Float[np.ndarray, "T J 3"]
    leg: float
    """Length of a leg, from hip to ankle."""
    weights: Float[np.ndarray, "V J"] | None = None
    """Weight of each joint on the vertices of the clip; None: not known."""
    rest_vertices: Float[np.ndarray, "V 3"] | None = None
    """These vertices at rest: their soles stand on the floor of the clip; None: not known."""
    front: str | None = None
    """Axis to the person's front at rest, such as "+z"; None: not known."""
    up: str = "+y"
    """Axis away from the ground."""
    rest: tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]] | None = None
    """Rotations since the T-pose and positions at rest; None: not known."""
    upright: Float[np.ndarray, "3 3"] | None = None
    """Rotation that turns the person at rest to y up, +z front; None: not known."""
    heading: float = 0.0
    """Angle of the front at rest from `front` (radians about `up`), where that is between the axes."""
    played: bool = False
    """Whether the file has joints alone, which the shipped body plays."""

    def cut(self, frames: slice) -> PersonMotion:
        """Select frames."""
        return replace(self, rotation=self.rotation[frames], positions=self.positions[frames])


@runtime_checkable
class JointSource(Protocol):
    """The joints of the file that a clip was read from (see `Clip.skeleton`), read when they are needed."""

    @property
    def has_joints(self) -> bool:
        """Whether there are any."""
        ...

    def cut(self, frames: slice) -> JointSource:
        """Select frames of the clip."""
        ...

    def person(self) -> PersonMotion:
        """Read the joints."""
        ...


@dataclass(frozen=True, eq=False)
class KnownJoints:
    """Joints that have been read already."""

    motion: PersonMotion

    @property
    def has_joints(self) -> bool:
        """Whether there are any: yes."""
        return True

    def cut(self, frames: slice) -> KnownJoints:
        """Select frames of the clip."""
        return replace(self, motion=self.motion.cut(frames))

    def person(self) -> PersonMotion:
        """Return the joints."""
        return self.motion
