"""Read and write meshes and clips in any format; `formats` maps suffixes to the functions of each format.

Everything that is read is validated here. `save_mesh` writes the identity's original file with other points whenever
the output has its suffix. Clips are read and written frame by frame, so that memory does not grow with their length.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..core.animated_rig import AnimatedRig, RigAnimation
from ..core.arguments import public
from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.mesh import (
    Clip,
    Mesh,
    check_clip,
    check_frames,
    check_mesh,
    check_numbers,
    check_timing,
    cut_clip,
    with_printable_names,
)
from ..core.output_size import check_output_size, frames_size
from ..core.system import refuse_pipe
from .atomic import together, whole_file, writing
from .bvh_write import save_bvh as save_bvh
from .formats import (
    ANIMATED,
    BODY_MODELS,
    CACHES,
    CLIP_READERS,
    CLIP_WRITERS,
    COLLECTIONS,
    FRAME_SUFFIXES,
    JOINTED,
    MESH_READERS,
    MESH_WRITERS,
    MOTIONS,
    gltf_file,
)
from .frame_folder import read_frame, read_sequence, write_sequence
from .mtl import copy_companions
from .obj_source import ObjSource
from .ply import PlySource
from .timing import DEFAULT_FPS, HIGHEST_FPS

if TYPE_CHECKING:
    from ..motions.bone_motion import BoneMotion
    from .gltf.own_animation import OwnAnimation, PlayedAnimation


@public()
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
        return _single_frame(load_clip(path), path)
    if path.suffix.lower() not in MESH_READERS:
        raise InputError(
            f"{path}: expected one of {' '.join(sorted(MESH_READERS.keys() | CLIP_READERS))}, {_found(path)}; "
            "save it as one of these first, with Blender for example"
        )
    reader = MESH_READERS[path.suffix.lower()]
    with _reading(path):
        mesh = reader(path)
    return check_mesh(mesh, path)


@public(once_positional=("fps", "animation", "progress", "frames"))
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
        fps: frames per second, overriding the file's own rate; without either it is 30. Files with times (glTF, USD,
            Alembic, MDD, motions) are resampled at it and keep their duration; others (folders, NPZ, NPY, PC2) are
            played at it.
        animation: name or number of an animation of a glTF file, None: the first, with those that move other nodes; or
            of a clip of an HDF5 file, None: the only one.
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
    path, animation = Path(path), None if animation is None else str(animation)
    _check_clip_options(path, fps, animation)
    _must_exist(path)
    if frames == slice(None):
        return _whole_clip(path, fps, animation, progress)
    from ..motions.on_body import is_motion_file, motion_file_clip

    if path.is_file():
        with _reading(path):
            if is_motion_file(path):
                return check_clip(motion_file_clip(path, fps, progress, frames), path)
    clip = _whole_clip(path, fps, animation, progress)
    return cut_clip(clip, frames.start or 0, frames.stop, 1 if frames.step is None else frames.step)


def _whole_clip(path: Path, fps: float | None, animation: str | None, progress: Progress | None) -> Clip:
    """Read all frames of a clip."""
    if path.is_dir():
        with _reading(path):
            clip = read_sequence(
                path, fps or DEFAULT_FPS, MESH_READERS.keys() - MOTIONS - BODY_MODELS, _load_frame, progress
            )
        # The clip takes the name of the folder, not that of its first frame.
        return check_clip(dataclasses.replace(clip, mesh=dataclasses.replace(clip.mesh, name=path.name)), path)
    if path.suffix.lower() in COLLECTIONS:
        from .hdf5 import read_hdf5_clip

        with _reading(path):
            return check_clip(read_hdf5_clip(path, fps, animation, progress), path)
    if path.suffix.lower() in CLIP_READERS:
        with _reading(path):
            return check_clip(CLIP_READERS[path.suffix.lower()](path, fps, progress), path)
    if path.suffix.lower() in ANIMATED:
        from .gltf import read_gltf_clip

        with _reading(path):
            return check_clip(read_gltf_clip(path, fps, animation, progress), path)
    mesh = load_mesh(path)
    return Clip(mesh, mesh.vertices[None], fps or DEFAULT_FPS)


def load_points(path: str | Path, first: Mesh, first_path: Path) -> Float[np.ndarray, "V 3"]:
    """Read the vertices of a mesh that must have the topology of a first one; quick for OBJ and PLY files.

    Raises:
        InputError: as `load_mesh`, or another topology.
    """
    path = Path(path)
    _must_exist(path)
    with _reading(path):
        return read_frame(path, first, first_path, _load_frame)


@public(once_positional=("fps", "animation", "progress"))
def load_recorded_clip(
    path: str | Path,
    body_model: str | Path,
    *,
    fps: float | None = None,
    animation: str | None = None,
    progress: Progress | None = None,
) -> tuple[Clip, tuple[str, ...]]:
    """Read recorded parameters of a body model as a clip of the recorded surface; see `motions.smpl_clip`.

    Args:
        path: an AMASS archive (.npz), or a pickle (.pkl) of `pose`, `betas` and `trans`.
        body_model: file of the model, .pkl or .npz in SMPL's layout.
        fps: frame rate at which the recording is resampled; None: its own.
        animation: refused, as such files have one clip.
        progress: called with (frames read, frames in all).

    Returns:
        The clip, y up and in metres for AMASS, and notes on what the model or the file lacks.

    Raises:
        InputError: one of the files cannot be used.
    """
    path = Path(path)
    _check_clip_options(path, fps, animation)
    return _recorded(path, Path(body_model), fps, progress)


def load_recorded_mesh(path: str | Path, body_model: str | Path) -> tuple[Mesh, tuple[str, ...]]:
    """Read the first frame of `load_recorded_clip` as a mesh, without computing the others; returns notes as well.

    Raises:
        InputError: one of the files cannot be used.
    """
    clip, notes = _recorded(Path(path), Path(body_model), first_alone=True)
    return clip.mesh, notes


def _recorded(
    path: Path,
    body_model: Path,
    fps: float | None = None,
    progress: Progress | None = None,
    first_alone: bool = False,
) -> tuple[Clip, tuple[str, ...]]:
    """Read a body model and what was recorded with it."""
    from ..bodies.smpl_model import load_smpl_model
    from ..motions.smpl_clip import recorded_clip

    _must_exist(path)
    _must_exist(body_model)
    with _reading(body_model):
        model = load_smpl_model(body_model)
    with _reading(path):
        clip, notes = recorded_clip(path, model, fps, progress, first_alone)
    return check_clip(clip, path), notes


def list_animations(path: str | Path) -> tuple[str, ...]:
    """List the names of the animations of a glTF file or an .fbx; their number stands for a missing name.

    Of an HDF5 file its clips. Empty for other formats, which have one clip at most, and for folders.

    Raises:
        InputError: no such file, or a damaged one.
    """
    path = Path(path)
    _must_exist(path)
    if path.is_file() and path.suffix.lower() in COLLECTIONS:
        from .hdf5 import clip_lengths

        with _reading(path):
            return tuple(clip_lengths(path))
    if path.is_dir() or path.suffix.lower() not in ANIMATED:
        return ()
    from .gltf.animation import animation_names
    from .gltf.document import open_document

    with _reading(path):
        return animation_names(open_document(path))


@public()
def save_mesh(mesh: Mesh, path: str | Path) -> None:
    """Write a mesh atomically; with the suffix of the file it was read from, as that file with other points.

    Polygons, texture coordinates, materials, groups, comments and order are then unchanged, and the material libraries
    and images that it refers to are copied beside it unless files of these names exist. With another suffix a new file
    is written, of polygons where the format has them, else of triangles.

    Args:
        mesh: the mesh; its axes and unit are not changed.
        path: the file; folders that do not exist are made.

    Raises:
        InputError: a format that cannot be written, a path that cannot be written to, or a mesh with coordinates that
            are not finite or with indices of vertices that it does not have.

    Example:
        >>> mimesh.save_mesh(mimesh.load_mesh("hero.glb"), "hero.ply")
    """
    check_numbers(mesh, mesh.name)
    path, mesh = Path(path), with_printable_names(mesh)
    if mesh.source is not None and mesh.source.suffix == path.suffix.lower():
        with writing(path), together():
            with whole_file(path) as temporary:
                mesh.source.write(mesh, temporary)
            _copy_companions(mesh, path.parent)
    else:
        if path.suffix.lower() not in MESH_WRITERS:
            raise InputError(
                f"{path}: expected an output in one of {' '.join(MESH_WRITERS)}, {_found(path)}; name another"
            )
        writer = MESH_WRITERS[path.suffix.lower()]
        with writing(path), together():
            writer(mesh, path)


@public(once_positional=("suffix", "progress", "blendshapes"))
def save_clip(
    clip: Clip,
    path: str | Path,
    *,
    suffix: str | None = None,
    progress: Progress | None = None,
    blendshapes: int | None = None,
) -> float | None:
    """Write a clip as one file or, for a path without a suffix, as a folder of numbered meshes.

    Args:
        clip: the clip; its axes and unit are not changed.
        path: the file, or a folder; folders that do not exist are made.
        suffix: format of the frames in a folder, .obj or .ply; by default that of the mesh's source, else .obj.
        progress: called with (frames written, frames in all).
        blendshapes: number of morph targets (.glb, .gltf), instead of one per frame; see `gltf.write_gltf_clip`.

    Returns:
        With `blendshapes`, the largest distance of a vertex from its position in the clip, in the mesh's unit.

    Raises:
        InputError: a format that cannot contain a clip, a path that cannot be written to, or a clip without frames or
            with an impossible frame rate.

    Example:
        >>> mimesh.save_clip(mimesh.load_clip("walk.npz"), "walk.glb")
    """
    check_timing(clip, clip.mesh.name, "give it one: dataclasses.replace(clip, fps=30.0)")
    check_numbers(clip.mesh, clip.mesh.name)
    check_frames(clip, clip.mesh.name)
    path, clip = Path(path), dataclasses.replace(clip, mesh=with_printable_names(clip.mesh))
    is_folder = path.is_dir() or not path.suffix
    if blendshapes is not None:
        return _save_blend_shapes(clip, path, progress, blendshapes)
    if is_folder:
        _save_folder(clip, path, suffix, progress)
        return None
    if path.suffix.lower() not in CLIP_WRITERS:
        raise InputError(
            f"{path}: expected a clip format ({' '.join(CLIP_WRITERS)}) or a folder, found '{path.suffix}'; "
            f"write {path.with_suffix('.glb').name}, or {path.stem} for a folder of one mesh per frame"
        )
    check_clip_output_size(clip, path, path.suffix)
    mesh_path = _mesh_path_of_cache(clip, path) if path.suffix.lower() in CACHES else None
    with writing(path), together():
        CLIP_WRITERS[path.suffix.lower()](clip, path, progress)
        if mesh_path is not None:
            save_mesh(clip.mesh.with_vertices(clip.vertices[0].astype(np.float64)), mesh_path)
    return None


def check_clip_output_size(clip: Clip, path: Path, suffix: str) -> None:
    """Check the expected size of a clip that is written frame by frame; see `core.output_size`.

    Raises:
        InputError: outputs are limited, and it is too large.
    """
    joints = ", write joints (.glb of mime without --morphs)" if suffix in (*JOINTED, *CACHES, ".npz") else ""
    advice = f"take fewer frames with --step, --start or --stop{joints}"
    check_output_size(frames_size(suffix, len(clip.mesh.vertices), len(clip)), path, advice)


def _save_folder(clip: Clip, path: Path, suffix: str | None, progress: Progress | None) -> None:
    """Write a clip as a folder of numbered meshes, with the files that the mesh's source refers to."""
    source_suffix = clip.mesh.source.suffix if clip.mesh.source else ""
    suffix = suffix or (source_suffix if source_suffix in FRAME_SUFFIXES else FRAME_SUFFIXES[0])
    if suffix not in FRAME_SUFFIXES:
        raise InputError(
            f"{path}: expected frames of {' or '.join(FRAME_SUFFIXES)}, found '{suffix}'; choose one of them"
        )
    if path.is_file():
        raise InputError(f"{path}: expected a folder to write frames to, found a file; choose another name")
    check_clip_output_size(clip, path, suffix)
    with writing(path), together():
        write_sequence(clip, path, suffix, MESH_WRITERS[suffix], load_mesh, progress)
        if source_suffix == suffix:
            _copy_companions(clip.mesh, path)


