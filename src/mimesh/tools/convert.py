"""Convert files between all formats (`mimesh convert`), choose and read driving clips, and note what is not kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import io
from ..core.animated_rig import RigAnimation
from ..core.errors import InputError, option
from ..core.frame_buffer import PosedFrames, Progress
from ..core.mesh import Clip, Mesh, RewritableSource, check_cut, cut_clip, stored_clip
from ..core.normalization import clear_up, parse_axis
from ..core.options import ConvertOptions
from ..io.beside import missing_images, missing_images_notes
from ..io.formats import CACHE, FORMATS, FRAMES_ONLY, JOINTED, MESH_WRITERS, MORPHED, MOTIONS
from ..io.polygons import smooth_normals
from ..io.timing import DEFAULT_FPS, ON_GRID, frame_count

if TYPE_CHECKING:
    from ..io.gltf.own_animation import OwnAnimation
    from ..pipeline.read import Told

USUAL = ConvertOptions()
ALL = "all"
"""Value of `--animation` for all animations of a file."""
BONES_ONLY = ".vrma"
"""Format that holds the motion of bones and no mesh."""
LARGE = 256 * 2**20
"""Bytes of a clip from which on a note says how to make it smaller."""
PERSON = (1.4, 2.1)
"""Longest side (metres) of a standing person, arms spread or not: smallest and largest."""
ANIMAL = {"m": 10.0, "cm": 500.0, "mm": 5000.0}
"""Unit -> longest side of an animal in it, at most."""
UNITS = (("m", 1.0), ("dm", 0.1), ("cm", 0.01), ("mm", 0.001), ("inch", 0.0254))
"""Names of units, and their length in metres."""
NOTED_LIMITING = 0.02
"""Distance over the mesh's size from which on a note tells the effect of four weights a vertex: that of 10 of 12
characters of the pool (train and val) is below, 0.002 to 0.013; means over all vertices are below 0.001 for all."""
NOTED_DEVIATION = 1e-3
"""Distance over the mesh's size of a skinned file's vertex from its frame, from which on a note tells it."""
DEVIATION_CAUSES = {
    "rest": ": the mesh is bound in another pose than the file's; that of the file is exact",
    "fingers": ": fingers that only other clips move follow the hand",
    "weights": ": files of joints have few weights a vertex",
}
"""What a note says about the `deviation_cause` of a report."""


@dataclass(frozen=True)
class Converted:
    """Facts about the file that `convert` has written."""

    vertices: int
    frames: int
    fps: float | None
    """Frames a second; None for a single mesh."""
    notes: tuple[str, ...]


def convert(
    source: str | Path, target: str | Path, options: ConvertOptions = USUAL, progress: Progress | None = None
) -> Converted:
    """Read a mesh, a clip or a folder of frames, and write it in the format of the target's suffix.

    A clip is written as a clip if the format allows; in a format of one mesh it becomes the mesh at rest, or a chosen
    `frame`. In the source's own format all contents of the file are kept, except that of a `frame` only points are.
    From any of .glb, .gltf, .fbx and .vrm to another bones, morph targets and animations are kept, too; captures of
    joints get the shipped body with its bones. Only `morphs` makes morph targets of frames.

    Args:
        target: the file to write, or without a suffix a folder of frames.
        progress: is called with the steps done and the steps in all.

    Raises:
        InputError: a file cannot be read or written, the frame does not exist, or options exclude each other.
    """
    from ..view.movie import MOVIES, write_clip

    source, target = Path(source), Path(target)
    suffix = target.suffix.lower()
    if suffix == BONES_ONLY:
        raise InputError(
            f"{target}: expected a mesh or a clip to write, found {suffix}, which has bones alone; write it with "
            f"mimesh animate CHARACTER {source.name} -o {target.name}"
        )
    holds_clip = suffix in (*io.clip_suffixes(), *MOVIES) or not suffix or target.is_dir()
    frames_as = None if options.frames_as is None else "." + options.frames_as.lstrip(".")
    if frames_as is not None and suffix and not target.is_dir():
        raise InputError(f"{target}: expected a folder with --frames-as, found '{target.suffix}'; leave it out")
    given = _check_options(options, target, holds_clip)
    io.check_writable(target)
    if keeps_bones(source, target, options):
        kept = _with_bones(source, target, options, given)
        if kept is not None:
            return kept
    if suffix == ".vrm":
        raise InputError(
            f"{target}: expected a person with bones, an author and a licence for {suffix}, found none of them; write "
            f"it with mimesh rig {source.name} -o {target.name} --author NAME --license URL"
        )
    # From mesh to mesh nothing is loaded as a clip, so that the file's own format can keep all its contents.
    has_rest = source.is_file() and source.suffix.lower() not in FRAMES_ONLY and options.body_model is None
    if options.frame is None and not holds_clip and has_rest:
        _refuse_options(target, given, f"{suffix} files hold one mesh, at rest", " or choose a --frame")
        mesh = _with_up(io.load_mesh(source), options.up, target)
        notes = _at_rest_note(mesh, source, target) + _bones_note(mesh, source, target)
        return _write_mesh(mesh, target, notes=notes)
    # Reading and writing are half of the progress each.
    chosen = options.slice if options.frame is None else slice(None)
    shape = None
    if options.betas is not None:
        from ..motions.amass import parse_betas

        shape = parse_betas(options.betas)
    read = options.body_model, options.fps, options.animation, part(progress, 0, 2), chosen, shape
    clip, notes = read_clip(source, *read)
    if options.frame is not None:
        frame = options.frame  # negative numbers count from the end
        if not -len(clip) <= frame < len(clip):
            raise InputError(f"{source}: expected --frame below its {len(clip)} frames, found {frame}; change it")
        clip = cut_clip(clip, frame, frame + 1 or None, 1)  # up to -1 + 1 = 0 would be nothing
    clip = dataclasses.replace(clip, mesh=_with_up(clip.mesh, options.up, target))
    if suffix in JOINTED and isinstance(clip.vertices, PosedFrames) and not frames_are_asked(options):
        from ..io.gltf.skinned import write_gltf_skinned
        from ..motions.on_body import played_rig

        body = RigAnimation(clip.mesh.name, played_rig(clip), clip.fps)
        with io.joints_file(target) as temporary:
            write_gltf_skinned([body], temporary)
        notes += (f"{target.name} is mimesh's own body on the bones of the motion; --morphs writes its surface alone",)
        return Converted(len(clip.mesh.vertices), len(clip), clip.fps, notes)
    if (len(clip) == 1 and suffix in MESH_WRITERS) or not holds_clip:
        return _write_mesh(clip.mesh.with_vertices(clip.vertices[0].astype(np.float64)), target, len(clip), notes)
    clip = stored_clip(clip)
    write_clip(clip, target, frames_as, part(progress, 1, 2))
    notes += (
        _bones_note(clip.mesh, source, target)
        + not_kept(clip.mesh, target)
        + _lying_note(clip.mesh, target)
        + rate_note(clip.fps, target)
    )
    if options.frame is None and options.animation is None:
        notes += animations_note(io.list_animations(source), source)
    notes += missing_images_notes(missing_images(clip.mesh))
    return Converted(len(clip.mesh.vertices), len(clip), clip.fps, notes)


def _with_up(mesh: Mesh, up: str | None, target: Path) -> Mesh:
    """Name the up axis of a mesh whose file defines none."""
    given = parse_axis(up, option("up"))
    if given is None:
        return mesh
    if mesh.up is not None:
        raise InputError(f"{mesh.name}: expected a file without an up axis for {option('up', given)}, found {mesh.up}")
    if target.suffix.lower() not in JOINTED:
        raise InputError(f"{target}: expected one of {' '.join(JOINTED)} for {option('up', given)}, which have y up")
    return dataclasses.replace(mesh, up=given)


def _lying_note(mesh: Mesh, path: Path) -> tuple[str, ...]:
    """Return a note that a figure lies in a format with y up, as far as its shape tells."""
    if mesh.up is not None or path.suffix.lower() not in JOINTED or not len(mesh.faces):
        return ()
    up = clear_up(mesh)
    if up in (None, "+y"):
        return ()
    return (f"{path.name} has y up, its shape looks like up {up}: {option('up', up)} turns it",)


def _check_options(options: ConvertOptions, target: Path, holds_clip: bool) -> list[str]:
    """Check that options do not exclude each other, and return those that choose among frames and animations."""
    cut = [f"--{name}" for name in ("start", "stop", "step") if getattr(options, name) != getattr(USUAL, name)]
    if options.betas is not None and options.body_model is None:
        raise InputError(f"--betas {options.betas}: expected it with --body-model, found it without; name the model")
    shapes = ["--morphs"] * options.morphs
    if options.morphs and target.suffix.lower() not in MORPHED:
        raise InputError(f"{target}: expected .glb or .gltf for --morphs, found '{target.suffix}'; leave it out")
    if options.frame is not None:
        _refuse_options(target, cut + shapes, "--frame takes one frame")
    elif not holds_clip:
        _refuse_options(target, shapes, f"{target.suffix.lower()} files hold one mesh")
    timed = [f"--{name}" for name in ("fps", "animation", "frame") if getattr(options, name) is not None]
    return timed + cut + shapes


def read_clip(
    path: Path,
    body_model: str | Path | None,
    fps: float | None,
    animation: str | None,
    progress: Progress | None = None,
    frames: slice = slice(None),
    betas: np.ndarray | None = None,
) -> tuple[Clip, tuple[str, ...]]:
    """Read a clip, or with a body model the recorded surface; returns notes as well."""
    if body_model is None:
        clip = io.load_driving(path, fps=fps, animation=animation, progress=progress, frames=frames)
        return clip, clip.notes
    clip, notes = io.load_recorded_clip(path, body_model, fps=fps, animation=animation, progress=progress, betas=betas)
    return cut_clip(clip, frames.start or 0, frames.stop, 1 if frames.step is None else frames.step), notes


@dataclass(frozen=True)
class DrivingClip:
    """A clip of a driving file: the whole file, or one of its animations."""

    path: Path
    animation: str | None
    """Name or number of the animation, as `io.load_clip` takes it; None: the first, with those that complement it."""
    name: str
    """Name of the animation in the result: that of the animation if the file has several, else that of the file."""
    animations: tuple[str, ...] = ()
    """Names of all animations of the file."""


def choose_clips(driving: Sequence[Path], selectors: Sequence[str] | None) -> list[DrivingClip]:
    """Choose clips of driving files, with distinct names.

    Args:
        selectors: names or numbers of animations, or ALL. Several of one file, one for each of several files in their
            order, or ALL once for all files; empty or None takes the default of each file.

    Raises:
        InputError: another number of selectors, no such animation, or a damaged file.
    """
    from ..pipeline.skinned import distinct_names

    chosen = list(selectors or ())
    if not chosen:
        pairs = [(path, None) for path in driving]
    elif len(driving) == 1:
        pairs = [(driving[0], selector) for selector in chosen]
    elif chosen == [ALL]:
        pairs = [(path, ALL) for path in driving]
    elif len(chosen) == len(driving):
        pairs = list(zip(driving, chosen, strict=True))
    else:
        raise InputError(
            f"{option('animation')}: expected one for each of {len(driving)} DRIVING, found {len(chosen)}; "
            f"give them in the order of the files, or {option('animation', ALL)} once"
        )
    clips = [clip for path, selector in pairs for clip in _clips_of(path, selector)]
    names = distinct_names([clip.name for clip in clips])
    return [dataclasses.replace(clip, name=name) for clip, name in zip(clips, names, strict=True)]


def _clips_of(path: Path, selector: str | None) -> Iterator[DrivingClip]:
    """Yield the clips of a file that one value of `--animation` chooses."""
    names = io.list_animations(path)
    if not names:  # reading the file refuses a selector
        yield DrivingClip(path, None if selector == ALL else selector, file_stem(path))
    elif selector is None:
        yield DrivingClip(path, None, _clip_name(path, names, 0) if len(names) > 1 else file_stem(path), names)
    else:
        from ..io.gltf.animation import find_animation

        numbers = range(len(names)) if selector == ALL else (find_animation(names, selector, path),)
        for number in numbers:
            # Of animations of one name only the number tells which is meant.
            exact = names[number] if names.count(names[number]) == 1 else str(number)
            yield DrivingClip(path, exact, _clip_name(path, names, number), names)


def file_stem(path: str | Path) -> str:
    """Return the name of a file without its suffix, or that of a folder, which may be given as "." or "walk/"."""
    resolved = Path(path).resolve()
    return resolved.name if resolved.is_dir() else resolved.stem


def _clip_name(path: Path, names: Sequence[str], number: int) -> str:
    """Return the name of an animation without what Blender puts before it ("Armature|"); the file's if it has none."""
    name = names[number].rpartition("|")[2]
    return file_stem(path) if name in ("", str(number)) else name


