"""Read meshes and clips in any format; everything that is read is validated here.

`formats` maps suffixes to the functions of each format.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.arguments import check_rate, public
from ..core.errors import InputError, option
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh, check_clip, check_mesh, cut_clip, stored_clip
from ..core.system import refuse_pipe
from .atomic import writing
from .formats import ANIMATED, BODY_MODELS, CLIP_READERS, JOINTED, MESH_READERS, MOTIONS, PICTURES, found_suffix
from .timing import DEFAULT_FPS

PACKED = (b"PK\3\4", b"Rar!", b"7z\xbc\xaf")
"""First bytes of archives of several files."""
STAND_INS = {
    b"version https://git-lfs": "a Git LFS pointer; run 'git lfs pull'",
    b"<!doctype html": "a web page; download the file itself",
    b"<html": "a web page; download the file itself",
}
"""First bytes, in lower case, of text that downloads leave in place of a file, and what to do."""
FRAMES_OF_FOLDERS = MESH_READERS.keys() - MOTIONS - BODY_MODELS
"""Suffixes of the numbered meshes of a folder that is a clip."""
ZIPPED = {".npz", ".usdz", *BODY_MODELS}
"""Suffixes of formats that are such archives, or refused by their own readers."""


@public
def load_mesh(path: str | Path) -> Mesh:
    """Read one mesh from a file and validate it; a motion file (joints only) gives the default body in its first frame.

    Args:
        path: the file, in a format of `mesh_suffixes`.

    Returns:
        The mesh in the axes and unit of the file; polygons are triangulated.

    Raises:
        InputError: no such file, an unknown format, a damaged file, or an unusable mesh (see `mesh.check_mesh`).

    Example:
        >>> mesh = mimesh.load_mesh("hero.glb")
        >>> mesh.name, mesh.vertices.shape, mesh.faces.shape
        ('hero', (502, 3), (1000, 3))
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: expected a mesh file, found a folder; name one file in it (a folder is a clip)")
    _must_exist(path)
    if path.suffix.lower() in CLIP_READERS.keys() - MESH_READERS.keys():
        clip = load_clip(path)
        if len(clip) > 1:
            raise InputError(
                f"{path}: expected one mesh, found a clip of {len(clip)} frames; "
                "give it as the driving clip or save one frame"
            )
        return clip.mesh
    if path.suffix.lower() in PICTURES:
        raise InputError(f"{path}: expected a mesh, found a picture; name the file of the mesh")
    if path.suffix.lower() not in MESH_READERS:
        raise InputError(
            f"{path}: expected one of {' '.join(sorted(MESH_READERS.keys() | CLIP_READERS))}, {found_suffix(path)}; "
            "save it as one of these first, with Blender for example"
        )
    reader = MESH_READERS[path.suffix.lower()]
    with _reading(path):
        mesh = reader(path)
    return check_mesh(mesh, path)


def check_readable(path: Path) -> None:
    """Check that what reads a format is installed, before the work is done.

    Raises:
        NotInstalledError: an .fbx and no ufbx, USD and no usd-core, or compressed glTF and no decoder.
    """
    suffix = path.suffix.lower()
    if suffix == ".fbx":
        from .fbx import need_reader

        need_reader(path)
    elif suffix.startswith(".usd"):
        from .usd import need_library

        need_library(path, "read")
    elif suffix in JOINTED:
        from .gltf.document import check_decoders

        check_decoders(path)


@public
def load_clip(
    path: str | Path,
    *,
    fps: float | None = None,
    animation: str | int | None = None,
    progress: Progress | None = None,
    frames: slice = slice(None),
) -> Clip:
    """Read a clip from a file or a folder of numbered meshes, and validate it; a file of one mesh gives one frame.

    A motion file, which has joints and no mesh, moves the default body (`motions.on_body`).

    Args:
        path: the file or folder.
        fps: frames a second: files with times (glTF, FBX, USD, motions) are sampled at it and keep their duration,
            others (folders, PC2, NPZ) are played at it. By default the rate of the file, or 30.
        animation: name or number of an animation of a glTF file, None: the first, with those that move other nodes.
        progress: called with (frames read, frames in all).
        frames: those to take, counted from 0 at the frame rate of the result; see `cut_clip`. Of a motion file the
            others are never posed, of other files they are read too.

    Returns:
        The clip in the axes and unit of the file.

    Raises:
        InputError: as `load_mesh`; frames of different topology; no such animation; no frame is left.

    Example:
        >>> clip = mimesh.load_clip("walk.npz", frames=slice(0, 4, 2))
        >>> clip.vertices.shape, clip.fps  # (T, V, 3), and frames a second
        ((2, 502, 3), 5.0)
    """
    return stored_clip(load_driving(path, fps=fps, animation=animation, progress=progress, frames=frames), progress)


def load_driving(
    path: str | Path,
    *,
    fps: float | None = None,
    animation: str | int | None = None,
    progress: Progress | None = None,
    frames: slice = slice(None),
) -> Clip:
    """Read a clip as `load_clip` does; the frames of a motion file are posed when they are read (`PosedFrames`)."""
    path, animation = Path(path), None if animation is None else str(animation)
    _check_clip_options(path, fps, animation)
    _must_exist(path)
    if frames == slice(None):
        return _whole_clip(path, fps, animation, progress)
    from ..motions.on_body import is_motion_file, motion_file_clip

    if path.is_file():
        with _reading(path):
            if is_motion_file(path):
                return check_clip(motion_file_clip(path, fps, frames), path)
    clip = _whole_clip(path, fps, animation, progress)
    return cut_clip(clip, frames.start or 0, frames.stop, 1 if frames.step is None else frames.step)


