"""Read the rigs of the files of a transfer: joints that a file has are not looked for on its surface."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..bodies.anatomy import body_of_joints
from ..bodies.character_limbs import FindJoints
from ..core.errors import option
from ..core.mesh import Clip, Mesh
from ..core.normalization import axis_name, turn
from ..core.person_motion import PersonMotion
from ..io.formats import may_have_joints
from .known import Axes, Known
from .look import OTHER, Subject

if TYPE_CHECKING:
    from ..io.gltf.animation import AnimatedValues
    from ..io.gltf.copied_motion import SharedMotion
    from ..io.gltf.own_rig import OwnRig
    from ..motions.humanoid_rig import HumanoidRig

LEVEL = 0.5
"""Least horizontal part of the front of hips that has a heading."""
LYING = 0.9
"""Sine of the angle (64 degrees) by which the front of the hips points up or down when a person lies."""


@dataclass(frozen=True, eq=False)
class Rigs:
    """The rigs that the files of a transfer have and that are used."""

    identity: OwnRig | None = None
    driving: PersonMotion | None = None
    copied: SharedMotion | None = None
    """The driving's animation, where both files have the same skeleton; then nothing else is needed."""
    notes: tuple[str, ...] = ()
    """Rigs that are not used, and why."""
    beside: AnimatedValues = field(default_factory=dict)
    """Values of nodes beside those of a person, such as tails and skirts, that both files have by name."""
    unnamed: tuple[bool, bool] = (False, False)
    """Whether identity and driving have joints whose names say nothing."""
    only_copied: bool = False
    """Whether the identity's rig is no person's, and could only be given the driving's values as they are."""
    given: HumanoidRig | None = None
    """The identity's rig, where a program has passed one; then `identity` is None."""

    @classmethod
    def read(
        cls,
        identity: Mesh,
        clip: Clip,
        choice: str | HumanoidRig = "own",
        copy: bool = True,
        find: tuple[FindJoints | None, FindJoints | None] = (None, None),
        body: str = "auto",
    ) -> Rigs:
        """Read the rigs of both files, where these have any; the identity's only if the choice is "own".

        Args:
            choice: one of the values of `Hints.rig`, or the identity's rig itself.
            copy: of files with the same skeleton, read only what is copied.
            find: find joints of identity and driving whose names say nothing.
            body: `human` or `quadruped`; "auto": as an animal is read what is no person; "other": only copies are read.
        """
        given = None if isinstance(choice, str) else choice
        if clip.skeleton is None and not may_have_joints(identity):
            return cls(given=given)
        from ..io.gltf import still_joints
        from ..io.gltf.own_rig import GltfJoints, has_rig, read_own_rig
        from ..motions.bvh import scales_notes
        from .gltf_rigs import beside_person, copied_motion, if_usable, person_motion

        own = shared = None
        notes: tuple[str, ...] = ()
        unnamed = unnamed_driving = only_copied = False
        if choice == "own" and has_rig(identity) and still_joints(identity) is not None:
            without = f"the rig of {identity.name} is not used, joints are found on its surface"
            if body != OTHER:
                own, notes, unnamed = if_usable(lambda of: read_own_rig(identity, find[0], of), body, without)
            notes += () if own is None else own.notes
            shared, copied = copied_motion(identity, clip, own)
            if copied is not None and copy:
                return cls(own, copied=copied)
            only_copied = copied is not None and own is None
        driving, skeleton = None, clip.skeleton
        if isinstance(skeleton, GltfJoints):
            skeleton = dataclasses.replace(skeleton, find=find[1])
        if skeleton is not None and skeleton.has_joints and body != OTHER:
            without = f"the joints of {clip.mesh.name} are not used, they are found on its surface"
            joints = skeleton
            driving, more, unnamed_driving = if_usable(lambda of: person_motion(joints, of), body, without)
            notes += more
            if driving is not None and isinstance(joints, GltfJoints):
                notes += scales_notes(clip.mesh.name, joints.scaled())
        beside = {} if shared is None or own is None else beside_person(own, shared.tracks)
        return cls(own, driving, None, notes, beside, (unnamed, unnamed_driving), only_copied, given)

    @property
    def bodies(self) -> tuple[str | None, str | None]:
        """Whose joints the rigs of identity and driving are; None where no rig is used."""
        own = self.humanoid
        theirs = self.driving and body_of_joints(self.driving.joints)
        return own and own.body_name, theirs

    @property
    def humanoid(self) -> HumanoidRig | None:
        """The identity's rig; None: its joints are found on its surface."""
        return self.given if self.identity is None else self.identity.humanoid

    @property
    def heading(self) -> float:
        """Angle (radians about y) from where the driving faces at rest to where the identity does, between the axes."""
        mine, theirs = (0.0 if of is None else of.heading for of in (self.humanoid, self.driving))
        return mine - theirs

    def axes(self, axes: Axes) -> Axes:
        """Fill in up and front of the identity and the driving, where the rigs say them and the user does not."""
        up, front, driving_up, driving_front = axes
        if self.identity is not None and up is None and front is None:
            turn = self.identity.humanoid.turn
            up, front = axis_name(turn[1]), axis_name(turn[2])
        if self.given is not None:  # its axes are part of it
            up, front = axis_name(self.given.turn[1]), axis_name(self.given.turn[2])
        if self.driving is not None and driving_up in (None, self.driving.up) and driving_front is None:
            driving_up = self.driving.up
            driving_front = self.driving.front or heading_axis(self.driving.rotation[0, 0])
        return up, front, driving_up, driving_front

    def subjects(self, identity: Mesh, first: Mesh, axes: Axes) -> tuple[Subject, Subject]:
        """Return what is known of both meshes; `first` is the driving's first frame."""
        axes, bodies = self.axes(axes), self.bodies
        return Subject(identity, axes[:2], bodies[0]), Subject(first, axes[2:], bodies[1])

    def with_notes(self, names: tuple[str, str], before: Rigs) -> Rigs:
        """Add a note for each rig whose joints were found, but not by their names; `names` are those of the meshes."""
        found = self.identity is not None, self.driving is not None
        notes = tuple(
            f"the joints of {name} have names that say nothing: they were found by the surface that they move"
            for name, unnamed, rig in zip(names, before.unnamed, found, strict=True)
            if unnamed and rig
        )
        return dataclasses.replace(self, notes=self.notes + notes)