def read_driving(
    chosen: DrivingClip,
    body_model: str | Path | None,
    fps: float | None,
    frames: slice,
    progress: Progress | None = None,
    whole: bool = False,
    told: Told = (None, None, "auto"),
) -> tuple[Clip, tuple[str, ...]]:
    """Read a driving clip with notes on what was taken of its file, beside those of the clip itself.

    Args:
        frames: those to take; of a motion file no others are posed, of scans no others are read.
        whole: check `frames`, and return all.
        told: what is known of scans.
    """
    from ..motions.on_body import is_motion_file
    from ..pipeline.read import LONE_FRAMES, first_frame_note, load_moving
    from ..rigs.retarget import ScannedJoints

    path = chosen.path
    early = body_model is None and path.is_file() and is_motion_file(path) and not whole
    if body_model is None:
        taken = frames if early else slice(None)
        clip = load_moving(path, taken, told, fps, chosen.animation, progress, slice(None) if whole else frames)
        notes: tuple[str, ...] = ()
    else:
        clip, notes = read_clip(path, body_model, fps, chosen.animation, progress)
    notes += animations_note(chosen.animations, path, several=True) if chosen.animation is None else ()
    notes += taken_rate_note(clip, path) if fps is None else ()
    if frames.start == 0:
        # The capture is kept in memory: nothing is read again.
        first = io.load_driving(path, fps=fps, frames=slice(0, LONE_FRAMES)) if early else clip
        notes += first_frame_note(first, 0, path.name)
    early = early or (isinstance(clip.skeleton, ScannedJoints) and not whole)
    check_cut(clip.mesh.name, len(clip), slice(None) if early else frames)
    return (clip if early or whole else cut_clip(clip, frames.start, frames.stop, frames.step)), notes


