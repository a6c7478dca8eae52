"""Convert motion files (BVH, AMASS-style archives) to clips of the shipped body.

Skeletons of animals play on the shipped quadruped. Their joints are found as those of a rigged mesh (`animal_rig`),
with points along the bones in place of a surface.
"""

from __future__ import annotations

import contextlib
import dataclasses
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..bodies import RiggedBody, load_body
from ..bodies.character_pool import facing_rotation
from ..bodies.hands import body_with_fingers
from ..bodies.joint_names import captured_fingers, named_joints
from ..bodies.skinned_character import SkinnedCharacter
from ..core.animated_rig import AnimatedRig
from ..core.budgets import check_clip_size
from ..core.errors import InputError
from ..core.frame_buffer import PosedFrames
from ..core.geometry import rotation_between
from ..core.mesh import Clip, Mesh
from ..core.npz_archive import archive_names
from ..core.person_motion import KnownJoints, PersonMotion
from ..core.rig import Rig, homogeneous, local_rotations
from ..core.skinning import SkinnedMesh
from .amass import is_amass, load_amass
from .animal_rig import animal_facing, animal_rig
from .bvh import Bvh, load_bvh
from .motion import Motion, cut_motion, joint_tracks, leg_length, resample
from .retarget import NEEDED, on_floor, rests_standing, retarget_skeleton, righted

BVH = ".bvh"
"""Suffix of BVH files."""


def is_motion_file(path: str | Path) -> bool:
    """Tell whether a file contains a motion of joints and no points: .bvh, or an AMASS-style archive."""
    path = Path(path)
    return path.suffix.lower() == BVH or (path.suffix.lower() == ".npz" and is_amass(archive_names(path)))


def motion_joints(path: str | Path) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Return names and parents of the joints that are read from a motion file."""
    source = _load(path)
    return source.joint_names, source.parents


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """The motion of a skeleton on the shipped body, with fingers where the skeleton has some, or on the quadruped."""

    motion: Motion
    front: str | None
    """Axis to the person's front at rest; None: the rest pose does not tell."""
    notes: tuple[str, ...] = ()

    def clip(self) -> Clip:
        """Make a clip of the body in motion; see `played`."""
        return dataclasses.replace(played(self.motion, self.front), notes=self.notes)


def on_body(source: Bvh, path: str | Path) -> BodyMotion:
    """Retarget a skeleton's motion to the shipped body, at its frame rate; errors name `path`.

    What does not stand as a person in its rest pose, and has four legs there, moves the shipped quadruped.
    """
    upright = righted(source)
    known = named_joints(source.joint_names, source.parents)
    person = all(joint in known for joint in NEEDED) and rests_standing(source.rest(), known)
    if not person and (animal := retarget_animal(source)) is not None:
        return BodyMotion(animal, "+z", source.notes)
    fingered = captured_fingers(source.joint_names, source.parents, known)
    body = body_with_fingers() if fingered else load_body()
    # The path of who stood upside down says nothing about the floor of the rest pose.
    found = retarget_skeleton(upright, body, str(path), hands=True, stands_at_rest=upright is source)
    motion = dataclasses.replace(found, name=source.name)
    if person:
        return BodyMotion(motion, "+z", upright.notes)
    note = (
        f"{source.name} does not stand in its rest pose: its frames show how its joints are turned, with hips and head "
        "level while it stands upright and feet while they are flat"
    )
    return BodyMotion(motion, None, (*source.notes, note))


def motion_of_file(path: str | Path) -> Motion:
    """Load a motion file and retarget it to the shipped body without fingers, at the file's frame rate."""
    source = righted(_load(path))
    return dataclasses.replace(retarget_skeleton(source, load_body(), str(path)), name=source.name)


def _load(path: str | Path) -> Bvh:
    return load_bvh(path) if Path(path).suffix.lower() == BVH else load_amass(path)


def motion_file_clip(path: str | Path, fps: float | None = None, frames: slice = slice(None)) -> Clip:
    """Load a motion file as a clip of the shipped body (see `played`).

    The frame rate is that of the file, or `fps`: the motion is resampled, so that frame k is at k / fps seconds.
    The chosen `frames` are those of the whole clip: the rest pose and the floor are found from all frames.
    """
    path = Path(path)
    facts = path.stat() if path.is_file() else None  # reading a missing one tells what is wrong
    whole = _whole_motion(path, facts and (facts.st_dev, facts.st_ino, facts.st_mtime_ns, facts.st_size))
    motion = cut_motion(whole.motion if fps is None else resample(whole.motion, fps, str(path)), frames)
    check_clip_size(len(motion), len(load_body().vertices), path)
    return dataclasses.replace(whole, motion=motion).clip()


@lru_cache(maxsize=1)  # a batch moves many meshes by one capture; a capture of a minute has 10 MB
def _whole_motion(path: Path, version: tuple[int, ...] | None) -> BodyMotion:
    """Retarget a motion file; once while the file does not change."""
    return on_body(_load(path), path)


def motion_file_mesh(path: str | Path) -> Mesh:
    """Load the first frame of a motion file as a mesh of the shipped body; see `motion_file_clip`."""
    return first_frame(on_body(_load(path), path))


