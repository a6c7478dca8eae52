"""The formats by suffix: what reads and writes meshes and clips, and what else the rest must know of each.

A reader takes a Path and returns a Mesh or Clip. A writer takes the Mesh or Clip and a Path, and writes atomically
(`atomic.whole_file`). The modules of formats are imported when one of their files is read or written.
"""

from __future__ import annotations

import contextlib
import importlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh
from ..core.npz_archive import archive_names
from .atomic import scratch_folder, whole_file
from .beside import find_beside


def _of(module: str, function: str) -> Callable[..., Any]:
    """Return a function of a module that is imported when the function is called: most runs need few formats."""

    def call(*arguments: Any) -> Any:
        return getattr(importlib.import_module(module, __package__), function)(*arguments)

    return call


@contextlib.contextmanager
def gltf_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path for a glTF file, which becomes the file `path` when the block ends; .fbx by Blender."""
    with whole_file(path) as temporary:
        if path.suffix.lower() != ".fbx":
            yield temporary
            return
        from .fbx.write import write_fbx

        with scratch_folder() as folder:
            glb = folder / "scene.glb"
            yield glb
            write_fbx(glb, temporary, path)


_read_motion = _of("..motions.on_body", "motion_file_mesh")


def _read_motion_clip(path: Path, fps: float | None, progress: Progress | None) -> Clip:
    from ..motions.on_body import motion_file_clip

    return motion_file_clip(path, fps)


def _read_npz(path: Path) -> Mesh:
    """Read an archive as a mesh, or as a motion or a body model where its arrays are those of one."""
    from ..motions.on_body import is_motion_file

    if is_body_model(path):
        return _read_body_model(path)
    if is_motion_file(path):
        return _read_motion(path)
    from .npz import read_npz

    return read_npz(path)


def _read_npz_clip(path: Path, fps: float | None, progress: Progress | None) -> Clip:
    from ..motions.on_body import is_motion_file

    if is_body_model(path):
        return Clip.still(_read_body_model(path))
    if is_motion_file(path):
        return _read_motion_clip(path, fps, progress)
    from .npz import read_npz_clip

    return read_npz_clip(path, fps, progress)


def _read_body_model(path: Path) -> Mesh:
    from ..bodies.smpl_model import load_smpl_model

    return load_smpl_model(path).mesh()


def is_body_model(path: Path) -> bool:
    """Tell whether a file is a body model in SMPL's layout: any .pkl, or an archive with the arrays of one."""
    from ..bodies.smpl_model import MARK

    return path.suffix.lower() in BODY_MODELS or (path.suffix.lower() == ".npz" and MARK in archive_names(path))


def _read_cache(path: Path, fps: float | None, progress: Progress | None) -> Clip:
    """Read a point cache with a mesh of the same name beside it, in any mesh format; .obj and .ply are tried first."""

    def read(mesh: Path) -> Mesh:
        return MESH_READERS[mesh.suffix.lower()](mesh)

    from .pc2 import read_cache

    suffixes = [suffix for suffix in MESH_READERS if suffix not in (*MOTIONS, *BODY_MODELS, *FRAMES_ONLY)]
    return read_cache(path, fps, sorted(suffixes, key=lambda suffix: suffix not in FRAME_SUFFIXES), read, progress)


@dataclass(frozen=True)
class Format:
    """One format: a new one is a module with its functions, and one of these in FORMATS."""

    name: str
    """On the studio's page."""
    read: Callable[[Path], Mesh] | None = None
    write: Callable[[Mesh, Path], None] | None = None
    read_clip: Callable[[Path, float | None, Progress | None], Clip] | None = None
    """Arguments: path, frame rate (None: the file's), progress callback. None also for those of ANIMATED."""
    write_clip: Callable[[Clip, Path, Progress | None], None] | None = None
    lacks: tuple[str, ...] = ()
    """What a new file leaves out of a Mesh, in the words of `tools.notes.not_kept`, which says so in a note."""
    one_mesh: bool = False
    """Whether a file is one mesh and nothing more, so that numbered files may be the frames of a clip."""


