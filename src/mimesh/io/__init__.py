"""Reading and writing meshes and clips in any format; `formats` says which file does which.

What is read is checked here. `save_mesh` gives the identity's own file back, points moved, whenever the suffix is the
one it came with. Clips are read and written frame by frame, so that long ones need no memory.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh, check_clip, check_mesh
from .atomic import whole_file, writing
from .bvh_write import save_bvh as save_bvh
from .formats import ANIMATED, CACHES, CLIP_READERS, CLIP_WRITERS, FRAME_SUFFIXES, MESH_READERS, MESH_WRITERS, MOTIONS
from .frame_folder import read_sequence, write_sequence
from .mtl import copy_companions
from .obj_source import ObjSource
from .ply import PlySource
from .timing import DEFAULT_FPS, HIGHEST_FPS

if TYPE_CHECKING:
    from ..core.animated_rig import AnimatedRig


def load_mesh(path: str | Path) -> Mesh:
    """Read one mesh from a file and check it; of a motion (joints alone) the shipped body in its first frame.

    Raises:
        InputError: no such file, a format that is not read, a damaged file, or a mesh that cannot be worked with.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: expected a mesh file, found a folder; name one file in it (a folder is a clip)")
    _must_exist(path)
    if path.suffix.lower() in CLIP_READERS.keys() - MESH_READERS.keys():
        return _only_frame(load_clip(path), path)
    if path.suffix.lower() not in MESH_READERS:
        raise InputError(
            f"{path}: expected one of {' '.join(sorted(MESH_READERS.keys() | CLIP_READERS))}, {_found(path)}; "
            "save it as one of these first, with Blender for example"
        )
    reader = MESH_READERS[path.suffix.lower()]
    with _reading(path):
        mesh = reader(path)
    return check_mesh(mesh, path)


def load_clip(
    path: str | Path, fps: float | None = None, animation: str | None = None, progress: Progress | None = None
) -> Clip:
    """Read a clip from a file or a folder of numbered meshes, and check it; a file of one mesh is a clip of one frame.

    A motion file, which has joints and no mesh, is played by the shipped body (`motions.on_body`).

    Args:
        fps: overrides the file's own frame rate; without either it is 30 per second. Files that know the time of their
            frames (glTF, USD, Alembic, MDD, motions) are sampled at it, so that they last as long as before; others
            (folders, archives of arrays, PC2) are played at it.
        animation: which one of a glTF file, by name or number; None: the first, with those that move other nodes.
        progress: called with (frames read, frames in all).

    Raises:
        InputError: as `load_mesh`, frames that do not share one topology, or no such animation.
    """
    path = Path(path)
    if animation is not None and path.suffix.lower() not in ANIMATED:
        raise InputError(
            f"{path}: expected {' or '.join(ANIMATED)} with --animation, found '{path.suffix}'; leave it out"
        )
    if fps is not None and not fps > 0:
        raise InputError(f"{path}: expected a positive frame rate, found {fps:g}; give another with --fps")
    if fps is not None and fps > HIGHEST_FPS:
        raise InputError(
            f"{path}: expected a frame rate of {HIGHEST_FPS:,.0f} or less, found {fps:g}; give another with --fps"
        )
    _must_exist(path)
    if path.is_dir():
        with _reading(path):
            clip = read_sequence(path, fps or DEFAULT_FPS, MESH_READERS.keys() - MOTIONS, _load_frame, progress)
        # The clip is called as its folder is, not as its first frame.
        return check_clip(dataclasses.replace(clip, mesh=dataclasses.replace(clip.mesh, name=path.name)), path)
    if path.suffix.lower() in CLIP_READERS:
        with _reading(path):
            return check_clip(CLIP_READERS[path.suffix.lower()](path, fps, progress), path)
    if path.suffix.lower() in ANIMATED:
        from .gltf import read_gltf_clip

        with _reading(path):
            return check_clip(read_gltf_clip(path, fps, animation, progress), path)
    mesh = load_mesh(path)
    return Clip(mesh, mesh.vertices[None], fps or DEFAULT_FPS)


def save_mesh(mesh: Mesh, path: str | Path) -> None:
    """Write a mesh, whole or not at all; in the format of its own file that file comes back with the points moved.

    Then polygons, texture coordinates, materials, groups, comments and order are as they were, and the material
    libraries and images it names are copied beside it unless files of these names exist. In another format it becomes a
    new file: of polygons where the format has them (OBJ, PLY, OFF), else of triangles.

    Raises:
        InputError: a format that is not written, or a place that cannot be written to.
    """
    path = Path(path)
    if mesh.source is not None and mesh.source.suffix == path.suffix.lower():
        with writing(path):
            with whole_file(path) as temporary:
                mesh.source.write(mesh, temporary)
            _copy_companions(mesh, path.parent)
    else:
        if path.suffix.lower() not in MESH_WRITERS:
            raise InputError(
                f"{path}: expected an output in one of {' '.join(MESH_WRITERS)}, {_found(path)}; name another"
            )
        writer = MESH_WRITERS[path.suffix.lower()]
        with writing(path):
            writer(mesh, path)


