"""`mimesh.capture`: read the motion of joints out of a clip of surfaces: scans, caches, another character's animation.

`mimesh.retarget` lets a mesh that has been rigged move as a clip that has been captured.

Joints that the file has are taken as they are; otherwise `mime` finds them on the surface of a few frames, and follows
them through all others.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from ..bodies.hands import straight_hands
from ..bodies.joint_names import SIDES, finger_joints, parents_first
from ..core.arguments import described, public
from ..core.errors import InputError, RefusedMeshError, option
from ..core.foot_planting import FEWEST_FRAMES, find_contacts
from ..core.frame_buffer import Progress
from ..core.geometry import turned
from ..core.joint_tracks import JointTrack
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization, turn
from ..core.options import FrameRange, Hints, MotionOptions
from ..core.rig import local_rotations
from ..core.soles import SolePoints
from ..io import joints_file, save_joint_motion, save_vrma
from ..io.gltf.edit import GltfSource
from ..io.gltf.skinned import write_gltf_joints
from ..methods.find import find_mime
from ..mime.model import CapturedMotion, Mime
from ..motions.bone_motion import BoneMotion
from ..motions.retarget import NEEDED
from ..rigs.character import names_above
from ..rigs.retarget import JointMotion, Retarget, body_parents
from .joint_route import FoundCharacter, FoundMotion, JointRoute, find_motion, found_alone, rigs_alone
from .known import Known
from .look import KINDS, Look, normalised
from .parts import PartRoute, find_part
from .placed import check_identity, first_frame, surface_motion, with_up
from .read import far_frames_note, read_frames
from .report import CaptureReport, facing, facing_note
from .result import ClipResult, Timer
from .rigging import RiggedMesh
from .vrm import check_joints, since_t_pose

JOINT_FILES = (".bvh", ".fbx", ".glb", ".gltf", ".vrma")
"""Suffixes of files of joints alone."""


NO_HINTS, ALL_FRAMES = Hints(), FrameRange()


@dataclass(frozen=True, eq=False)
class CapturedClip:
    """The joints of a clip in motion; made by `mimesh.capture`.

    Example:
        >>> captured.names[0], captured.rotation.shape  # (T, J, 3, 3)
        ('Hips', (5, 31, 3, 3))
    """

    name: str
    """Name of the clip."""
    names: tuple[str, ...]
    """Names of the J joints, the hips first; parents come before their children."""
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for the hips."""
    rest: Float[np.ndarray, "J 3"]
    """Positions of the joints in a T-pose above a floor at y = 0: y up, +z front, in the unit of the clip."""
    rotation: Float[np.ndarray, "T J 3 3"]
    """World rotation of each joint since that pose."""
    root: Float[np.ndarray, "T 3"]
    """Position of the hips in the unit of the clip: y up, and the clip's axes else."""
    fps: float
    """Frames a second."""
    body: str
    """Shipped body whose joints they are: "human" or "quadruped"."""
    report: CaptureReport
    """Axes and unit of the clip, when feet are on the ground, and how certainly joints were found: its "confidence" is
    from 0 to 1; absent where they are those of the file."""
    seconds: Timer = field(repr=False)
    """Wall time in seconds of the steps: load, prepare, drive, write."""
    notes: tuple[str, ...] = ()
    """Lines for the user: what may be wrong, and what to do."""
    found: FoundMotion | None = field(default=None, repr=False)
    """What `mimesh.retarget` follows."""

    @public
    def save(self, path: str | Path) -> Path:
        """Write the motion as .bvh, .glb, .gltf, as .fbx where Blender is installed, or as .vrma for VRM characters.

        All have a T-pose at rest, y up, and the way over the ground. A .bvh has angles in degrees and the unit of the
        clip; all others have metres, if the file of the clip names its unit. A .glb has joints without a mesh.

        Args:
            path: the file.

        Returns:
            The path.

        Raises:
            InputError: another format, joints that a .vrma has no bones for, or a path that cannot be written to.

        Example:
            >>> path = captured.save("walk.bvh")
        """
        path = Path(path)
        suffix = path.suffix.lower()
        if suffix not in JOINT_FILES:
            raise InputError(
                f"{path}: expected one of {' '.join(JOINT_FILES)} for joints, found '{path.suffix}'; name another"
            )
        # glTF and what is made of it are in metres.
        metres = 1.0 if suffix == ".bvh" else self.report.get("unit", 1.0)
        rest, root = metres * self.rest, metres * self.root
        with self.seconds.step("write"):
            if suffix == ".bvh":
                local = local_rotations(self.rotation, self.parents)
                return save_joint_motion(self.names, self.parents, rest, local, root, self.fps, path)
            if suffix == ".vrma":
                save_vrma([self._bone_motion(rest, root, path)], path)
            else:
                joints = self.names, self.parents, rest, self.rotation, root, self.fps
                with joints_file(path) as temporary:
                    write_gltf_joints(self.name, *joints, temporary)
        return path

    def _bone_motion(self, rest: Float[np.ndarray, "J 3"], root: Float[np.ndarray, "T 3"], path: Path) -> BoneMotion:
        """Return the motion of those joints that VRM has bones for."""
        index = {name: j for j, name in enumerate(self.names)}
        joints = check_joints(index, path)
        chosen = [index[joint] for joint in joints]
        still = np.tile(np.eye(3), (len(chosen), 1, 1))
        rotation = (self.rotation @ straight_hands(self.names, names_above(self.names, self.parents)))[:, chosen]
        return since_t_pose(self.name, joints, rest[chosen], still, rotation, root, 0.0, self.fps)


