"""Read the meshes and clips that the public functions are given, or check those in memory.

Scans are a folder of meshes of one person or animal without a common topology. Joints are found on each alone; the one
on which they were found most certainly is skinned, and moves as the joints do in all of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core.arguments import described
from ..core.budgets import check_clip_size
from ..core.errors import InputError, OtherTopologyError, option
from ..core.frame_buffer import PosedFrames, Progress, counted, vertices_of_all
from ..core.geometry import angles_between
from ..core.joint_tracks import JointTrack
from ..core.mesh import UNNAMED, Clip, Mesh, check_clip, check_cut, check_mesh, cut_clip
from ..core.normalization import Normalization
from ..core.options import FrameRange
from ..core.person_motion import PersonMotion
from ..core.rig import Rig, leg_length
from ..core.skinning import SkinnedMesh, place_joints
from ..io import load_driving, load_mesh
from ..io.frame_folder import find_frames
from ..io.load import FRAMES_OF_FOLDERS
from ..io.timing import DEFAULT_FPS
from ..methods.find import find_mime
from ..mime.model import Mime
from ..rigs.confidence import Confidence
from ..rigs.retarget import ScannedJoints
from .joint_route import find_pose, found_alone
from .look import Subject, known_look, normalised

Told = tuple[str | None, str | None, str]
"""Up and front of the first scan, and whose joints scans have; None and "auto" are detected."""


def read_mesh(mesh: Mesh | str | Path, role: str) -> Mesh:
    """Read a mesh, or check one in memory; see `_named`."""
    if isinstance(mesh, Mesh):
        # A result is saved later: what the caller does with the arrays until then must not change it.
        own = {name: value.copy() for name, value in vars(mesh).items() if isinstance(value, np.ndarray)}
        mesh = _named(dataclasses.replace(mesh, **own), role)
        return check_mesh(mesh, mesh.name)
    return load_mesh(Path(mesh))


def _named(mesh: Mesh, role: str) -> Mesh:
    """Name a mesh of arrays that has no name by what it is for, in messages and in files that are written."""
    return dataclasses.replace(mesh, name=role) if mesh.name == UNNAMED and mesh.source is None else mesh


def read_clip(clip: Clip | str | Path, fps: float | None, animation: str | int | None, role: str = "driving") -> Clip:
    """Read a clip, or check one in memory; see `_named`."""
    if isinstance(clip, Clip):
        clip = dataclasses.replace(clip, mesh=_named(clip.mesh, role))
        if animation is not None:
            raise InputError(
                f"animation: expected the path of a file with it, found {described(clip)}; give the path, or the "
                "animation to load_clip"
            )
        return check_clip(clip if fps is None else dataclasses.replace(clip, fps=fps), clip.mesh.name)
    return load_driving(Path(clip), fps=fps, animation=animation)


def read_frames(
    clip: Clip | str | Path,
    frames: FrameRange,
    animation: str | int | None,
    whole: bool,
    told: Told,
    role: str = "driving",
) -> tuple[Clip, Clip]:
    """Read some frames of a clip; returns these, and the clip that they are of: the whole one if it is asked for."""
    if not whole and not isinstance(clip, Clip):
        taken = load_moving(Path(clip), frames.slice, told, frames.fps, animation)
        return taken, taken
    if isinstance(clip, Clip):
        read = read_clip(clip, frames.fps, animation, role)
    else:
        read = load_moving(Path(clip), slice(None), told, frames.fps, animation)
    return cut_clip(read, frames.start, frames.stop, frames.step), read


def load_moving(
    path: Path,
    frames: slice,
    told: Told,
    fps: float | None = None,
    animation: str | int | None = None,
    progress: Progress | None = None,
    scans: slice | None = None,
) -> Clip:
    """Read frames of a clip as `load_driving` does; meshes of different topologies are scans (`scans`).

    Args:
        scans: those to take of scans; None: `frames`.
    """
    try:
        return load_driving(path, fps=fps, animation=animation, progress=progress, frames=frames)
    except OtherTopologyError:
        return scanned_clip(path, frames if scans is None else scans, told, fps, progress)


NEIGHBOURS, MISREAD = 2, 2.0
"""Scans before and after each that a rotation is compared with; and the ratio of its distance from theirs to the least
of these from which on it is replaced."""
SMOOTH = 0.03
"""Standard deviation (seconds) of the Gaussian filter over joints, which are found in each scan alone."""
NAMED = 5
"""Scans that a note names."""


class Scan(NamedTuple):
    """The joints of a scan, y up, in the unit of its file."""

    rotation: Float[np.ndarray, "J 3 3"]
    joints: Float[np.ndarray, "J 3"]
    confidence: Confidence
    norm: Normalization
    """Of the file."""


def scanned_clip(
    folder: Path, frames: slice, told: Told, fps: float | None = None, progress: Progress | None = None
) -> Clip:
    """Find the joints in the numbered meshes of a folder, and make a clip of one of these, y up, in their unit.

    In the first frame it faces +z, or as near to that as a turn by right angles takes it.

    Args:
        fps: frames a second of the folder; None: 30.

    Raises:
        InputError: a mesh cannot be read, or no frame is left.
        RefusedMeshError: the first mesh shows neither a person nor a four-legged animal.
    """
    paths = find_frames(folder, FRAMES_OF_FOLDERS)
    check_cut(folder.name, len(paths), frames)
    paths = paths[frames]
    network, found = _found(paths, told, progress)
    scans = list(found)
    uncertainty = np.array([scan.confidence.uncertainty for scan in scans])
    best = int(uncertainty.argmin())
    shown = load_mesh(paths[best])
    check_clip_size(len(paths), len(shown.vertices), folder)
    weights = network.predict_rig(normalised(shown, scans[best].norm))[0].weights
    upright = Mesh(shown.vertices @ scans[0].norm.axes.T, shown.faces, folder.name, up="+y")
    moving = _moved(upright, weights, scans, best, network, (fps or DEFAULT_FPS) / (frames.step or 1))
    return dataclasses.replace(moving, notes=_notes(folder.name, paths, best, uncertainty))


def _moved(
    shown: Mesh, weights: Float[np.ndarray, "V J"], scans: Sequence[Scan], best: int, network: Mime, fps: float
) -> Clip:
    """Move the scan that was read best, y up, by the joints of all."""
    parents, uncertainty = network.parents, [scan.confidence.uncertainty for scan in scans]
    rotation, joints = (np.stack(arrays) for arrays in list(zip(*scans, strict=True))[:2])
    # Bones have their median length: those that are found differ a little.
    bones = np.median([Rig(scan.rotation, scan.joints, weights).bones(parents) for scan in scans], axis=0)
    at_rest = Rig(rotation[best], place_joints(joints[best, 0], bones, rotation[best], parents), weights)
    kept = _likeliest(rotation)
    rotation, root = rotation[kept, np.arange(len(parents))], joints[kept[:, 0], 0]
    track = JointTrack(rotation, place_joints(root, bones, rotation, parents), fps).smoothed(SMOOTH)
    rotation, root = track.rotation, track.positions[:, 0]
    leg = leg_length(at_rest.joints, network.legs)
    motion = PersonMotion(network.joints, rotation, place_joints(root, bones, rotation, parents), leg, weights)
    vertices: Any = PosedFrames(SkinnedMesh.of(shown.vertices, at_rest, parents), rotation, root)
    median = scans[int(np.argsort(uncertainty)[len(scans) // 2])].confidence
    first = shown.with_vertices(np.asarray(vertices[0], np.float64))
    return Clip(first, vertices, fps, rotation[:, 0, :, 2], ScannedJoints(motion, median))


def _found(paths: list[Path], told: Told, progress: Progress | None) -> tuple[Mime, Iterator[Scan]]:
    """Return the network of the body that the first scan shows, and the joints of all."""
    up, front, body = told
    mime, first = find_mime("mime"), Subject(_read_scan(paths[0]), (up, front))
    seen, pose, norm = found_alone(mime, first, body, lambda network, look: find_pose(network, first, look))
    network, axes = mime.of_body(seen.body), norm.axes

    def scans() -> Iterator[Scan]:
        near = norm.rotation.T @ pose.rotation, norm.undo(pose.joints)
        yield Scan(axes @ near[0], near[1] @ axes.T, pose.confidence, norm)
        for path in paths[1:]:
            subject = Subject(_read_scan(path), (norm.up, None))
            fitted, own = find_pose(network, subject, known_look(network, subject), near)
            near = own.rotation.T @ fitted.rotation, own.undo(fitted.joints)
            yield Scan(axes @ near[0], near[1] @ axes.T, fitted.confidence, own)

    return network, counted(scans(), len(paths), progress)


def _read_scan(path: Path) -> Mesh:
    """Read a scan, and name it with its folder, in messages."""
    return dataclasses.replace(load_mesh(path), name=f"{path.parent.name}/{path.name}")


def _likeliest(rotation: Float[np.ndarray, "T J 3 3"]) -> Int[np.ndarray, "T J"]:
    """Choose for each frame and joint the frame nearby with the likeliest rotation: itself, unless it was misread."""
    count, joints = rotation.shape[:2]
    kept = np.tile(np.arange(count)[:, None], (1, joints))
    for t in range(count):
        near = np.arange(max(0, t - NEIGHBOURS), min(count, t + NEIGHBOURS + 1))
        apart = angles_between(rotation[near, None], rotation[near]).sum(axis=1)  # from all others, (N, J)
        misread = apart[near == t][0] > MISREAD * apart.min(axis=0)
        kept[t] = np.where(misread, near[apart.argmin(axis=0)], t)
    return kept


def _notes(name: str, paths: list[Path], best: int, uncertainty: Float[np.ndarray, " T"]) -> tuple[str, ...]:
    note = (
        f"{name} has meshes of different topologies: joints were found in each of the {len(paths)}, and "
        f"{paths[best].name} is moved by them"
    )
    uncertain = [path.name for path, value in zip(paths, uncertainty, strict=True) if value > 1]
    if not uncertain:
        return (note,)
    names = ", ".join(uncertain[:NAMED]) + (" and others" if len(uncertain) > NAMED else "")
    return note, f"joints were not found with certainty in {len(uncertain)} of {len(paths)} scans: {names}"


LONE_FRAMES = 12
"""First frames of a clip that are compared to tell whether frame 0 belongs to the motion."""
LONE_VERTICES = 200
"""Vertices, evenly spread over their indices, by which they are compared."""
LONE_STEP = 0.05
"""Mean distance of a vertex from frame 0 to frame 1, over the size, from which on frame 0 may be a pose of its own. In
two captures of CMU, which begin with a T-pose, it was 0.17 and 0.25, and at most 0.003 between the frames after it."""
LONE_RATIO = 10.0
"""That distance over the largest one between two later frames; in 17 animations of a game character at most 3."""

FAR_VERTICES = 24
"""Vertices, evenly spread over their indices, in which frames of a clip are compared: few, as these may be on disk."""
FAR_STEP = 0.5
"""Mean distance of a vertex from the middle of the frames before and after, over the size, from which on a frame is a
fault. In 324 animations of games and captures it is at most 0.07 in frames that are twice as far from that middle as
those two from each other, 0.36 where every fourth frame is taken, and 0.54 where every eighth is (docs/log/rigs.md,
2026-11-26)."""
FAR_SHARE = 0.05
"""Largest share of the frames that are taken for faults; more are a fast motion, of which few frames were taken."""


def first_frame_note(clip: Clip, start: int, name: str) -> tuple[str, ...]:
    """Return a note on a first frame far from all others, as the T-pose before many captured motions."""
    if start > 0 or len(clip) < LONE_FRAMES:
        return ()
    every = max(1, len(clip.mesh.vertices) // LONE_VERTICES)
    frames = np.asarray(clip.vertices[:LONE_FRAMES, ::every], np.float64)
    steps = np.linalg.norm(np.diff(frames - frames.mean(axis=1, keepdims=True), axis=0), axis=-1).mean(axis=1)
    size = np.ptp(frames[0], axis=0).max()
    if steps[0] < LONE_STEP * size or steps[0] < LONE_RATIO * steps[1:].max():
        return ()
    return (f"{name}: frame 0 differs from the others (a calibration pose?): {option('start', '1')} leaves it out",)


def far_frames_note(clip: Clip, name: str) -> tuple[str, ...]:
    """Return a note on single frames far from those before and after them, as faults of a tracker or a simulation."""
    if len(clip) * FAR_SHARE < 1:
        return ()
    every = max(1, len(clip.mesh.vertices) // FAR_VERTICES)
    frames = vertices_of_all(clip.vertices, np.arange(0, len(clip.mesh.vertices), every)).astype(np.float64)
    size = np.median(np.ptp(frames, axis=1).max(axis=-1))
    before, after = frames[:-2], frames[2:]
    away = np.linalg.norm(frames[1:-1] - (before + after) / 2, axis=-1).mean(axis=-1)
    apart = np.linalg.norm(after - before, axis=-1).mean(axis=-1)
    far = 1 + np.flatnonzero((away > FAR_STEP * size) & (away > 2 * apart))
    if not 0 < len(far) <= FAR_SHARE * len(clip):
        return ()
    listed = ", ".join(map(str, far[:3])) + (", ..." if len(far) > 3 else "")
    which = f"frame {listed} is" if len(far) == 1 else f"frames {listed} are"
    return (f"{name}: {which} far from the frames before and after, counted from 0 in those taken; a fault, perhaps",)
