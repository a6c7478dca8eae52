"""Read the rigs of glTF files, what two files with the same skeleton share, and the joints of motion files."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterable
from typing import NamedTuple, TypeVar

from ..bodies.anatomy import body_of_joints
from ..bodies.character_limbs import SIDES, FindJoints, UnnamedJoints
from ..bodies.joint_names import ancestors, finger_joints
from ..core.errors import InputError
from ..core.mesh import Clip, Mesh
from ..core.normalization import axis_name
from ..core.person_motion import JointSource, PersonMotion
from ..io.gltf.animation import AnimatedValues
from ..io.gltf.character import NO_PERSON, NotUpright
from ..io.gltf.copied_motion import SharedMotion, copy_morphs, copy_motion, morph_tracks, named_weights
from ..io.gltf.edit import GltfSource
from ..io.gltf.own_rig import GltfJoints, OwnRig, has_rig, read_own_rig
from ..io.gltf.scene import node_parents
from ..motions.humanoid_rig import HumanoidRig
from .bone_rigs import BoneJoints

T = TypeVar("T")
UNNAMED = "joints whose names say nothing: found by the surface that they move, where it is that of a person"


def if_usable(read: Callable[[str], T], body: str, without: str) -> tuple[T | None, tuple[str, ...], bool]:
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


def person_motion(joints: JointSource, body: str) -> PersonMotion:
    """Read the joints of a clip as those of a body.

    Raises:
        InputError: they are those of another; `NotUpright` of an animal's that are read as a person's.
    """
    if isinstance(joints, GltfJoints | BoneJoints) and joints.mesh is not None:
        return dataclasses.replace(joints, body=body).person()
    found = joints.person()
    if body_of_joints(found.joints) == body:
        return found
    if body == "quadruped":
        raise InputError("expected the rig of an animal, found joints of a person")
    raise NotUpright("expected joints of a person, found those of an animal")


def copied_motion(identity: Mesh, clip: Clip, own: OwnRig | None) -> tuple[SharedMotion | None, SharedMotion | None]:
    """Find the animated values of nodes that both files have, None if their skeletons are not alike.

    Returns also those that are copied as they are: of joints of the same skeleton, or morph targets of the same file.
    """
    if not isinstance(clip.skeleton, GltfJoints) or not isinstance(identity.source, GltfSource):
        return None, None
    shared = copy_motion(identity.source, clip.skeleton)
    if shared is not None and (shared.same_rest or (shared.alike and own is None)):
        return shared, shared
    return shared, copy_morphs(identity.source, clip.skeleton)


class Stance(NamedTuple):
    """How a mesh stands."""

    axes: tuple[str, str]
    """Up and front, such as "+y", "+z"."""
    text: str
    """The same, and what the mesh is taken for."""


class RigFacts(NamedTuple):
    """What is known of the own rig of a mesh."""

    used: bool
    text: str
    stance: Stance | None = None
    """That of a person or a four-legged animal, as the rig tells."""


def rig_facts(mesh: Mesh, find: FindJoints | None = None) -> RigFacts | None:
    """Tell whether the own rig of a mesh is used, and what is known of it; None of a mesh without a rig.

    Args:
        find: finds joints of a person whose names say nothing.
    """
    if not has_rig(mesh) or not isinstance(mesh.source, GltfSource):
        return None
    at_rest = dataclasses.replace(mesh, vertices=mesh.source.vertices)
    try:
        humanoid = read_own_rig(at_rest).humanoid
    except NO_PERSON as error:
        with contextlib.suppress(InputError):
            animal = read_own_rig(at_rest, body="quadruped").humanoid
            return _facts(animal, "a four-legged animal", f"{len(animal.joints)} of a four-legged animal known")
        if not isinstance(error, UnnamedJoints):
            return RigFacts(False, str(error))
        if find is None:
            return RigFacts(True, UNNAMED)
        try:
            person = read_own_rig(at_rest, find).humanoid
            return _facts(person, "a person", known_joints(person.joints), " whose names say nothing")
        except InputError as not_found:
            return RigFacts(False, str(not_found))
    except InputError as error:
        return RigFacts(False, str(error))
    return _facts(humanoid, "a person", known_joints(humanoid.joints))


def _facts(rig: HumanoidRig, kind: str, known: str, names: str = "") -> RigFacts:
    up, front = axis_name(rig.turn[1]), axis_name(rig.turn[2])
    stance = Stance((up, front), f"up {up}, front {front}, {kind} by its rig")
    return RigFacts(True, f"{len(rig.character.parents)} joints{names}, {known}", stance)


def known_joints(names: Iterable[str]) -> str:
    """Say how many joints of a person and of fingers are known."""
    known = [*names]
    fingers = sum(name in finger_joints(side) for side in SIDES for name in known)
    return f"{len(known) - fingers} of a person and {fingers} of fingers known"


def beside_person(own: OwnRig, tracks: AnimatedValues) -> AnimatedValues:
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