NO_RIGS = Rigs()
"""All joints are found on the surfaces."""


def read_rigs(
    identity: Mesh,
    clip: Clip,
    known: Known,
    copy: bool = False,
    find: tuple[FindJoints | None, FindJoints | None] = (None, None),
) -> Rigs:
    """Read the rigs of both files (see `Rigs.read`); that of a mesh whose joints the user has corrected is not used."""
    corrections = known.corrections
    choice = known.rig if corrections.identity is None else "mimesh"
    rigs = Rigs.read(identity, clip, choice, copy and corrections.driving is None, find, known.body)
    return rigs if corrections.driving is None else dataclasses.replace(rigs, driving=None)


def still_clip(mesh: Mesh) -> Clip:
    """Make a clip of one frame of a mesh, with the joints of its file."""
    if not may_have_joints(mesh):
        return Clip.still(mesh)
    from ..io.gltf import still_joints

    return dataclasses.replace(Clip.still(mesh), skeleton=still_joints(mesh))


def heading_note(driving: PersonMotion | None, name: str, front: str) -> tuple[str, ...]:
    """Return a note where a driving does not begin facing the front of its rest pose, which is taken as `front`."""
    if driving is None or front != driving.front:
        return ()
    ahead = turn(-driving.heading) @ (driving.rotation[0, 0, :, 2] * [1, 0, 1])
    if np.hypot(*ahead[[0, 2]]) < LEVEL or axis_name(ahead) == front:
        return ()
    given = option("driving_front", axis_name(ahead))
    return (
        f"{name} faces {axis_name(ahead)} in its first frame and {front} in its rest pose: the result is turned as far "
        f"from the front of its own; {given} has it begin facing that",
    )


def heading_axis(hips: Float[np.ndarray, "3 3"]) -> str:
    """Return the horizontal axis nearest to where a person faces, from the rotation of the hips since the T-pose.

    Of a person who lies on the front or the back it is the direction from the hips to the head, or its opposite.
    """
    front, up = hips[:, 2], hips[:, 1]
    if abs(front[1]) > LYING:
        front = -np.sign(front[1]) * up
    return axis_name(front * [1, 0, 1])