POINTS_ALONE = ("materials", "texture coordinates", "normals", "vertex colours")
"""What formats of points and triangles lack."""
_GLTF = _of(".gltf", "read_gltf"), _of(".gltf", "write_gltf"), None, _of(".gltf", "write_gltf_clip")
_NPZ = _read_npz, _of(".npz", "write_npz"), _read_npz_clip, _of(".npz", "write_npz_clip")
_USD = [_of(".usd", name) for name in ("read_usd", "write_usd", "read_usd_clip", "write_usd_clip")]
FORMATS = {
    ".bvh": Format("BVH", _read_motion, None, _read_motion_clip),
    ".fbx": Format("FBX", *_GLTF),
    ".glb": Format("GLB", *_GLTF),
    ".gltf": Format("glTF", *_GLTF),
    ".npz": Format("NumPy archive", *_NPZ, POINTS_ALONE),
    ".obj": Format("OBJ", _of(".obj", "read_obj"), _of(".obj", "write_obj"), one_mesh=True),
    ".off": Format("OFF", _of(".off", "read_off"), _of(".off", "write_off"), lacks=POINTS_ALONE, one_mesh=True),
    ".pc2": Format("PC2 points", None, None, _read_cache, _of(".pc2", "write_pc2")),
    ".pkl": Format("SMPL's pickle", _read_body_model),
    ".ply": Format(
        "PLY",
        _of(".ply", "read_ply"),
        _of(".ply", "write_ply"),
        lacks=("materials besides one image", "normals of hard edges"),
        one_mesh=True,
    ),
    ".stl": Format("STL", _of(".stl", "read_stl"), _of(".stl", "write_stl"), lacks=POINTS_ALONE, one_mesh=True),
    **{
        suffix: Format(name, *_USD, lacks=("vertex colours",))
        for suffix, name in ((".usd", "USD"), (".usda", "USD as text"), (".usdc", "USD, binary"), (".usdz", "USDZ"))
    },
    ".vrm": Format("VRM", _of(".gltf", "read_gltf")),
    ".vrma": Format("VRM animation, no mesh", _of(".gltf", "read_gltf")),
}
"""Suffix -> format."""
MESH_READERS = {suffix: format.read for suffix, format in FORMATS.items() if format.read}
MESH_WRITERS = {suffix: format.write for suffix, format in FORMATS.items() if format.write}
CLIP_READERS = {suffix: format.read_clip for suffix, format in FORMATS.items() if format.read_clip}
CLIP_WRITERS = {suffix: format.write_clip for suffix, format in FORMATS.items() if format.write_clip}
ANIMATED = (".fbx", ".glb", ".gltf", ".vrm", ".vrma")
"""Files that may contain several animations, read by `gltf.read_gltf_clip`."""
JOINTED = (".glb", ".gltf", ".fbx", ".vrm")
"""Formats in which joints and weights are written."""
CACHE = ".pc2"
"""Point caches: positions only, for a mesh file beside them."""
SINGLE_PRECISION = (*JOINTED, CACHE, ".stl", ".usd", ".usda", ".usdc", ".usdz")
"""Formats whose coordinates are float32."""
MORPHED = (".glb", ".gltf")
"""Formats to which a number of morph targets can be given."""
MOTIONS = {".bvh", ".vrma"}
"""Files of joints without a mesh, which cannot be a frame of a clip."""
BODY_MODELS = {".pkl"}
"""Files of body models, which are no frame of a clip: registrations may lie beside the meshes of a folder."""
FRAMES_ONLY = (CACHE, ".npz")
"""Files of frames without a rest shape."""
PICTURES = (".png", ".jpg", ".jpeg")
"""Pictures: what `render` draws, and what is named in place of a mesh."""
FRAME_SUFFIXES = (".obj", ".ply")
"""Formats of the frames of a clip written to a folder; the first is the default."""


def mesh_suffixes() -> tuple[str, ...]:
    """Return the suffixes that `load_mesh` reads, with their dot."""
    return tuple(MESH_READERS)


def clip_suffixes() -> tuple[str, ...]:
    """Return the suffixes that `save_clip` writes as one file, with their dot."""
    return tuple(CLIP_WRITERS)


def may_have_joints(mesh: Mesh) -> bool:
    """Return whether a mesh was read from a file of a format that may have joints."""
    return mesh.source is not None and mesh.source.suffix in ANIMATED


def in_single_precision(mesh: Mesh, path: Path) -> bool:
    """Tell whether a file would hold a mesh in single precision; nodes of its own glTF file may hold its place."""
    suffix = path.suffix.lower()
    return suffix in SINGLE_PRECISION and not (suffix in JOINTED and may_have_joints(mesh))


def found_suffix(path: Path) -> str:
    """Say which suffix a path has, for messages."""
    return f"found '{path.suffix}'" if path.suffix else "found no suffix"


def parts_beside(path: Path) -> list[Path]:
    """List the files beside a mesh or clip that its geometry, materials or layers are in; textures are left out.

    A layer of USD may name any other, so all in its folder are listed. A file that cannot be read has none.
    """
    from .obj import library_names

    folder, suffix = path.parent, path.suffix.lower()
    if suffix == ".obj":
        lines = [line for line in path.read_bytes().splitlines() if line.lstrip().startswith(b"mtllib")]
        names = library_names(lines, range(len(lines)), folder)
    elif suffix == ".gltf":
        try:
            uris = [buffer.get("uri", "data:") for buffer in json.loads(path.read_bytes())["buffers"]]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return []
        found = [find_beside(folder, (unquote(uri), uri)) for uri in uris if not uri.startswith("data:")]
        names = [name for name in found if name]
    elif suffix == CACHE:
        names = [path.stem + other for other in FRAME_SUFFIXES]
    elif suffix in (layers := [known for known in MESH_READERS if known.startswith(".usd")]):
        names = [file.name for file in folder.glob("*") if file.suffix.lower() in layers and file != path]
    else:
        return []
    return sorted(folder / name for name in names)