def frames_are_asked(options: ConvertOptions) -> bool:
    """Tell whether surfaces are to be written instead of bones: morph targets, a pose, a recorded person."""
    return options.morphs or options.frame is not None or options.body_model is not None


def keeps_bones(source: Path, target: Path, options: ConvertOptions) -> bool:
    """Tell whether both files may have bones, and these are to be kept. A .vrm has more than bones: it stays one."""
    suffix, of_source = target.suffix.lower(), source.suffix.lower()
    both = of_source in JOINTED and suffix in JOINTED and (suffix != ".vrm" or of_source == suffix)
    return both and options.up is None and not frames_are_asked(options)


def _with_bones(source: Path, target: Path, options: ConvertOptions, given: list[str]) -> Converted | None:
    """Write a file with bones as another one, with all its contents, or with chosen frames of one animation.

    None where there are no frames to choose, because the file does not move.
    """
    mesh = io.load_mesh(source)
    names, count = getattr(mesh.source, "animations", ()), len(mesh.vertices)
    notes = missing_images_notes(missing_images(mesh))
    if not names and given:
        return None
    if set(given) <= {"--animation"} or mesh.source is None:  # without a source it is a motion of joints alone
        _refuse_options(target, given if mesh.source is None else [], "joints without a mesh are written as they are")
        io.save_whole(source, target, options.animation)
        kept = f"{target.name} has the animations {', '.join(names)}"
        return Converted(count, 1, None, notes + ((kept,) if len(names) > 1 and options.animation is None else ()))
    from ..io.gltf.edit import GltfSource
    from ..io.gltf.own_animation import cut_animation, write_own_animations

    assert isinstance(mesh.source, GltfSource)
    cut = cut_animation(mesh.source, options.animation, options.fps, options.slice)
    with io.joints_file(target) as temporary:
        write_own_animations([cut], temporary)
    notes += animations_note(names, source) if options.animation is None else ()
    return Converted(count, cut.frames, cut.fps, notes)


