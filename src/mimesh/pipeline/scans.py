"""Scans: a folder of meshes of one person or animal that have no topology in common becomes a clip.

Joints are found on each scan alone. The one on which they were found most certainly is skinned, and moves as the joints
do in all of them. From then on it is a clip whose joints are known.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core.budgets import check_clip_size
from ..core.frame_buffer import PosedFrames, Progress, counted
from ..core.geometry import angles_between
from ..core.joint_tracks import JointTrack
from ..core.mesh import Clip, Mesh, check_cut
from ..core.normalization import Normalization
from ..core.person_motion import PersonMotion
from ..core.rig import Rig, leg_length
from ..core.skinning import SkinnedMesh, place_joints
from ..io import load_mesh
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
        frames: those to take.
        told: what is known of the first of them.
        fps: frames a second of the folder; None: 30.
        progress: called with (meshes read, meshes in all).

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
    mime, first = find_mime("mime"), Subject(_named(paths[0]), (up, front))
    seen, pose, norm = found_alone(mime, first, body, lambda network, look: find_pose(network, first, look))
    network, axes = mime.of_body(seen.body), norm.axes

    def scans() -> Iterator[Scan]:
        near = norm.rotation.T @ pose.rotation, norm.undo(pose.joints)
        yield Scan(axes @ near[0], near[1] @ axes.T, pose.confidence, norm)
        for path in paths[1:]:
            subject = Subject(_named(path), (norm.up, None))
            fitted, own = find_pose(network, subject, known_look(network, subject), near)
            near = own.rotation.T @ fitted.rotation, own.undo(fitted.joints)
            yield Scan(axes @ near[0], near[1] @ axes.T, fitted.confidence, own)

    return network, counted(scans(), len(paths), progress)


def _named(path: Path) -> Mesh:
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
    """Tell what was made of the scans, and in which of them joints were not found with certainty."""
    note = (
        f"{name} has meshes of different topologies: joints were found in each of the {len(paths)}, and "
        f"{paths[best].name} is moved by them"
    )
    uncertain = [path.name for path, value in zip(paths, uncertainty, strict=True) if value > 1]
    if not uncertain:
        return (note,)
    names = ", ".join(uncertain[:NAMED]) + (" and others" if len(uncertain) > NAMED else "")
    return note, f"joints were not found with certainty in {len(uncertain)} of {len(paths)} scans: {names}"