def _save_blend_shapes(clip: Clip, path: Path, progress: Progress | None, blendshapes: int) -> float | None:
    """Write a clip as glTF with a given number of morph targets; return the largest error, in the mesh's unit."""
    from .gltf import write_gltf_clip

    if path.suffix.lower() not in (".glb", ".gltf"):
        raise InputError(f"{path}: expected .glb or .gltf for --blendshapes, found '{path.suffix}'; leave it out")
    with writing(path), whole_file(path) as temporary:
        return write_gltf_clip(clip, temporary, progress, blendshapes)


def save_skinned(skeleton: AnimatedRig, fps: float, path: str | Path) -> None:
    """Write a skinned mesh with its skeleton's animation as .glb, .gltf or .fbx; see `save_rig_animations`."""
    save_rig_animations([RigAnimation(skeleton.mesh.name, skeleton, fps)], path)


def save_rig_animations(animations: Sequence[RigAnimation], path: str | Path) -> list[AnimatedRig]:
    """Write a skinned mesh with one or more animations of its rig as .glb, .gltf or .fbx (see `gltf.skinned`).

    Args:
        animations: of one rig: they have the same mesh, joints, weights and rest pose.

    Returns:
        The motions as the file plays them, which has fewer keys.

    Raises:
        InputError: another format, or a path that cannot be written to.
    """
    from .gltf.skinned import write_gltf_skinned

    path = Path(path)
    refuse_vrm(path)
    _must_hold_joints(path)
    with writing(path), gltf_file(path) as temporary:
        return write_gltf_skinned(animations, temporary)


