"""Writes results as files to download: a single file as it is, several (images, frames, many meshes) as a .zip."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.options import Layout
from ..io import check_writable, save_mesh
from ..io.atomic import whole_file
from ..io.formats import CLIP_WRITERS, FORMATS, FRAME_SUFFIXES, JOINTED, MESH_WRITERS
from ..pipeline.result import ClipResult
from ..pipeline.skinned import AS_IT_IS, save_skinned
from ..pipeline.vrma import check_bones_layout
from ..tools.convert import BONES_ONLY, blend_note, not_kept, part, rate_note, resampled_note, skinned_note
from ..view.movie import MOVIES
from .uploads import safe_name

MAX_EXPORTS = 12
"""Number of exports that are stored; older ones are deleted."""
FRAMES = tuple(f"frames{suffix}" for suffix in FRAME_SUFFIXES)
"""Formats that are folders of numbered meshes."""
NEEDS = {suffix: ("pxr", "usd") for suffix in (".usd", ".usda", ".usdc", ".usdz")}
NEEDS |= {".abc": ("alembic3d", "alembic"), ".mp4": ("av", "video")}
"""Module that a format needs, and the extra of mimesh that installs it."""
SHAPED = (".glb", ".gltf")
"""Formats to which a number of blend shapes can be given."""
FORMAT_NAMES = {
    **{suffix: format.name for suffix, format in FORMATS.items()},
    **{f"frames{suffix}": f"{FORMATS[suffix].name} frames" for suffix in FRAME_SUFFIXES},
    ".gif": "GIF, a movie",
    ".mp4": "MP4, a movie",
    ".webp": "WebP, a movie",
}
"""Names of the formats on the page."""


@dataclass(eq=False)
class Export:
    """A file to download, while it is written and afterwards."""

    number: int
    suffix: str
    """Format: a suffix of io.formats or render.movie, or one of FRAMES."""
    skinned: bool
    blendshapes: int | None
    """Number of morph targets; None for one per frame."""
    layout: Layout
    """Names and arrangement of the bones."""
    folder: Path
    """Where it is written; deleted with the export."""
    path: Path | None = None
    """None until it is complete."""
    progress: float = 0.0
    """Written share, 0 to 1."""
    error: str = ""
    notes: tuple[str, ...] = ()


def formats(moving: bool) -> list[dict[str, str | bool]]:
    """List the formats for clips (`moving`) or poses; `needs` names what has to be installed for one, or is ""."""
    first = (".glb", ".fbx", BONES_ONLY) if moving else (".glb", ".obj")
    known = (*CLIP_WRITERS, *FRAMES, *MOVIES) if moving else tuple(MESH_WRITERS)
    return [_format(suffix) for suffix in dict.fromkeys((*first, *known))]


def write(export: Export, results: list[tuple[str, str, ClipResult]], progress: Progress) -> Path:
    """Write results, each with the names of its mesh and of the driving clip, and return the one file to download.

    Raises:
        InputError: a format or option that is not possible for these results.
    """
    _check(export, results)
    # Written to a folder first: how many files a format makes depends on the mesh (textures, frames).
    files_folder, notes, used = export.folder / "files", [], set()
    for k, (mesh, driving, result) in enumerate(results):
        stem = _unused(safe_name(f"{Path(mesh).stem}-{driving}"), used)
        report = part(progress, k, len(results)) or progress
        notes += _write_one(export, result, driving, files_folder / stem, report)
    export.notes = tuple(dict.fromkeys(notes))
    files = sorted(path for path in files_folder.rglob("*") if path.is_file())
    if len(files) == 1:
        return files[0]
    stem = sorted(used)[0] if len(results) == 1 else f"{len(results)} meshes"
    return _zip(files, files_folder, export.folder / f"{stem}.zip")


def _write_one(export: Export, result: ClipResult, driving: str, target: Path, progress: Progress) -> list[str]:
    """Write one result and return notes on what the format leaves out.

    Args:
        driving: name of the driving clip, which an animation of bones gets.
        target: the file without its suffix, or the folder of frames.
    """
    path = target if export.suffix in FRAMES else target.with_name(f"{target.name}{export.suffix}")
    jointed = export.skinned or export.suffix == BONES_ONLY
    if len(result.frames) == 1 and not jointed:
        save_mesh(result.mesh, path)
        return list(not_kept(result.mesh, path))
    if export.suffix in FRAMES:
        from ..io import save_clip

        save_clip(result.clip, path, suffix=export.suffix.removeprefix("frames"), progress=progress)
    elif jointed:
        save_skinned([result], path, animations=[driving], layout=export.layout)
    else:
        result.save(path, blendshapes=export.blendshapes, progress=progress)
    blend_notes = blend_note(result.report.get("blendshapes_deviation")) if export.blendshapes else ()
    joint_notes = skinned_note(result.report) if jointed else ()
    if jointed:
        joint_notes += resampled_note(len(result.frames), result.fps, export.layout.fps)
    return [*not_kept(result.mesh, path), *rate_note(result.fps, path), *blend_notes, *joint_notes]


def _check(export: Export, results: list[tuple[str, str, ClipResult]]) -> None:
    if not results:
        raise InputError("export: expected a result, found none; add a mesh to move and a driving motion")
    moving = len(results[0][2].frames) > 1
    suffixes = [entry["suffix"] for entry in formats(moving)]
    if export.suffix not in suffixes:
        raise InputError(f"format: expected one of {' '.join(map(str, suffixes))}, found {export.suffix!r}; choose one")
    layout, file = export.layout, Path(f"{results[0][0]}{export.suffix}")
    if export.suffix == BONES_ONLY:
        check_bones_layout(layout, file)
    elif (export.skinned or layout != AS_IT_IS) and export.suffix not in JOINTED:
        raise InputError(f"{export.suffix}: expected .glb, .gltf or .fbx for bones, found this; choose one")
    elif layout != AS_IT_IS and not export.skinned:
        raise InputError("bone names, root bone, rest pose, frame rate: expected with bones, found without; add bones")
    if export.blendshapes and export.suffix not in SHAPED:
        raise InputError(f"{export.suffix}: expected .glb or .gltf for blend shapes, found this; choose one")


def _format(suffix: str) -> dict[str, str | bool]:
    """Describe a format: whether it has bones, always (`bones`) or by choice, and takes a number of blend shapes."""
    return {
        "suffix": suffix,
        "words": FORMAT_NAMES[suffix],
        "needs": _lacking(suffix),
        "joints": suffix in JOINTED,
        "bones": suffix == BONES_ONLY,
        "shapes": suffix in SHAPED,
    }


def _lacking(suffix: str) -> str:
    """Name what has to be installed before a format can be written; "" if nothing is missing."""
    module, extra = NEEDS.get(suffix, ("", ""))
    if module and find_spec(module) is None:
        return f"pip install 'mimesh[{extra}]'"
    try:
        check_writable(Path(f"clip{suffix}"))
    except InputError:
        return "Blender"
    return ""


def _unused(stem: str, used: set[str]) -> str:
    """Return a stem that is not in `used`, with a number if needed, and add it there."""
    name = next(name for k in range(len(used) + 1) if (name := stem if k == 0 else f"{stem}-{k + 1}") not in used)
    used.add(name)
    return name


def _zip(files: list[Path], top: Path, path: Path) -> Path:
    """Pack files into an archive, with paths relative to `top`."""
    with whole_file(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as pack:
        for file in files:
            pack.write(file, file.relative_to(top))
    return path