def _bones_note(mesh: Mesh, source: Path, target: Path) -> tuple[str, ...]:
    """Return a note on bones, animations and GPU instances of a glTF or FBX file that another format leaves out."""
    document = getattr(mesh.source, "document", None)
    if document is None:
        return ()
    skins, animations = (len(document.gltf.get(key, [])) for key in ("skins", "animations"))
    instanced = sum("EXT_mesh_gpu_instancing" in node.get("extensions", {}) for node in document.gltf.get("nodes", []))
    lost = ["bones" + " and their animations" * bool(animations)] * bool(skins)
    lost += [f"the GPU instances of {instanced} nodes"] * bool(instanced)
    if not lost:
        return ()
    if target.suffix.lower() in JOINTED:
        keeps = "without options for frames they are kept"
    else:
        kept = target.with_suffix(".glb").name
        keeps = f"mimesh convert {source.name} {kept} keeps them" if kept != source.name else f"{kept} keeps them"
        keeps += f", mimesh capture {source.name} writes the motion of bones" * bool(skins and animations)
    return (f"left out of {target.name}: {' and '.join(lost)}; {keeps}",)


def skinned_note(report: Mapping[str, Any]) -> tuple[str, ...]:
    """Return notes on how far the vertices of a skinned file are from those that all weights and joints would give."""
    limited, written = (report.get(f"{key}_deviation") or 0.0 for key in ("influence", "skinned"))
    notes = ()
    if limited >= NOTED_LIMITING:
        notes += (
            f"the few weights a vertex that files of joints have move a vertex by up to {limited:.2g} of the mesh's "
            "size; --influences 8 keeps more, --morphs writes frames of all weights",
        )
    if written >= NOTED_DEVIATION:
        cause = DEVIATION_CAUSES.get(report.get("deviation_cause", ""), "")
        notes += (f"a vertex of the file is up to {written:.2g} of the mesh's size from its frame{cause}",)
    return notes


