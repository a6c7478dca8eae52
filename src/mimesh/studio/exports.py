"""Writes results, rigs and motions as files to download: one as it is, several (images, frames, meshes) as a .zip."""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from ..core.animated_rig import INFLUENCES
from ..core.errors import InputError
from ..core.frame_buffer import Progress, part
from ..core.options import Layout
from ..core.printable import numbered
from ..io import check_writable, save_mesh
from ..io.atomic import whole_file
from ..io.formats import CLIP_WRITERS, FORMATS, FRAME_SUFFIXES, JOINTED, MESH_WRITERS
from ..pipeline.capturing import JOINT_FILES
from ..pipeline.result import ClipResult
from ..pipeline.skinned import AS_IT_IS, save_skinned
from ..pipeline.vrm import check_bones_layout
from ..tools.convert import BONES_ONLY
from ..tools.notes import not_kept, rate_note, resampled_note, skinned_note
from ..view.movie import MOVIES
from .items import Item, Options, finished_result
from .operations import capture_driving, rig_mesh
from .uploads import safe_name

MAX_EXPORTS = 12
"""Number of exports that are stored; older ones are deleted."""
FRAMES = tuple(f"frames{suffix}" for suffix in FRAME_SUFFIXES)
"""Formats that are folders of numbered meshes."""
NEEDS = {suffix: ("pxr", "usd") for suffix in (".usd", ".usda", ".usdc", ".usdz")}
NEEDS[".mp4"] = ("av", "video")
"""Module that a format needs, and the extra of mimesh that installs it."""
FORMAT_NAMES = {
    **{suffix: format.name for suffix, format in FORMATS.items()},
    **{f"frames{suffix}": f"{FORMATS[suffix].name} frames" for suffix in FRAME_SUFFIXES},
    ".gif": "GIF, a movie",
    ".mp4": "MP4, a movie",
    ".webp": "WebP, a movie",
}
"""Names of the formats on the page."""


NEEDED = {"result": "a mesh to move and a driving motion", "rig": "a mesh to move", "motion": "a driving motion"}
"""What can be exported, and what it is made of: moved meshes, meshes at rest with bones, the joints of the driving."""
WritePart = Callable[[Path, Progress], Sequence[str]]
"""Writes one mesh or motion to a path, given without its suffix, and returns notes."""


@dataclass(frozen=True, kw_only=True)
class Order:
    """What the page asks to be written."""

    what: str = "result"
    """One of NEEDED."""
    suffix: str = ".glb"
    """Format: a suffix of io.formats or render.movie, or one of FRAMES."""
    skinned: bool = False
    """With joints; a rig always has them."""
    layout: Layout = AS_IT_IS
    """Names and arrangement of the bones."""
    influences: int = INFLUENCES
    """Weights a vertex of joints that were found."""
    author: str | None = None
    """Who made the character; only a .vrm has it, and the licence."""
    license: str | None = None


@dataclass(eq=False)
class Export:
    """A file to download, while it is written and afterwards."""

    number: int
    order: Order
    folder: Path
    """Where it is written; deleted with the export."""
    path: Path | None = None
    """None until it is complete."""
    progress: float = 0.0
    """Written share, 0 to 1."""
    error: str = ""
    notes: tuple[str, ...] = ()


def formats(what: str, moving: bool) -> list[dict[str, str | bool]]:
    """List the formats of results, of clips (`moving`) or poses, of rigs or of motions.

    In each, `needs` names what has to be installed for it, or is "".
    """
    if what == "result":
        first = (".glb", ".fbx", BONES_ONLY) if moving else (".glb", ".obj")
        known = (*CLIP_WRITERS, *FRAMES, *MOVIES) if moving else tuple(MESH_WRITERS)
    else:
        first, known = (), JOINTED if what == "rig" else JOINT_FILES
    return [_format(suffix) for suffix in dict.fromkeys((*first, *known))]


def write(export: Export, items: Sequence[Item], driving: Item | None, options: Options, progress: Progress) -> Path:
    """Write the results or rigs of meshes, or the motion of the driving clip, and return the one file to download."""
    order = export.order
    if (driving is None and order.what != "rig") or (not items and order.what != "motion"):
        raise InputError(f"export: expected {NEEDED[order.what]}, found none; add what is missing")
    moving = order.what == "result" and any(len(finished_result(item).frames) > 1 for item in items)
    suffixes = [str(entry["suffix"]) for entry in formats(order.what, moving)]
    if order.suffix not in suffixes:
        raise InputError(f"format: expected one of {' '.join(suffixes)}, found {order.suffix!r}; choose one")
    parts = _parts(order, items, driving, options)
    # Written to a folder first: how many files a format makes depends on the mesh (textures, frames).
    files_folder, notes, used = export.folder / "files", [], set()
    for k, (name, write_part) in enumerate(parts):
        stem = next(free for free in numbered(safe_name(name)) if free not in used)
        used.add(stem)
        notes += write_part(files_folder / stem, part(progress, k, len(parts)) or progress)
    export.notes = tuple(dict.fromkeys(notes))
    files = sorted(path for path in files_folder.rglob("*") if path.is_file())
    if len(files) == 1:
        return files[0]
    stem = sorted(used)[0] if len(parts) == 1 else f"{len(parts)} meshes"
    return _zip(files, files_folder, export.folder / f"{stem}.zip")


