"""Convert motion files (BVH, AMASS-style archives) to clips of the shipped body."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..bodies import load_body
from ..core.budgets import check_clip_size
from ..core.frame_buffer import PosedFrames
from ..core.mesh import Clip, Mesh
from ..core.npz_archive import archive_names
from ..core.person_motion import KnownJoints, PersonMotion
from ..core.rig import Rig
from ..core.skinning import SkinnedMesh
from .amass import is_amass, load_amass
from .bvh import Bvh, bvh_joints, load_bvh
from .motion import Motion, cut_motion, joint_tracks, leg_length, resample
from .retarget import retarget

BVH = ".bvh"
"""Suffix of BVH files."""


def is_motion_file(path: str | Path) -> bool:
    """Tell whether a file contains a motion of joints and no points: .bvh, or an AMASS-style archive."""
    path = Path(path)
    return path.suffix.lower() == BVH or (path.suffix.lower() == ".npz" and is_amass(archive_names(path)))


def motion_joints(path: str | Path) -> int:
    """Count the joints that are read from a motion file."""
    return bvh_joints(path) if Path(path).suffix.lower() == BVH else len(load_amass(path).joint_names)


def on_body(source: Bvh, path: str | Path) -> Motion:
    """Retarget a skeleton's motion to the shipped body, at its frame rate (see `retarget`); errors name `path`.

    Raises:
        InputError: the hips and limbs are not found by name.
    """
    return dataclasses.replace(retarget(source, load_body(), str(path), stands_at_rest=True), name=source.name)


def motion_of_file(path: str | Path) -> Motion:
    """Load a motion file and retarget it to the shipped body, at the file's frame rate; see `retarget`.

    Raises:
        InputError: a damaged file, or a skeleton in which the hips and limbs are not found by name.
    """
    return on_body(_load(path), path)


def _load(path: str | Path) -> Bvh:
    """Load the skeleton and motion of a motion file."""
    return load_bvh(path) if Path(path).suffix.lower() == BVH else load_amass(path)


def motion_file_clip(path: str | Path, fps: float | None = None, frames: slice = slice(None)) -> Clip:
    """Load a motion file as a clip of the shipped body (see `played`).

    The frame rate is that of the file, or `fps`: the motion is resampled, so that frame k is at k / fps seconds.
    The chosen `frames` are those of the whole clip: the rest pose and the floor are found from all frames.

    Raises:
        InputError: as `motion_of_file`, a frame rate that is not positive, or no frame is left.
    """
    path = Path(path)
    facts = path.stat() if path.is_file() else None  # reading a missing one tells what is wrong
    motion, notes = _whole_motion(path, facts and (facts.st_dev, facts.st_ino, facts.st_mtime_ns, facts.st_size))
    motion = cut_motion(motion if fps is None else resample(motion, fps, str(path)), frames)
    check_clip_size(len(motion), len(load_body().vertices), path)
    return dataclasses.replace(played(motion), notes=notes)


@lru_cache(maxsize=1)  # a batch moves many meshes by one capture; a capture of a minute has 10 MB
def _whole_motion(path: Path, version: tuple[int, ...] | None) -> tuple[Motion, tuple[str, ...]]:
    """Retarget a motion file, and return its notes; once while the file does not change."""
    source = _load(path)
    return on_body(source, path), source.notes


def motion_file_mesh(path: str | Path) -> Mesh:
    """Load the first frame of a motion file as a mesh of the shipped body; see `motion_file_clip`."""
    return first_frame(motion_of_file(path))


def played(motion: Motion) -> Clip:
    """Make a clip of the shipped body (mean shape) in motion: metres, y up, floor at y = 0, with headings and joints.

    The mesh is that of the first frame. Frames are posed when they are read (`PosedFrames`).
    """
    body = load_body()
    leg = leg_length(body.joints, body.joint_names)
    joints = PersonMotion(motion.joint_names, *joint_tracks(body, motion), leg, body.weights, body.vertices)
    rest = Rig(np.tile(np.eye(3), (len(body.parents), 1, 1)), body.joints, body.weights)
    skinned = SkinnedMesh.of(body.vertices, rest, body.parents)
    vertices: Any = PosedFrames(skinned, joints.rotation, joints.positions[:, 0])
    mesh = dataclasses.replace(body.mesh(np.asarray(vertices[0], np.float64)), name=motion.name, up="+y")
    return Clip(mesh, vertices, motion.fps, joints.rotation[:, 0, :, 2], KnownJoints(joints))


def first_frame(motion: Motion) -> Mesh:
    """Make a mesh of the shipped body in the first frame of a motion."""
    first = dataclasses.replace(motion, rotmat=motion.rotmat[:1], root=motion.root[:1])
    return played(first).mesh