def hierarchy_note(own: OwnAnimation | None, scheme: str, name: str) -> tuple[str, ...]:
    """Return a note on bones of an identity's own rig that hang on others than in a humanoid, if a scheme renames them.

    Args:
        own: the motion on the bones of the identity's file; None: other bones are written.
    """
    if own is None or scheme == "own":
        return ()
    from ..io.gltf.scene import node_parents
    from ..motions.bone_motion import misplaced_bones

    misplaced = misplaced_bones(own.joints, node_parents(own.source.document))
    if not misplaced:
        return ()
    return (
        f"{name}: in the hierarchy of its rig {', '.join(misplaced)} are below other bones than in a humanoid; "
        "programs that map a humanoid by its hierarchy may refuse it, or turn these wrongly; "
        f"{option('rig', 'mimesh')} writes joints of a humanoid's hierarchy",
    )


def not_kept(mesh: Mesh, path: Path, body: str | None = None) -> tuple[str, ...]:
    """Return notes on what the format of a path changes of a mesh: its axes, its unit, and attributes that are lost.

    Args:
        body: what the mesh is known to be, see `Hints.body`.
    """
    suffix = path.suffix.lower()
    if isinstance(mesh.source, RewritableSource) and mesh.source.suffix == suffix:
        return ()
    turned = _turned_note(mesh, path) + (() if body == "other" else _metres_note(mesh, path, body == "quadruped"))
    materials = {part.material for part in mesh.parts}
    is_image = len(materials) == 1 and any(material and material.texture for material in materials)
    has = {
        "materials": any(part.material for part in mesh.parts),
        "materials besides one image": any(materials) and not is_image,
        "normals of hard edges": mesh.corner_normals is not None and smooth_normals(mesh) is None,
        "texture coordinates": mesh.corner_uv is not None,
        "normals": mesh.corner_normals is not None,
        "vertex colours": mesh.vertex_colors is not None,
    }
    lacks = FORMATS[suffix].lacks if suffix in FORMATS else ()  # movies and folders of frames are none
    missing = [name for name in lacks if has[name]]
    if not missing:
        return turned
    return (*turned, f"{suffix} files as written here hold no {' or '.join(missing)}: left out of {path.name}")