def save_own_animations(animations: Sequence[OwnAnimation], path: str | Path) -> list[PlayedAnimation]:
    """Write the own glTF file of an identity with new animations of its own bones; returns these as they are played.

    Raises:
        InputError: another format, or a path that cannot be written to.
    """
    from .gltf.own_animation import write_own_animations

    path = Path(path)
    refuse_vrm(path)
    _must_hold_joints(path)
    with writing(path), gltf_file(path) as temporary:
        return write_own_animations(animations, temporary)


def save_own_pose(animation: OwnAnimation, path: str | Path) -> None:
    """Write the own glTF file of an identity with its bones in the first frame of an animation.

    Raises:
        InputError: another format, or a path that cannot be written to.
    """
    from .gltf.own_animation import write_own_pose

    path = Path(path)
    _must_hold_joints(path)
    with writing(path), gltf_file(path) as temporary:
        write_own_pose(animation, temporary)


def save_vrma(motions: Sequence[BoneMotion], path: str | Path) -> None:
    """Write motions of the humanoid bones of one skeleton as a VRM animation (.vrma).

    Raises:
        InputError: another format, or a path that cannot be written to.
    """
    from .gltf.vrma import write_vrma

    path = Path(path)
    if path.suffix.lower() != ".vrma":
        raise InputError(f"{path}: expected .vrma for bones alone, found '{path.suffix}'; name another with -o")
    with writing(path), whole_file(path) as temporary:
        write_vrma(motions, temporary)