def save_clip(
    clip: Clip,
    path: str | Path,
    suffix: str | None = None,
    progress: Progress | None = None,
    blendshapes: int | None = None,
) -> float | None:
    """Write a clip as one file or, for a path without a suffix, as a folder of numbered meshes.

    Args:
        suffix: the frames' format in a folder: .obj or .ply; by default that of the mesh's own file, else .obj.
        progress: called with (frames written, frames in all).
        blendshapes: so many morph targets in all, instead of one a frame (.glb, .gltf); see `gltf.write_gltf_clip`.

    Returns:
        With `blendshapes`, how far a vertex is from its frame at most, in the mesh's unit.

    Raises:
        InputError: a format that holds no clip, or a place that cannot be written to.
    """
    path = Path(path)
    is_folder = path.is_dir() or not path.suffix
    if blendshapes is not None:
        return _save_blended(clip, path, progress, blendshapes)
    if not is_folder and path.suffix.lower() in CLIP_WRITERS:
        beside = _mesh_to_write_beside(clip, path) if path.suffix.lower() in CACHES else None
        with writing(path):
            CLIP_WRITERS[path.suffix.lower()](clip, path, progress)
        if beside is not None:
            save_mesh(clip.mesh.with_vertices(clip.vertices[0].astype(np.float64)), beside)
        return None
    if not is_folder:
        raise InputError(
            f"{path}: expected a clip format ({' '.join(CLIP_WRITERS)}) or a folder, found '{path.suffix}'; "
            f"write {path.with_suffix('.glb').name}, or {path.stem}/ for one mesh per frame"
        )
    own = clip.mesh.source.suffix if clip.mesh.source else ""
    suffix = suffix or (own if own in FRAME_SUFFIXES else FRAME_SUFFIXES[0])
    if suffix not in FRAME_SUFFIXES:
        raise InputError(
            f"{path}: expected frames of {' or '.join(FRAME_SUFFIXES)}, found '{suffix}'; choose one of them"
        )
    if path.is_file():
        raise InputError(f"{path}: expected a folder to write frames to, found a file; choose another name")
    with writing(path):
        write_sequence(clip, path, suffix, MESH_WRITERS[suffix], load_mesh, progress)
        if own == suffix:
            _copy_companions(clip.mesh, path)
    return None


def _save_blended(clip: Clip, path: Path, progress: Progress | None, blendshapes: int) -> float | None:
    from .gltf import write_gltf_clip

    if path.suffix.lower() not in (".glb", ".gltf"):
        raise InputError(f"{path}: expected .glb or .gltf for --blendshapes, found '{path.suffix}'; leave it out")
    with writing(path), whole_file(path) as temporary:
        return write_gltf_clip(clip, temporary, progress, blendshapes)


def save_skinned(skeleton: AnimatedRig, fps: float, path: str | Path) -> None:
    """Write a mesh with joints and their animation as .glb or .gltf (see `gltf_skinned`).

    Raises:
        InputError: another format, or a place that cannot be written to.
    """
    from .gltf.skinned import write_gltf_skinned

    path = Path(path)
    if path.suffix.lower() not in (".glb", ".gltf"):
        raise InputError(f"{path}: expected .glb or .gltf for joints, found '{path.suffix}'; name another with -o")
    with writing(path), whole_file(path) as temporary:
        write_gltf_skinned(skeleton, fps, temporary)


def mesh_suffixes() -> tuple[str, ...]:
    """Suffixes that `load_mesh` reads, with their dot."""
    return tuple(MESH_READERS)


def clip_suffixes() -> tuple[str, ...]:
    """Suffixes that `save_clip` writes as one file, with their dot."""
    return tuple(CLIP_WRITERS)


def _load_frame(path: Path) -> Mesh:
    mesh = load_mesh(path)
    if path.suffix.lower() in ANIMATED and mesh.source is None:
        raise InputError(f"{path}: expected a mesh as a frame of a clip, found joints that move; give that file alone")
    return mesh


def _only_frame(clip: Clip, path: Path) -> Mesh:
    if len(clip) > 1:
        raise InputError(
            f"{path}: expected one mesh, found a clip of {len(clip)} frames; "
            "give it as the driving clip or save one frame"
        )
    return clip.mesh


def _mesh_to_write_beside(clip: Clip, path: Path) -> Path | None:
    """Where the mesh of a cache goes; None where one with its vertices and faces lies there already."""
    own = clip.mesh.source.suffix if clip.mesh.source else ""
    beside = path.with_suffix(own if own in FRAME_SUFFIXES else FRAME_SUFFIXES[0])
    if not beside.exists():
        return beside
    there = load_mesh(beside)
    if len(there.vertices) != len(clip.mesh.vertices) or not np.array_equal(there.faces, clip.mesh.faces):
        raise InputError(
            f"{path}: expected {beside.name} to be the mesh it belongs to, found another there; choose another name"
        )
    return None


def _must_exist(path: Path) -> None:
    if not path.exists():
        raise InputError(f"{path}: expected a file or folder, found nothing of that name; check the path")


def _found(path: Path) -> str:
    return f"found '{path.suffix}'" if path.suffix else "found no suffix"


def _copy_companions(mesh: Mesh, folder: Path) -> None:
    if isinstance(mesh.source, ObjSource | PlySource):
        copy_companions(mesh.source.companions, mesh.source.path.parent, folder)


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Say in one line why a file cannot be opened, and that it is empty if it is."""
    try:
        if path.is_file() and path.stat().st_size == 0:
            raise InputError(f"{path}: expected a mesh, found an empty file of 0 bytes; export it again")
        yield
    except OSError as error:
        raise InputError(
            f"{path}: expected a readable file, found '{error.strerror}'; check its permissions"
        ) from error
