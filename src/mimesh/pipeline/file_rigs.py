"""Read the rigs of the files of a transfer: joints that a file has are not looked for on its surface."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from ..bodies.anatomy import body_of_joints
from ..bodies.character_limbs import SIDES, FindJoints, UnnamedJoints
from ..bodies.joint_names import ancestors, finger_joints
from ..core.errors import InputError
from ..core.mesh import Clip, Mesh
from ..core.normalization import axis_name
from ..core.person_motion import JointSource, PersonMotion
from ..io.gltf import still_joints
from ..io.gltf.animation import AnimatedValues
from ..io.gltf.character import NO_PERSON
from ..io.gltf.copied_motion import SharedMotion, copy_morphs, copy_motion, morph_tracks, named_weights
from ..io.gltf.edit import GltfSource
from ..io.gltf.own_rig import GltfJoints, OwnRig, has_rig, read_own_rig
from ..io.gltf.scene import node_parents
from ..motions.humanoid_rig import HumanoidRig
from .bone_rigs import BoneJoints
from .known import Axes, Known
from .look import OTHER, Subject

T = TypeVar("T")
UNNAMED = "joints whose names say nothing: found by the surface that they move, where it is that of a person"
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
            choice: one of `options.RIGS`, or the identity's rig itself.
            copy: of files with the same skeleton, read only what is copied.
            find: find joints of identity and driving whose names say nothing.
            body: `human` or `quadruped`; "auto": as an animal is read what is no person; "other": only copies are read.
        """
        given = choice if isinstance(choice, HumanoidRig) else None
        own = shared = None
        notes: tuple[str, ...] = ()
        unnamed = unnamed_driving = only_copied = False
        if choice == "own" and has_rig(identity) and still_joints(identity) is not None:
            without = f"the rig of {identity.name} is not used, joints are found on its surface"
            if body != OTHER:
                own, notes, unnamed = _if_usable(lambda of: read_own_rig(identity, find[0], of), body, without)
            shared = _shared_motion(identity, clip)
            copied = _copied(identity, clip, shared, own)
            if copied is not None and copy:
                return cls(own, copied=copied)
            only_copied = copied is not None and own is None
        driving, skeleton = None, clip.skeleton
        if isinstance(skeleton, GltfJoints):
            skeleton = dataclasses.replace(skeleton, find=find[1])
        if skeleton is not None and skeleton.has_joints and body != OTHER:
            without = f"the joints of {clip.mesh.name} are not used, they are found on its surface"
            joints = skeleton
            driving, more, unnamed_driving = _if_usable(lambda of: _motion(joints, of), body, without)
            notes += more
        beside = {} if shared is None or own is None else _beside_person(own, shared.tracks)
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

    def axes(self, axes: Axes) -> Axes:
        """Fill in up and front of the identity and the driving, where the rigs say them and the user does not."""
        up, front, driving_up, driving_front = axes
        if self.identity is not None and up is None and front is None:
            up, front = "+y", axis_name(self.identity.humanoid.turn[2])
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


def _if_usable(read: Callable[[str], T], body: str, without: str) -> tuple[T | None, tuple[str, ...], bool]:
    """Read the rig of a body; None where it cannot be used, with a note that tells why and what is done `without` it.

    Returns also whether all that is missing is what the names of the joints mean.
    """
    try:
        return read("human" if body == "auto" else body), (), False
    except InputError as error:
        if body == "auto" and isinstance(error, NO_PERSON):
            with contextlib.suppress(InputError):
                return read("quadruped"), (), False
        return None, (f"{without}: {error}",), isinstance(error, UnnamedJoints)


def _motion(joints: JointSource, body: str) -> PersonMotion:
    """Read the joints of a clip as those of a body; only rigged meshes may be animals."""
    if isinstance(joints, GltfJoints | BoneJoints) and joints.mesh is not None:
        return dataclasses.replace(joints, body=body).person()
    if body == "quadruped":
        raise InputError("expected the rig of an animal, found joints of a person")
    return joints.person()