def _whole_clip(path: Path, fps: float | None, animation: str | None, progress: Progress | None) -> Clip:
    suffix = path.suffix.lower()
    if path.is_file() and suffix not in (*CLIP_READERS, *ANIMATED):
        mesh = load_mesh(path)
        return Clip(mesh, mesh.vertices[None], fps or DEFAULT_FPS)
    with _reading(path):
        if path.is_dir():
            from .frame_folder import read_sequence

            clip = read_sequence(path, fps or DEFAULT_FPS, FRAMES_OF_FOLDERS, _load_frame, progress)
            # The clip takes the name of the folder, not that of its first frame.
            clip = dataclasses.replace(clip, mesh=dataclasses.replace(clip.mesh, name=path.name))
        elif suffix in ANIMATED:
            from .gltf import read_gltf_clip

            clip = read_gltf_clip(path, fps, animation, progress)
        else:
            clip = CLIP_READERS[suffix](path, fps, progress)
        return check_clip(clip, path)


def load_points(path: str | Path, first: Mesh, first_path: Path) -> Float[np.ndarray, "V 3"]:
    """Read the vertices of a mesh that must have the topology of a first one; quick for OBJ and PLY files."""
    from .frame_folder import read_frame

    path = Path(path)
    _must_exist(path)
    with _reading(path):
        return read_frame(path, first, first_path, _load_frame)


@public
def load_recorded_clip(
    path: str | Path,
    body_model: str | Path,
    *,
    fps: float | None = None,
    animation: str | None = None,
    progress: Progress | None = None,
    count: int | None = None,
    betas: Float[np.ndarray, " K"] | None = None,
) -> tuple[Clip, tuple[str, ...]]:
    """Read recorded parameters of a body model as a clip of the recorded surface; see `motions.smpl_clip`.

    Args:
        path: an AMASS archive (.npz), or a pickle (.pkl) of `pose`, `betas` and `trans`.
        body_model: file of the model, .pkl or .npz in SMPL's layout.
        fps: frame rate at which the recording is resampled; None: its own.
        animation: refused, as such files have one clip.
        progress: called with (frames read, frames in all).
        count: number of frames to take, evenly spread from the first to the last; None: all.
        betas: shape coefficients of another person to move; None: those of the recorded one.

    Returns:
        The clip, y up and in metres for AMASS, and notes on what the model or the file lacks.

    Raises:
        InputError: one of the files cannot be used.
    """
    from ..bodies.smpl_model import load_smpl_model
    from ..motions.smpl_clip import recorded_clip

    path, body_model = Path(path), Path(body_model)
    _check_clip_options(path, fps, animation)
    _must_exist(path)
    _must_exist(body_model)
    with _reading(body_model):
        model = load_smpl_model(body_model)
    with _reading(path):
        clip, notes = recorded_clip(path, model, fps, progress, count, betas)
    return check_clip(clip, path), notes


def list_animations(path: str | Path) -> tuple[str, ...]:
    """List the names of the animations of a glTF file or an .fbx; their number stands for a missing name.

    Empty for other formats, which have one clip at most, and for folders.
    """
    path = Path(path)
    _must_exist(path)
    if path.is_dir() or path.suffix.lower() not in ANIMATED:
        return ()
    from .gltf.animation import animation_names
    from .gltf.document import open_document

    with _reading(path):
        return animation_names(open_document(path))


def _check_clip_options(path: Path, fps: float | None, animation: str | None) -> None:
    if animation is not None and path.suffix.lower() not in ANIMATED:
        raise InputError(
            f"{path}: expected {' or '.join(ANIMATED)} with {option('animation', ...)}, found '{path.suffix}'; leave "
            "it out"
        )
    if fps is not None:
        check_rate(fps, path, f"give another with {option('fps', ...)}")


def _load_frame(path: Path) -> Mesh:
    """Read one mesh of a folder of frames; raises InputError for a glTF file of joints without a mesh."""
    mesh = load_mesh(path)
    if path.suffix.lower() in ANIMATED and mesh.source is None:
        raise InputError(f"{path}: expected a mesh as a frame of a clip, found joints that move; give that file alone")
    return mesh


def _must_exist(path: Path) -> None:
    if not path.exists():
        raise InputError(f"{path}: expected a file or folder, found nothing of that name; check the path")
    refuse_pipe(path)
    if path.is_file():
        with _reading(path), path.open("rb") as file:
            start = file.read(32)
        for text, found in STAND_INS.items():
            if start.lower().startswith(text):
                raise InputError(f"{path}: expected a mesh or a clip, found {found}")
        if start.startswith(PACKED) and path.suffix.lower() not in ZIPPED:
            raise InputError(
                f"{path}: expected a mesh or a clip, found a packed archive; unpack it, and give a file in it"
            )


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn a failed read into an InputError of one line that names the cause; an empty file is refused at once.

    NumPy does not warn of the numbers of a damaged file, which may be NaN or huge: what is read is checked in the end.
    """
    try:
        with writing(path, "a readable file", "check its permissions"), np.errstate(all="ignore"):
            if path.is_file() and path.stat().st_size == 0:
                raise InputError(f"{path}: expected a mesh, found an empty file of 0 bytes; export it again")
            yield
    except MemoryError as error:
        raise InputError(
            f"{path}: expected a file that fits into memory, found a larger one; split it, or take fewer frames"
        ) from error