def _turned_note(mesh: Mesh, path: Path) -> tuple[str, ...]:
    """Return a note that a mesh is written turned to y up; files that state their axes (USD) are no surprise."""
    turned = mesh.up not in (None, "+y") and not hasattr(mesh.source, "up_axis")
    if not turned or path.suffix.lower() not in JOINTED:
        return ()
    return (f"{mesh.name} has up {mesh.up}: {path.name} is turned to +y, which its format has up",)


def _metres_note(mesh: Mesh, path: Path, animal: bool) -> tuple[str, ...]:
    """Return a note on a person of no person's size in a format in metres, unless the mesh's own file has a unit.

    The same of animals, of many sizes: only centimetres and millimetres are told.

    glTF files are in metres, too, whatever they should be in: only a .vrm, which is a person, gets a note on them.
    """
    suffix, own = path.suffix.lower(), getattr(mesh.source, "suffix", "")
    if suffix not in JOINTED or hasattr(mesh.source, "meters_per_unit") or (own in JOINTED and suffix != ".vrm"):
        return ()
    sides = np.ptp(mesh.vertices, axis=0)  # of a person who stands the height: floors are wider
    longest = float(sides.max() if animal or mesh.up is None else sides["xyz".index(mesh.up[-1])])
    unit = unit_guess(longest) if not animal else next((u for u, sizes in ANIMAL.items() if longest < sizes), None)
    if unit in (None, "m"):
        return ()
    kind = "an animal" if animal else "a person"
    return (
        f"{mesh.name} measures {longest:.4g}, which {path.name} has in metres: {kind}, if its unit is {unit}; "
        f"scale by {dict(UNITS)[unit]:g} on import",
    )


def unit_guess(longest: float) -> str | None:
    """Return the unit in which the longest side is a person's height; the ranges of two units do not overlap."""
    return next((unit for unit, metres in UNITS if PERSON[0] <= longest * metres <= PERSON[1]), None)


def posed_vrm_note(path: Path) -> tuple[str, ...]:
    """Return a note that a .vrm in a pose is not what programs expect: VRM demands a T-pose at rest (tpose.md)."""
    if path.suffix.lower() != ".vrm":
        return ()
    return (f"{path.name} rests in the pose, programs that animate a .vrm expect a T-pose: write a .glb for a pose",)


def size_note(path: Path) -> tuple[str, ...]:
    """Return a note on how to make a clip smaller, if its file is large."""
    if not path.is_file() or (size := path.stat().st_size) < LARGE:
        return ()
    joints = ", and --skinned writes joints instead of frames" if path.suffix.lower() in MORPHED else ""
    return (f"{path.name} has {size / 2**20:,.0f} MiB: --step takes fewer frames{joints}",)


def rate_note(fps: float, path: Path) -> tuple[str, ...]:
    """Return a note that a format has no frame rate, unless the rate is the one that is assumed by default."""
    suffix = path.suffix.lower()
    if (suffix and suffix != CACHE) or fps == DEFAULT_FPS:
        return ()
    return (f"{suffix or 'folders of'} files have no frame rate: read {path.name} with --fps {fps:g}",)


