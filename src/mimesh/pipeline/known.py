"""What is known before meshes are looked at: the caller's hints, what their files say, joints that were corrected."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from ..bodies import load_body
from ..core.arguments import described
from ..core.errors import InputError, option
from ..core.joint_corrections import JointCorrections
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization
from ..core.options import Hints, needs_joints
from ..core.person_motion import PersonMotion
from ..mime.model import Positions
from ..rigs.retarget import ScannedJoints

if TYPE_CHECKING:
    from ..motions.humanoid_rig import HumanoidRig

HIDDEN = {
    "human": ("LHipJoint", "RHipJoint", "LThumb", "RThumb", "LeftFingerBase", "RightFingerBase", "LeftHandFinger1",
              "RightHandFinger1"),
    "quadruped": ("Spine2", "Spine4", "Tail2", "Tail4", "Tail5"),
}  # fmt: skip
"""Joints of each shipped body without a handle: in the hips, in a hand, which they follow, or between others that move
them.
"""
GivenJoints = JointCorrections | Mapping[str, Any] | str | Path | None
"""Corrections as the public functions take them: joint -> position, or the path of a file of them."""


@dataclass(frozen=True, eq=False)
class Corrections:
    """Corrected joints of both inputs of a transfer; none by default."""

    identity: JointCorrections | None = None
    driving: JointCorrections | None = None
    driving_frame: Float[np.ndarray, "U 3"] | None = None
    """Vertices of the driving in the frame that its corrections are in."""

    @property
    def given(self) -> bool:
        """Whether joints of the identity or of the driving are corrected."""
        return self.identity is not None or self.driving is not None

    @property
    def body(self) -> str | None:
        """Name of the shipped body that alone has a joint of a corrected name; None where all bodies have them."""
        if not self.given:
            return None
        corrected = (self.identity, self.driving)
        names = {name for corrections in corrected if corrections is not None for name in corrections.positions}
        of_bodies = {body: set(load_body(body).joint_names) for body in HIDDEN}
        owners = [[body for body, own in of_bodies.items() if name in own] for name in names]
        unique = sorted({bodies[0] for bodies in owners if len(bodies) == 1})
        return unique[0] if len(unique) == 1 else None

    @classmethod
    def read(cls, identity: GivenJoints, driving: GivenJoints, clip: Clip) -> Corrections:
        """Read corrections; `clip` is the whole driving clip, before frames of it are chosen.

        Raises:
            InputError: a file that cannot be read, or a frame that the clip does not have.
        """
        read = _read(identity, option("joints")), _read(driving, option("driving_joints"))
        if read[1] is None:
            return cls(read[0])
        if read[1].frame >= len(clip):
            raise InputError(
                f"{read[1].source}: expected a frame of {clip.mesh.name}, which has {len(clip)} counted from 0, "
                f"found {read[1].frame}; correct the joints in another frame"
            )
        return cls(*read, np.asarray(clip.vertices[read[1].frame], np.float64))

    def of_part(self, driving: Int[np.ndarray, " U"] | None) -> Corrections:
        """Return the corrections of parts of both meshes, whose files have more vertices than these.

        Args:
            driving: vertices of the driving that are those of its part; None: all.
        """
        mine, theirs = (c and dataclasses.replace(c, vertices=None) for c in (self.identity, self.driving))
        frame = self.driving_frame
        return Corrections(mine, theirs, frame if driving is None or frame is None else frame[driving])

    def of_identity(self, identity: Mesh, joints: tuple[str, ...], norm: Normalization) -> Positions:
        """Return the identity's corrected joints, normalised.

        Raises:
            InputError: a joint that a model does not have, or that is not near the mesh.
        """
        return _normalised(self.identity, identity.vertices, joints, identity.name, norm)

    def of_driving(self, keyframes: Clip, joints: tuple[str, ...], norm: Normalization) -> tuple[Positions, Clip]:
        """Return the driving's corrected joints, normalised, and its keyframes with their frame at the end."""
        if self.driving_frame is None:
            return {}, keyframes
        positions = _normalised(self.driving, self.driving_frame, joints, keyframes.mesh.name, norm)
        last = norm.apply(self.driving_frame)[None]
        if len(keyframes) == 1 and np.array_equal(keyframes.vertices[0], last[0]):  # a pose gets no second keyframe
            return positions, dataclasses.replace(keyframes, vertices=last)
        return positions, dataclasses.replace(keyframes, vertices=np.concatenate([keyframes.vertices, last]))

    def refuse_without_joints(self, model: str) -> None:
        """Raise InputError if joints are corrected of a model that has none."""
        if self.given:
            raise needs_joints("driving_joints" if self.identity is None else "joints", model)


def _normalised(
    corrections: JointCorrections | None,
    vertices: Float[np.ndarray, "V 3"],
    joints: tuple[str, ...],
    name: str,
    norm: Normalization,
) -> Positions:
    if corrections is None:
        return {}
    corrections.check(vertices, joints, name)
    return {joint: norm.apply(position[None])[0] for joint, position in corrections.positions.items()}


NO_CORRECTIONS = Corrections()
"""All joints are found by the model."""


def shown_bones(name: str = "human") -> dict[str, str | None]:
    """Return the joints of a shipped body that have a handle, and the nearest of them above each; None for the root."""
    body, hidden, bones = load_body(name), HIDDEN[name], {}
    for joint, parent in zip(body.joint_names, body.parents, strict=True):
        above = parent
        while above >= 0 and body.joint_names[above] in hidden:
            above = body.parents[above]
        if joint not in hidden:
            bones[joint] = None if above < 0 else body.joint_names[above]
    return bones


def correctable_joints() -> tuple[str, ...]:
    """List the joints of all shipped bodies."""
    return tuple(dict.fromkeys(name for body in HIDDEN for name in load_body(body).joint_names))


def _read(given: GivenJoints, source: str) -> JointCorrections | None:
    """Read corrections; an empty set of them is none."""
    if isinstance(given, (str, Path)):
        from ..io.joint_file import load_corrections

        given = load_corrections(given)
    elif given is not None and not isinstance(given, JointCorrections):
        if not isinstance(given, Mapping):
            raise InputError(
                f"{source}: expected a dictionary of joint -> (x, y, z), or the path of a file, found "
                f"{described(given)}; the keys of Result.joints are the names"
            )
        given = JointCorrections.of(given, source)
    return given if given is not None and given.positions else None


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
