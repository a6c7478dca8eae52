"""From any file that is read to any that is written: `mimesh convert`, and where every result is saved."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh, cut_clip
from ..io import clip_suffixes, load_clip, load_mesh, save_mesh
from ..io.formats import FRAMES_ONLY, MESH_WRITERS, MOTIONS
from ..io.timing import DEFAULT_FPS
from ..render.movie import MOVIES, write_clip

RATELESS = (".npy", ".pc2")
"""Formats whose files, as folders of frames, do not say how fast they are."""
LARGE = 256 * 2**20
"""Bytes of a clip from which on a user is told how it gets smaller."""
POINTS = ("materials", "texture coordinates", "normals", "vertex colours")
LACKS = {suffix: POINTS for suffix in (".npz", ".off", ".stl")}
LACKS |= {".ply": ("materials", "texture coordinates", "normals")}
LACKS |= {".abc": ("colours of materials", "textures", "vertex colours")}
LACKS |= dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), ("vertex colours",))
"""Suffix -> what a new file of it does not hold, of what a Mesh has; caches of points have a mesh beside them."""


@dataclass(frozen=True)
class Converted:
    """What has been written."""

    vertices: int
    frames: int
    fps: float | None
    """None for a mesh that does not move."""
    notes: tuple[str, ...]


def convert(
    source: str | Path,
    target: str | Path,
    *,
    fps: float | None = None,
    animation: str | None = None,
    frame: int | None = None,
    start: int = 0,
    stop: int | None = None,
    step: int = 1,
    frames_as: str | None = None,
    blendshapes: int | None = None,
    progress: Progress | None = None,
) -> Converted:
    """Read a mesh, a clip or a folder of frames, and write it in the format of another name.

    What moves is written moving where the format can; a format of one mesh gets it at rest, or the `frame` that is
    chosen. The file's own format keeps all it holds, but for the points of a `frame`.

    Args:
        fps: as `load_clip`: files with times are sampled at it, others are played at it.
        frame: this one alone, counted from 0.
        frames_as: suffix of the frames in a folder.
        blendshapes: see `write_clip`.

    Raises:
        InputError: a file that cannot be read or written, or a frame that is not there.
    """
    source, target = Path(source), Path(target)
    suffix = target.suffix.lower()
    moving = suffix in (*clip_suffixes(), *MOVIES) or not suffix or target.is_dir()
    if frames_as is not None and suffix and not target.is_dir():
        raise InputError(f"{target}: expected a folder with --frames-as, found '{target.suffix}'; leave it out")
    cut = {"--start": start != 0, "--stop": stop is not None, "--step": step != 1}
    if frame is not None:
        _leave_out(target, cut | {"--blendshapes": blendshapes is not None}, "--frame takes one frame")
    elif not moving:
        _leave_out(target, {"--blendshapes": blendshapes is not None}, f"{suffix} files hold one mesh")
    if frame is None and not moving and source.is_file() and source.suffix.lower() not in FRAMES_ONLY:
        timed = {"--fps": fps is not None, "--animation": animation is not None}
        _leave_out(target, timed | cut, f"{suffix} files hold one mesh, at rest", " or choose a --frame")
        mesh = load_mesh(source)
        return _convert_mesh(mesh, target, notes=_at_rest_note(mesh, source, target))
    clip = load_clip(source, fps, animation, part(progress, 0, 2))
    if frame is not None:
        if not -len(clip) <= frame < len(clip):
            raise InputError(f"{source}: expected --frame below its {len(clip)} frames, found {frame}; change it")
        start, stop, step = frame, frame + 1 or None, 1
    clip = cut_clip(clip, start, stop, step)
    if (len(clip) == 1 and suffix in MESH_WRITERS) or not moving:
        return _convert_mesh(clip.mesh.with_vertices(clip.vertices[0].astype(np.float64)), target, len(clip))
    deviation = write_clip(clip, target, frames_as, blendshapes, part(progress, 1, 2))
    notes = not_kept(clip.mesh, target) + rate_note(clip.fps, target) + blend_note(deviation)
    if frame is None and animation is None:
        notes += animations_note(clip.mesh, source)
    return Converted(len(clip.mesh.vertices), len(clip), clip.fps, notes)


def blend_note(deviation: float | None) -> tuple[str, ...]:
    """What a user should know of a clip shown by few shapes."""
    if deviation is None:
        return ()
    return (f"with these blend shapes no vertex is farther than {deviation:.2g} of the mesh's size from its frame",)


def not_kept(mesh: Mesh, path: Path) -> tuple[str, ...]:
    """What a format that holds less than the mesh's file leaves behind, in words."""
    suffix = path.suffix.lower()
    if mesh.source is not None and mesh.source.suffix == suffix:
        return ()
    has = {
        "materials": any(one.material for one in mesh.parts),
        "colours of materials": any(one.material for one in mesh.parts),
        "textures": any(one.material and one.material.texture for one in mesh.parts),
        "texture coordinates": mesh.corner_uv is not None,
        "normals": mesh.corner_normals is not None,
        "vertex colours": mesh.vertex_colors is not None,
    }
    lost = [name for name in LACKS.get(suffix, ()) if has[name]]
    return (f"{suffix} files as written here hold no {' or '.join(lost)}: left out of {path.name}",) if lost else ()