def played(motion: Motion, front: str | None = None) -> Clip:
    """Make a clip of the shipped body (mean shape) in motion: metres, y up, floor at y = 0, with headings and joints.

    The mesh is that of the first frame. Frames are posed when they are read (`PosedFrames`).

    Args:
        front: axis to the person's front at rest, where that is known.
    """
    body = _body_of(len(motion.joint_names))
    leg = leg_length(body.joints, body.joint_names)
    tracks = joint_tracks(body, motion)
    at_rest = {"rest_vertices": body.vertices, "front": front}
    joints = PersonMotion(motion.joint_names, *tracks, leg, body.weights, **at_rest, played=True)
    skinned = SkinnedMesh.of(body.vertices, _at_rest(body), body.parents)
    vertices: Any = PosedFrames(skinned, joints.rotation, joints.positions[:, 0])
    mesh = dataclasses.replace(body.mesh(np.asarray(vertices[0], np.float64)), name=motion.name, up="+y")
    return Clip(mesh, vertices, motion.fps, joints.rotation[:, 0, :, 2], KnownJoints(joints))


def played_rig(clip: Clip) -> AnimatedRig:
    """Return the bones of a clip that `played` has made."""
    assert isinstance(clip.vertices, PosedFrames)
    rotation = np.asarray(clip.vertices.rotation, float)
    body = _body_of(rotation.shape[1])
    mesh = dataclasses.replace(clip.mesh, vertices=body.vertices)
    root = np.asarray(clip.vertices.root, float)
    return AnimatedRig(mesh, body.joint_names, body.parents, _at_rest(body), rotation, root)


def _body_of(joints: int) -> RiggedBody:
    bodies = (load_body, body_with_fingers, lambda: load_body("quadruped"))
    return next(body for body in (load() for load in bodies) if len(body.parents) == joints)


def _at_rest(body: RiggedBody) -> Rig:
    return Rig(np.tile(np.eye(3), (len(body.parents), 1, 1)), body.joints, body.weights)


def first_frame(whole: BodyMotion) -> Mesh:
    """Make a mesh of the shipped body in the first frame of a motion."""
    return dataclasses.replace(whole, motion=cut_motion(whole.motion, slice(1))).clip().mesh


UPS = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""Directions away from the ground that a rest pose is tried in, in this order."""
STEPS = 8
"""Points along each bone."""
NEAR_GROUND = 0.3
"""Height, in heights of the skeleton, up to which the end of a chain is a foot. Captured foxes have 0.2."""


def retarget_animal(source: Bvh) -> Motion | None:
    """Retarget the motion of an animal to the shipped quadruped, at its frame rate; None if none rests on four legs.

    The trunk is taken for level at rest. The root's path is scaled by the ratio of leg lengths and starts above the
    origin; the floor is estimated from the result, as in `retarget_skeleton`. Joints that the source lacks are not
    rotated.
    """
    for up in np.array(UPS):
        # A character of points along the bones at rest; each bone moves with the joint at its top. Chains that end near
        # the ground reach it: rest poses of captures may stand on two of four feet.
        rest, names = source.rest(), source.joint_names
        bones = [(parent, rest[j]) for j, parent in enumerate(source.parents) if parent >= 0]
        ends = [(j, rest[j] + source.ends.get(names[j], 0.0)) for j in range(len(rest)) if j not in source.parents]
        heights = np.array([tail for _, tail in (*bones, *ends)]) @ up
        low, reach = heights.min(), NEAR_GROUND * np.ptp(heights)
        bones += [*ends, *((j, end - (end @ up - low) * up) for j, end in ends if end @ up < low + reach)]
        bone = np.repeat([top for top, _ in bones], STEPS)
        share = np.tile(np.linspace(0, 1, STEPS), len(bones))[:, None]
        points = rest[bone] * (1 - share) + np.repeat([tail for _, tail in bones], STEPS, axis=0) * share
        mesh = Mesh(points, np.zeros((0, 3), int), name=source.name)
        one, frames = np.ones((len(points), 1)), homogeneous(np.tile(np.eye(3), (len(rest), 1, 1)), rest)
        figure = SkinnedCharacter(mesh, names, source.parents, frames, bone[:, None], one, points[:, None])
        upright = rotation_between(up, np.array(UPS[0]))
        with contextlib.suppress(InputError):
            facing = animal_facing(figure.turned(upright), source.name)
            rig, order = animal_rig(figure, facing_rotation(facing) @ upright, source.name)
            break
    else:
        return None
    body, (rotation, position) = rig.body, source.world()
    target = np.empty((len(rotation), len(body.joint_names), 3, 3))
    for j, (joint, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
        known = rig.joints.get(joint)
        target[:, j] = target[:, parent] if known is None else rig.turn @ rotation[:, order[known]] @ rig.frames[joint]
    scale = leg_length(body.joints, body.joint_names) / rig.leg
    path = on_floor(position[:, order[rig.joints["Hips"]]] @ rig.turn.T * scale, target, body)
    return Motion(source.name, body.joint_names, local_rotations(target, body.parents), path, source.fps)
