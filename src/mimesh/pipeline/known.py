"""What is known of an identity and a clip before they are looked at: the caller's hints, and what their files say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..core.mesh import Clip
from ..core.options import Hints
from ..core.person_motion import PersonMotion
from ..rigs.retarget import ScannedJoints
from .corrections import NO_CORRECTIONS, Corrections

if TYPE_CHECKING:
    from ..motions.humanoid_rig import HumanoidRig

Axes = tuple[str | None, str | None, str | None, str | None]
"""Up and front of the identity, up and front of the driving; None is detected."""
NO_AXES: Axes = (None, None, None, None)


@dataclass(frozen=True, eq=False)
class Known:
    """Axes, rig, body and corrected joints of both meshes; see `Hints`."""

    axes: Axes = NO_AXES
    rig: str | HumanoidRig = "own"
    """Only models with joints use it."""
    body: str = "auto"
    corrections: Corrections = NO_CORRECTIONS
    parts: tuple[str | None, str | None] = (None, None)
    """Names of the parts of identity and driving that are meant; None: see `parts.find_part`."""

    @classmethod
    def of(cls, hints: Hints, clip: Clip, whole: Clip | None = None) -> Known:
        """Return what is known of an identity and a clip.

        Args:
            whole: the clip before frames of it were chosen, where that is another one; corrections are in its frames.

        Raises:
            InputError: a file of joints that cannot be read, or a frame that the clip does not have.
        """
        corrections = Corrections.read(hints.joints, hints.driving_joints, clip if whole is None else whole)
        # Those of scans were taken into account when their joints were found.
        axes = (*hints.axes[:2], None, None) if isinstance(clip.skeleton, ScannedJoints) else hints.axes
        return cls(axes, hints.rig, hints.body, corrections, (hints.part, hints.driving_part))

    def with_heading(self, clip: Clip, driving: PersonMotion | None = None) -> Known:
        """Fill in the driving's axes by where it faces in the first frame of the clip, if its joints tell that.

        Args:
            driving: joints that are followed; where their rest pose tells the front, the heading stays in the motion.
        """
        if driving is not None and driving.front is not None:
            return self
        return replace(self, axes=(*self.axes[:2], *driving_axes(clip, *self.axes[2:])))

    @property
    def asked_body(self) -> str:
        """The body that the user says, or that alone has a joint of a corrected name; else "auto"."""
        return (self.corrections.body or self.body) if self.body == "auto" else self.body


def driving_axes(clip: Clip, up: str | None, front: str | None) -> tuple[str | None, str | None]:
    """Return up and front of the driving's first frame: those given, else by its joints, else None (to be detected)."""
    if up is not None or front is not None or clip.headings is None:
        return up, front
    x, y, z = clip.headings[0]
    if abs(y) > max(abs(x), abs(z)):  # lying or bowing: the front of the hips points up or down
        return "+y", None
    return "+y", ("+" if max(x, z, key=abs) > 0 else "-") + ("x" if abs(x) > abs(z) else "z")
