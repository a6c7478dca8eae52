"""Suffix -> the function that reads or writes it, one literal table for each of mesh and clip.

A reader takes a Path and returns a Mesh or Clip. A writer takes the Mesh or Clip and a Path; the file appears whole or
not at all (`atomic.whole_file`). What takes long to import is imported when it is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh
from .atomic import whole_file
from .npz import read_npz, write_npz, write_npz_clip
from .npz import read_npz_clip as read_points_clip
from .obj import read_obj, write_obj
from .off import read_off, write_off
from .ply import read_ply, write_ply
from .point_cache import read_cache, write_mdd, write_npy, write_pc2
from .stl import read_stl, write_stl
from .usd import read_usd, read_usd_clip, write_usd, write_usd_clip


def _read_gltf(path: Path) -> Mesh:
    from .gltf import read_gltf

    return read_gltf(path)


def _write_gltf(mesh: Mesh, path: Path) -> None:
    from .gltf import write_gltf

    with whole_file(path) as temporary:
        write_gltf(mesh, temporary)


def _write_gltf_clip(clip: Clip, path: Path, progress: Progress | None) -> None:
    from .gltf import write_gltf_clip

    with whole_file(path) as temporary:
        write_gltf_clip(clip, temporary, progress)


def _read_alembic(path: Path) -> Mesh:
    from .alembic.read import read_alembic

    return read_alembic(path)


def _read_alembic_clip(path: Path, fps: float | None, progress: Progress | None) -> Clip:
    from .alembic.read import read_alembic_clip

    return read_alembic_clip(path, fps, progress)


def _write_alembic(mesh: Mesh, path: Path) -> None:
    from .alembic.write import write_alembic

    write_alembic(mesh, path)


def _write_alembic_clip(clip: Clip, path: Path, progress: Progress | None) -> None:
    from .alembic.write import write_alembic_clip

    write_alembic_clip(clip, path, progress)


def _read_motion(path: Path) -> Mesh:
    from ..motions.on_body import motion_file_mesh

    return motion_file_mesh(path)


def _read_motion_clip(path: Path, fps: float | None, progress: Progress | None) -> Clip:
    from ..motions.on_body import motion_file_clip

    return motion_file_clip(path, fps, progress)


def _read_npz(path: Path) -> Mesh:
    from ..motions.on_body import is_motion_file

    return _read_motion(path) if is_motion_file(path) else read_npz(path)


def _read_npz_clip(path: Path, fps: float | None, progress: Progress | None) -> Clip:
    from ..motions.on_body import is_motion_file

    return (_read_motion_clip if is_motion_file(path) else read_points_clip)(path, fps, progress)


def _read_cache(path: Path, fps: float | None, progress: Progress | None) -> Clip:
    def read(mesh: Path) -> Mesh:
        return MESH_READERS[mesh.suffix.lower()](mesh)

    meshes = [suffix for suffix in MESH_READERS if suffix not in (*MOTIONS, *FRAMES_ONLY)]
    return read_cache(path, fps, sorted(meshes, key=lambda suffix: suffix not in FRAME_SUFFIXES), read, progress)


MESH_READERS: dict[str, Callable[[Path], Mesh]] = {
    ".abc": _read_alembic,
    ".bvh": _read_motion,
    ".glb": _read_gltf,
    ".gltf": _read_gltf,
    ".npz": _read_npz,
    ".obj": read_obj,
    ".off": read_off,
    ".ply": read_ply,
    ".stl": read_stl,
    ".usd": read_usd,
    ".usda": read_usd,
    ".usdc": read_usd,
    ".usdz": read_usd,
    ".vrm": _read_gltf,
}
MESH_WRITERS: dict[str, Callable[[Mesh, Path], None]] = {
    ".abc": _write_alembic,
    ".glb": _write_gltf,
    ".gltf": _write_gltf,
    ".npz": write_npz,
    ".obj": write_obj,
    ".off": write_off,
    ".ply": write_ply,
    ".stl": write_stl,
    ".usd": write_usd,
    ".usda": write_usd,
    ".usdc": write_usd,
    ".usdz": write_usd,
}
CLIP_READERS: dict[str, Callable[[Path, float | None, Progress | None], Clip]] = {
    ".abc": _read_alembic_clip,
    ".bvh": _read_motion_clip,
    ".mdd": _read_cache,
    ".npy": _read_cache,
    ".npz": _read_npz_clip,
    ".pc2": _read_cache,
    ".usd": read_usd_clip,
    ".usda": read_usd_clip,
    ".usdc": read_usd_clip,
    ".usdz": read_usd_clip,
}
"""Of a path, the frame rate that is wanted (None: the file's own), and what is told of the progress; not ANIMATED."""
CLIP_WRITERS: dict[str, Callable[[Clip, Path, Progress | None], None]] = {
    ".abc": _write_alembic_clip,
    ".glb": _write_gltf_clip,
    ".gltf": _write_gltf_clip,
    ".mdd": write_mdd,
    ".npy": write_npy,
    ".npz": write_npz_clip,
    ".pc2": write_pc2,
    ".usd": write_usd_clip,
    ".usda": write_usd_clip,
    ".usdc": write_usd_clip,
    ".usdz": write_usd_clip,
}
ANIMATED = (".glb", ".gltf", ".vrm")
"""Files that may hold several animations; see `gltf.read_gltf_clip`."""
CACHES = (".mdd", ".npy", ".pc2")
"""Points alone, which belong to a mesh beside them."""
MOTIONS = {".bvh"}
"""Files that never are a frame of a clip."""
FRAMES_ONLY = (*CACHES, ".npz")
"""Files of frames, none of which is the mesh at rest."""
FRAME_SUFFIXES = (".obj", ".ply")
"""What a clip is written as when it goes into a folder."""