def _parts(order: Order, items: Sequence[Item], driving: Item | None, options: Options) -> list[tuple[str, WritePart]]:
    """List what is written: a name without a suffix, and the function that writes it."""
    if order.what == "rig" or driving is None:
        return [(f"{Path(item.name).stem}-rigged", partial(_write_rig, order, item, options)) for item in items]
    stem = Path(driving.name).stem
    if order.what == "motion":
        return [(stem, partial(_write_motion, order, driving, options))]
    _check(order, items[0].name)
    return [
        (f"{Path(item.name).stem}-{stem}", partial(_write_result, order, finished_result(item), stem)) for item in items
    ]


def _write_result(order: Order, result: ClipResult, driving: str, target: Path, progress: Progress) -> list[str]:
    """Write one result and return notes on what the format leaves out.

    Args:
        driving: name of the driving clip, which an animation of bones gets.
        target: the file without its suffix, or the folder of frames.
    """
    path = target if order.suffix in FRAMES else _with_suffix(target, order)
    jointed = order.skinned or order.suffix == BONES_ONLY
    if len(result.frames) == 1 and not jointed:
        save_mesh(result.mesh, path)
        return list(not_kept(result.identity or result.mesh, path, result.report.get("body")))
    if order.suffix in FRAMES:
        from ..io import save_clip

        save_clip(result.clip, path, suffix=order.suffix.removeprefix("frames"), progress=progress)
        written = ()
    elif jointed:
        skeleton = result.skeleton and dataclasses.replace(result.skeleton, influences=order.influences)
        limited = dataclasses.replace(result, skeleton=skeleton)
        (deviations,) = save_skinned([limited], path, animations=[driving], layout=order.layout).deviations
        written = skinned_note({**result.report, **deviations})
        written += resampled_note(len(result.frames), result.fps, order.layout.fps)
    else:
        result.save(path, progress=progress)
        written = ()
    return [
        *not_kept(result.identity or result.mesh, path, result.report.get("body")),
        *rate_note(result.fps, path),
        *written,
    ]


def _write_rig(order: Order, item: Item, options: Options, target: Path, progress: Progress) -> list[str]:
    rigged, path, layout = rig_mesh(item, options), _with_suffix(target, order), order.layout
    progress(1, 2)
    bones = {"names": layout.names, "root_bone": layout.root_bone, "rest": layout.rest}
    rigged.save(path, **bones, author=order.author, license=order.license, influences=order.influences)
    return [*rigged.notes, *not_kept(rigged.skeleton.mesh, path, rigged.body)]


def _write_motion(order: Order, driving: Item, options: Options, target: Path, progress: Progress) -> tuple[str, ...]:
    captured = capture_driving(driving, options, progress)
    captured.save(_with_suffix(target, order))
    return captured.notes


def _with_suffix(target: Path, order: Order) -> Path:
    return target.with_name(f"{target.name}{order.suffix}")  # names of meshes may contain dots


def _check(order: Order, name: str) -> None:
    suffix, layout = order.suffix, order.layout
    of_bones = layout != AS_IT_IS or order.influences != INFLUENCES
    if suffix == BONES_ONLY:
        check_bones_layout(layout, Path(f"{name}{suffix}"))
    elif (order.skinned or of_bones) and suffix not in JOINTED:
        raise InputError(f"{suffix}: expected .glb, .gltf or .fbx for bones, found this; choose one")
    elif of_bones and not order.skinned:
        fields = "bone names, root bone, rest pose, weights per vertex, frame rate"
        raise InputError(f"{fields}: expected with bones, found without; add bones")


def _format(suffix: str) -> dict[str, str | bool]:
    """Describe a format: whether it has bones, always (`bones`) or by choice."""
    return {
        "suffix": suffix,
        "words": FORMAT_NAMES[suffix],
        "needs": _lacking(suffix),
        "joints": suffix in JOINTED,
        "bones": suffix == BONES_ONLY,
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


def _zip(files: list[Path], top: Path, path: Path) -> Path:
    with whole_file(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as pack:
        for file in files:
            pack.write(file, file.relative_to(top))
    return path