def refuse_vrm(path: str | Path) -> None:
    """Raise InputError for an animation in a .vrm: the specifications of VRM have none in it (see `gltf.vrm`)."""
    path = Path(path)
    if path.suffix.lower() == ".vrm":
        raise InputError(
            f"{path}: expected a format for an animation, found .vrm, which holds none by its specification; "
            f"write {path.with_suffix('.vrma').name} (the motion alone) or {path.with_suffix('.glb').name}"
        )


def save_as_fbx(source: Path, path: Path) -> None:
    """Write a .glb, .gltf, .vrm or .fbx again as .fbx, with its skins, blend shapes and all its animations.

    Raises:
        InputError: a damaged file, no Blender, or a path that cannot be written to.
    """
    from .gltf.document import open_document
    from .gltf.draft import AccessorCopier

    with writing(path), gltf_file(path) as temporary:
        AccessorCopier(open_document(source), whole=True).draft.save(temporary)


def check_writable(path: Path) -> None:
    """Check that the program that writes a format is installed, before the work is done.

    Raises:
        InputError: an .fbx, and no Blender.
    """
    if path.suffix.lower() == ".fbx":
        from .fbx.write import find_blender

        find_blender(path)


def _must_hold_joints(path: Path) -> None:
    if path.suffix.lower() not in JOINTED:
        raise InputError(
            f"{path}: expected .glb, .gltf or .fbx for joints, found '{path.suffix}'; name another with -o"
        )