def _shared_motion(identity: Mesh, clip: Clip) -> SharedMotion | None:
    """Find the animated values of nodes that both files have; None if their skeletons are not alike."""
    if not isinstance(clip.skeleton, GltfJoints) or not isinstance(identity.source, GltfSource):
        return None
    return copy_motion(identity.source, clip.skeleton)


def _copied(identity: Mesh, clip: Clip, shared: SharedMotion | None, own: OwnRig | None) -> SharedMotion | None:
    """Select the values that are copied as they are: joints of the same skeleton, or morph targets of the same file."""
    if shared is not None and (shared.same_rest or (shared.alike and own is None)):
        return shared
    if not isinstance(clip.skeleton, GltfJoints) or not isinstance(identity.source, GltfSource):
        return None
    return copy_morphs(identity.source, clip.skeleton)


class RigFacts(NamedTuple):
    """What is known of the own rig of a mesh."""

    used: bool
    text: str
    stands: str | None = None
    """Axes of a four-legged animal, which the detector for surfaces of people cannot tell."""
    person: bool = False
    """Whether its joints are those of a person."""


def rig_facts(mesh: Mesh) -> RigFacts | None:
    """Tell whether the own rig of a mesh is used, and what is known of it; None of a mesh without a rig."""
    if not has_rig(mesh) or not isinstance(mesh.source, GltfSource):
        return None
    at_rest = dataclasses.replace(mesh, vertices=mesh.source.vertices)
    try:
        humanoid = read_own_rig(at_rest).humanoid
    except NO_PERSON as error:
        with contextlib.suppress(InputError):
            animal = read_own_rig(at_rest, body="quadruped").humanoid
            stands = (
                f"up {axis_name(animal.turn[1])}, front {axis_name(animal.turn[2])}, a four-legged animal by its rig"
            )
            known = f"{len(animal.character.parents)} joints, {len(animal.joints)} of a four-legged animal known"
            return RigFacts(True, known, stands)
        return RigFacts(True, UNNAMED) if isinstance(error, UnnamedJoints) else RigFacts(False, str(error))
    except InputError as error:
        return RigFacts(False, str(error))
    fingers = sum(name in finger_joints(side) for side in SIDES for name in humanoid.joints)
    known = len(humanoid.joints) - fingers
    joints = len(humanoid.character.parents)
    text = f"{joints} joints, {known} of a person and {fingers} of fingers known by name"
    return RigFacts(True, text, person=True)


def still_clip(mesh: Mesh) -> Clip:
    """Make a clip of one frame of a mesh, with the joints of its file."""
    return dataclasses.replace(Clip.still(mesh), skeleton=still_joints(mesh))


def _beside_person(own: OwnRig, tracks: AnimatedValues) -> AnimatedValues:
    """Select the values of nodes below a person's joints that carry none of them: faces, tails, skirts, props."""
    parents, person = tuple(node_parents(own.source.document)), set(own.person.values())
    carrying = {above for node in person for above in ancestors(parents, node)}
    return {
        (node, path): values
        for (node, path), values in tracks.items()
        if node not in carrying and person.intersection(ancestors(parents, node))
    }


def face_tracks(identity: OwnRig, clip: Clip) -> AnimatedValues:
    """Return the morph weights of an identity's file that a clip's file animates by name."""
    joints = clip.skeleton
    if not isinstance(joints, GltfJoints):
        return {}
    return morph_tracks(identity.source.document, named_weights(joints.document, joints.channels, joints.times))


def heading_axis(hips: Float[np.ndarray, "3 3"]) -> str:
    """Return the horizontal axis nearest to where a person faces, from the rotation of the hips since the T-pose.

    Of a person who lies on the front or the back it is the direction from the hips to the head, or its opposite.
    """
    front, up = hips[:, 2], hips[:, 1]
    if abs(front[1]) > LYING:
        front = -np.sign(front[1]) * up
    return axis_name(front * [1, 0, 1])