def taken_rate_note(clip: Clip, path: Path) -> tuple[str, ...]:
    """Return a note that the frame rate of a clip was assumed, because neither its files nor the user gave it."""
    if len(clip) == 1 or not (path.is_dir() or path.suffix.lower() == CACHE):
        return ()
    return (f"{path.name} has no frame rate: {clip.fps:g} frames a second are taken; --fps gives another",)


def resampled_note(frames: int, fps: float, output_fps: float | None) -> tuple[str, ...]:
    """Return a note that a file has another frame rate than the frames that are written; None keeps theirs."""
    if output_fps is None or output_fps == fps:
        return ()
    seconds = (frames - 1) / fps
    lost = seconds - (frame_count(seconds, output_fps) - 1) / output_fps
    cut = f": its last {lost:.2g} s, less than a frame, are left out" * (lost * output_fps > ON_GRID)
    return (f"sampled from {frames_at(frames, fps)}{cut}",)


def frames_at(frames: int, fps: float) -> str:
    """Return the length of a clip in words."""
    return f"{frames} {'frame' if frames == 1 else 'frames'} at {fps:g} per second"


def animations_note(names: Sequence[str], path: Path, several: bool = False) -> tuple[str, ...]:
    """Return a note on which animation was taken, if a file has several."""
    if len(names) < 2:
        return ()
    others = f"{option('animation', ...)} takes another" + f", {option('animation', ALL)} takes all of them" * several
    return (f"{path.name} has {len(names)} animations: the first, {names[0]}, is taken; {others}",)


def part(progress: Progress | None, number: int, parts: int) -> Progress | None:
    """Return a function that reports the progress of one of several equal parts as progress of the whole."""
    return progress and (lambda done, total: progress(number * total + done, parts * total))


def _refuse_options(target: Path, given: Sequence[str], reason: str, alternative: str = "") -> None:
    if given:
        raise InputError(f"{target}: expected no {given[0]} ({reason}), found it; leave it out{alternative}")


def _at_rest_note(mesh: Mesh, source: Path, target: Path) -> tuple[str, ...]:
    """Return a note on which pose of a moving source was written to a format of one mesh."""
    if source.suffix.lower() in MOTIONS:
        return (f"{target.name} is the first frame; --frame takes another",)
    if getattr(mesh.source, "animations", ()):
        return (f"{target.name} is the mesh at rest; --frame takes a pose of its animation",)
    return ()


def has_joints_alone(path: Path) -> bool:
    """Return whether a file of one mesh is read as mimesh's own body."""
    if path.suffix.lower() != ".npz":
        return path.suffix.lower() in MOTIONS
    from ..motions.on_body import is_motion_file

    return is_motion_file(path)


def own_body_note(path: Path) -> tuple[str, ...]:
    """Return a note if a file of one mesh is read as mimesh's own body."""
    if not has_joints_alone(path):
        return ()
    return (f"{path.name} has joints and no mesh: mimesh's own body in its first frame is taken",)


def taken_pose_note(mesh: Mesh, path: Path) -> tuple[str, ...]:
    """Return a note on which pose a single mesh was read in, if its file moves."""
    if note := own_body_note(path):
        return note
    if getattr(mesh.source, "animations", ()):
        return (
            f"{path.name} has an animation: its mesh at rest is taken; for another pose, mimesh convert {path.name} "
            "pose.obj --frame N",
        )
    return ()


def _write_mesh(mesh: Mesh, target: Path, frames: int = 1, notes: tuple[str, ...] = ()) -> Converted:
    io.save_mesh(mesh, target)
    notes += not_kept(mesh, target) + _lying_note(mesh, target)
    if frames > 1:
        notes += (f"{target.suffix} files hold one mesh: {target.name} is the first of {frames} frames",)
    if mesh.source is None or mesh.source.suffix == target.suffix.lower():
        notes += tuple(getattr(mesh.source, "notes", ()))
    notes += missing_images_notes(missing_images(mesh))
    return Converted(len(mesh.vertices), 1, None, notes)