def mesh_suffixes() -> tuple[str, ...]:
    """Return the suffixes that `load_mesh` reads, with their dot."""
    return tuple(MESH_READERS)


def clip_suffixes() -> tuple[str, ...]:
    """Return the suffixes that `save_clip` writes as one file, with their dot."""
    return tuple(CLIP_WRITERS)


def _check_clip_options(path: Path, fps: float | None, animation: str | None) -> None:
    """Raise InputError for an animation of a format without animations, or an impossible frame rate."""
    several = (*ANIMATED, *COLLECTIONS)
    if animation is not None and path.suffix.lower() not in several:
        raise InputError(
            f"{path}: expected {' or '.join(several)} with --animation, found '{path.suffix}'; leave it out"
        )
    if fps is not None and not fps > 0:
        raise InputError(f"{path}: expected a positive frame rate, found {fps:g}; give another with --fps")
    if fps is not None and fps > HIGHEST_FPS:
        raise InputError(
            f"{path}: expected a frame rate of {HIGHEST_FPS:,.0f} or less, found {fps:g}; give another with --fps"
        )


def _load_frame(path: Path) -> Mesh:
    """Read one mesh of a folder of frames; raises InputError for a glTF file of joints without a mesh."""
    mesh = load_mesh(path)
    if path.suffix.lower() in ANIMATED and mesh.source is None:
        raise InputError(f"{path}: expected a mesh as a frame of a clip, found joints that move; give that file alone")
    return mesh


def _single_frame(clip: Clip, path: Path) -> Mesh:
    """Return the mesh of a clip of one frame; raises InputError for several frames."""
    if len(clip) > 1:
        raise InputError(
            f"{path}: expected one mesh, found a clip of {len(clip)} frames; "
            "give it as the driving clip or save one frame"
        )
    return clip.mesh


def _mesh_path_of_cache(clip: Clip, path: Path) -> Path | None:
    """Return where to write the mesh of a point cache; None where a mesh of its topology exists there already.

    Raises:
        InputError: another mesh has that name.
    """
    source_suffix = clip.mesh.source.suffix if clip.mesh.source else ""
    mesh_path = path.with_suffix(source_suffix if source_suffix in FRAME_SUFFIXES else FRAME_SUFFIXES[0])
    if not mesh_path.exists():
        return mesh_path
    existing = load_mesh(mesh_path)
    if len(existing.vertices) != len(clip.mesh.vertices) or not np.array_equal(existing.faces, clip.mesh.faces):
        raise InputError(
            f"{path}: expected {mesh_path.name} to be the mesh it belongs to, found another there; choose another name"
        )
    return None


def _must_exist(path: Path) -> None:
    if not path.exists():
        raise InputError(f"{path}: expected a file or folder, found nothing of that name; check the path")
    refuse_pipe(path)


def _found(path: Path) -> str:
    return f"found '{path.suffix}'" if path.suffix else "found no suffix"


def _copy_companions(mesh: Mesh, folder: Path) -> None:
    if isinstance(mesh.source, ObjSource | PlySource):
        copy_companions(mesh.source.companions, mesh.source.path.parent, folder)


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn a failed read into an InputError of one line that names the cause; an empty file is refused at once.

    NumPy does not warn of the numbers of a damaged file, which may be NaN or huge: what is read is checked in the end.
    """
    try:
        if path.is_file() and path.stat().st_size == 0:
            raise InputError(f"{path}: expected a mesh, found an empty file of 0 bytes; export it again")
        with np.errstate(all="ignore"):
            yield
    except UnicodeEncodeError as error:
        raise InputError(
            f"{path}: expected a path of text for {path.suffix}, found bytes that are none; choose another name"
        ) from error
    except MemoryError as error:
        raise InputError(
            f"{path}: expected a file that fits into memory, found a larger one; split it, or take fewer frames"
        ) from error
    except OSError as error:
        raise InputError(
            f"{path}: expected a readable file, found '{error.strerror}'; check its permissions"
        ) from error