def size_note(path: Path) -> tuple[str, ...]:
    """What to say of a clip whose file is large."""
    if not path.is_file() or (size := path.stat().st_size) < LARGE:
        return ()
    joints = ", and --skinned writes joints instead of frames" if path.suffix.lower() in (".glb", ".gltf") else ""
    return (f"{path.name} has {size / 2**20:,.0f} MiB: --step takes fewer frames{joints}",)


def rate_note(fps: float, path: Path) -> tuple[str, ...]:
    """What to say when a clip is read again from a format that knows no frame rate."""
    suffix = path.suffix.lower()
    if (suffix and suffix not in RATELESS) or fps == DEFAULT_FPS:
        return ()
    return (f"{suffix or 'folders of'} files know no frame rate: read {path.name} with --fps {fps:g}",)


def taken_rate_note(clip: Clip, path: Path) -> tuple[str, ...]:
    """What to say of a clip that is played at a rate which neither its files nor the user named."""
    if len(clip) == 1 or not (path.is_dir() or path.suffix.lower() in RATELESS):
        return ()
    return (f"{path.name} knows no frame rate: {clip.fps:g} frames a second are taken; --fps gives another",)


def frames_at(frames: int, fps: float) -> str:
    """How long a clip is, in words."""
    return f"{frames} {'frame' if frames == 1 else 'frames'} at {fps:g} per second"


def animations_note(mesh: Mesh, path: Path) -> tuple[str, ...]:
    """Which animation of several is taken where none is named."""
    names = getattr(mesh.source, "animations", ())  # glTF alone has several
    if len(names) < 2:
        return ()
    return (
        f"{path.name} has {len(names)} animations: {names[0]} is taken, with those that move other nodes; "
        "--animation takes another",
    )


def part(progress: Progress | None, number: int, parts: int) -> Progress | None:
    """The progress of one of several parts of equal weight, as progress of the whole."""
    return progress and (lambda done, total: progress(number * total + done, parts * total))


def _leave_out(target: Path, given: dict[str, bool], why: str, instead: str = "") -> None:
    """Refuse options that would change nothing."""
    found = [name for name, present in given.items() if present]
    if found:
        raise InputError(f"{target}: expected no {found[0]} ({why}), found it; leave it out{instead}")


def _at_rest_note(mesh: Mesh, source: Path, target: Path) -> tuple[str, ...]:
    if source.suffix.lower() in MOTIONS:
        return (f"{target.name} is the first frame; --frame takes another",)
    if getattr(mesh.source, "animations", ()):
        return (f"{target.name} is the mesh at rest; --frame takes a pose of its animation",)
    return ()


def _convert_mesh(mesh: Mesh, target: Path, frames: int = 1, notes: tuple[str, ...] = ()) -> Converted:
    save_mesh(mesh, target)
    notes += not_kept(mesh, target)
    if frames > 1:
        notes += (f"{target.suffix} files hold one mesh: {target.name} is the first of {frames} frames",)
    if mesh.source is None or mesh.source.suffix == target.suffix.lower():
        notes += tuple(getattr(mesh.source, "notes", ()))
    return Converted(len(mesh.vertices), 1, None, notes)