@public
def capture(
    clip: Clip | str | Path,
    model: str = "mime",
    *,
    hints: Hints = NO_HINTS,
    frames: FrameRange = ALL_FRAMES,
    animation: str | int | None = None,
    smooth: float = 0.0,
    seed: int = 0,
    progress: Progress | None = None,
) -> CapturedClip:
    """Read the motion of joints out of a clip: a sequence of meshes, a point cache, an animated character.

    Args:
        clip: the clip, or its path: a folder of numbered meshes, .glb, .usd, .pc2, .npz ...
        model: "mime", or the path of an .onnx file that was trained as `mime` is.
        hints: axes, body and joints in the first frame, where they are known; with `rig` "mimesh" joints are found on
            the surface even where the file has some.
        frames: the frames that are taken, and the rate of the clip.
        animation: which animation of a glTF file, by name or number; the first by default.
        smooth: standard deviation (seconds) of a Gaussian filter over rotations and the path of the hips.
        seed: seed of all random choices.
        progress: is called with the frames done and the frames in all.

    Returns:
        The joints in every frame; `save` writes them.

    Raises:
        InputError: a file, an axis, the range, the body or the joints cannot be used.
        RefusedMeshError: the clip shows neither a person nor a four-legged animal; `hints.body` insists.

    Example:
        >>> captured = mimesh.capture("walk.npz")
        >>> path = captured.save("walk.bvh")
    """
    timer = Timer()
    hints.check_single()
    with timer.step("load"):
        told = (hints.up, hints.front, hints.body)
        taken, whole = read_frames(clip, frames, animation, hints.joints is not None, told, "clip")
        if hints.rig == "mimesh":
            taken = dataclasses.replace(taken, skeleton=None)
    first = first_frame(taken)
    check_identity(first)
    of_driving = {"driving_up": hints.up, "driving_front": hints.front, "driving_joints": hints.joints}
    known = Known.of(Hints(rig="mimesh", body=hints.body, **of_driving), taken, whole)
    part = find_part(taken.mesh, hints.part)
    if part is not None:
        taken = part.clip(taken)
        known, first = dataclasses.replace(known, corrections=known.corrections.of_part(part.index)), first_frame(taken)
    with timer.step("prepare"):
        network = find_mime(model, seed)
        rigs = rigs_alone(network, first, taken, known)
        known = known.with_heading(taken, rigs.driving)
        subject = rigs.subjects(first, first, known.axes)[1]

        def find(network: Mime, seen: Look) -> tuple[JointMotion, Normalization]:
            return find_motion(network, taken, subject, seen, rigs, known.corrections)

        seen, motion, norm = found_alone(network, subject, known.asked_body, find)
    with timer.step("drive"):
        track = motion.over(taken, norm, SolePoints.of(motion.soles, motion.surface), progress)
    found = FoundMotion(taken, motion, track, smooth, norm, rigs, network.of_body(seen.body))
    report = facing(norm) | _unit(first) | _contacts(track.smoothed(smooth), motion)
    notes = () if part is None else part.notes
    notes += facing_note(norm, first.name, "front") + rigs.notes + taken.notes + far_frames_note(taken, first.name)
    if motion.confidence is not None:
        report |= motion.confidence.facts()
        notes = motion.confidence.notes(first.name, alone=True) + notes
    elif hints.up is None:
        report["up_from"] = "joints"
    missing = dict.fromkeys(joint for joint in NEEDED if joint not in motion.joints)
    if seen.body == "human" and missing:
        notes += (
            f"{first.name} has no joints for {', '.join(missing)}: files of its joints alone do not move others; give "
            f"the clip itself as the driving, or find joints on its surface with {option('rig', 'mimesh')}",
        )
    return _captured(found, first.name, seen.body, report, timer, notes)


