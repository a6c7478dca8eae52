"""`mimesh.retarget`: let a mesh that has been rigged move as a clip that has been captured."""

from __future__ import annotations

import dataclasses
import math
from functools import partial

import numpy as np

from ..bodies.joint_names import SIDES, finger_joints
from ..core.arguments import described, public
from ..core.errors import InputError, RefusedMeshError
from ..core.frame_buffer import Progress
from ..core.mesh import Mesh
from ..core.options import MotionOptions
from ..mime.model import CapturedMotion
from ..rigs.retarget import Retarget
from .capturing import CapturedClip
from .joint_route import FoundCharacter, FoundMotion, JointRoute
from .look import KINDS, normalised
from .parts import PartRoute
from .placed import surface_motion, with_up
from .result import ClipResult, Timer
from .rigging import RiggedMesh

UNCHANGED = MotionOptions()


@public
def retarget(
    captured: CapturedClip, rigged: RiggedMesh, *, motion: MotionOptions = UNCHANGED, progress: Progress | None = None
) -> ClipResult:
    """Let a rigged mesh follow a captured motion: `animate` with both meshes looked at before.

    One capture moves many meshes, and one rig follows many captures, without finding joints again. What both files
    have by other names than those of a person or an animal is not copied, as `animate` does it.

    Args:
        captured: the motion, of `mimesh.capture`.
        rigged: the mesh with its joints, of `mimesh.rig`.
        motion: how joints move.
        progress: is called with the frames done and the frames in all.

    Returns:
        The mesh in every frame, in its own axes, unit and order, with a report and notes.

    Raises:
        RefusedMeshError: the joints of the one are a person's, those of the other a four-legged animal's.
        InputError: an option cannot be used.

    Example:
        >>> captured, rigged = mimesh.capture("walk.npz"), mimesh.rig("hero.obj")
        >>> saved = mimesh.retarget(captured, rigged).save_skinned("hero-walk.glb")
    """
    theirs, mine = getattr(captured, "found", None), getattr(rigged, "found", None)
    if not isinstance(theirs, FoundMotion) or not isinstance(mine, FoundCharacter):
        raise InputError(
            "retarget: expected what mimesh.capture gives, then what mimesh.rig gives, found "
            f"{described(captured)} and {described(rigged)}; give mimesh.capture(clip), mimesh.rig(mesh)"
        )
    if rigged.body != captured.body:
        raise RefusedMeshError(
            f"{captured.name}, {rigged.mesh.name}: expected two people or two four-legged animals, found "
            f"{KINDS[captured.body]} and {KINDS[rigged.body]}; give another of the two"
        )
    mesh = rigged.mesh if mine.part is None else mine.part.mesh
    follow = _follow(mine, theirs, mesh)
    norms, rigs = (mine.norm, theirs.norm), dataclasses.replace(mine.rigs, driving=theirs.rigs.driving)
    rest = normalised(mesh, mine.norm)
    identity = with_up(mesh, mine.norm)
    route = JointRoute(identity, theirs.clip, norms, rest, rigs=rigs, mime=theirs.network, retarget=follow)
    motion = dataclasses.replace(motion, smooth=math.hypot(motion.smooth, theirs.smooth))  # two Gaussian filters
    timer = Timer()
    way = route if mine.part is None else PartRoute(route, mine.part, None)
    moved = way.play(timer, motion, progress, np.float32)
    for which, report in (("identity", rigged.report), ("driving", captured.report)):
        moved.report[which]["up_from"] = report["up_from"]
    notes = captured.notes + moved.notes
    return moved.clip_result(way.identity, theirs.clip, theirs.network.name, timer, notes)


def _follow(mine: FoundCharacter, theirs: FoundMotion, mesh: Mesh) -> Retarget:
    """Let the character follow the motion, with the fingers of hands on which the driving's move."""
    known = dataclasses.replace(theirs.motion, track=theirs.track)
    if mine.rigs.humanoid is not None or not isinstance(theirs.motion, CapturedMotion):
        fingers = any(finger_joints(side)[0] in known.joints for side in SIDES)
        return Retarget.of(mine.character if fingers else mine.plain, known)
    surface = partial(surface_motion, theirs.clip, theirs.norm)
    fingered, motion = theirs.network.with_fingers(mine.plain, normalised(mesh, mine.norm), theirs.motion, surface)
    return Retarget.of(fingered, known if fingered is mine.plain else motion)