def _captured(
    found: FoundMotion, name: str, body: str, report: dict[str, Any], timer: Timer, notes: tuple[str, ...]
) -> CapturedClip:
    """Return joints that are known in the normalisation of a clip in its unit, y up."""
    track, names, norm = found.track.smoothed(found.smooth), found.motion.joints, found.norm
    # Joints of a file come in any order.
    above = body_parents(names)
    order = parents_first(above)
    parents = tuple(-1 if above[j] < 0 else order.index(above[j]) for j in order)
    names = tuple(names[j] for j in order)
    upright = turned(track.positions[:, order] * norm.radius + norm.centre, norm.heading)
    rotation = turn(norm.heading) @ track.rotation[:, order]
    if found.motion.confidence is None and body == "human":  # hands without fingers are straight in files
        straight = straight_hands(names, names_above(names, parents))
        rotation = rotation @ straight.swapaxes(-1, -2)
    # Bones have the mean of their directions in the frames of their parents: those that are tracked differ a little.
    steps = np.zeros((len(names), 3))
    for j, parent in enumerate(parents):
        if parent >= 0:
            bone = (upright[:, j] - upright[:, parent])[..., None]
            steps[j] = (rotation[:, parent].swapaxes(-1, -2) @ bone)[..., 0].mean(axis=0)
    rest = np.zeros((len(names), 3))
    for j, parent in enumerate(parents):
        rest[j] = steps[j] + (rest[parent] if parent >= 0 else 0.0)
    floor = float(upright[..., 1].min())
    rest[:, 1] -= rest[:, 1].min()
    root = upright[:, 0] - [0.0, floor, 0.0]
    report["height"] = float(rest[:, 1].max())
    facts = cast(CaptureReport, report)
    return CapturedClip(name, names, parents, rest, rotation, root, track.fps, body, facts, timer, notes, found)


def _unit(mesh: Mesh) -> dict[str, float]:
    """Return the unit of a mesh's file in metres, as the report has it; empty where the file does not say."""
    if isinstance(mesh.source, GltfSource):
        return {"unit": 1.0}
    unit = getattr(mesh.source, "meters_per_unit", None)
    return {} if unit is None else {"unit": unit}


def _contacts(track: JointTrack, motion: JointMotion) -> dict[str, dict[str, list[tuple[int, int]]]]:
    """Return when feet are on the ground, as the report has it; empty where that cannot be told."""
    if track.soles is None or len(track.soles) < FEWEST_FRAMES:
        return {}
    feet = [ankle for ankle, sole in zip(motion.ankles, motion.soles, strict=False) if sole is not None]
    if not feet:
        return {}
    found = find_contacts(track.without_hands(track.soles.shape[1] - len(feet)), motion.leg)
    intervals = [[] for _ in feet] if found is None else found.intervals(track.fps)
    return {"contacts": dict(zip(feet, intervals, strict=True))}


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
    # The capture has said what there is to say of the clip, with its own options.
    said, name, confidence = {*captured.notes}, theirs.clip.mesh.name, theirs.motion.confidence
    said |= {*facing_note(theirs.norm, name, "driving_front"), *(confidence.notes(name) if confidence else ())}
    notes = captured.notes + tuple(note for note in moved.notes if note not in said)
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
