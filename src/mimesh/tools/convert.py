"""Convert files between all formats (`mimesh convert`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import io
from ..core.animated_rig import RigAnimation
from ..core.errors import InputError, option
from ..core.frame_buffer import PosedFrames, Progress, part
from ..core.mesh import Clip, Mesh, cut_clip, far_note, stored_clip
from ..core.normalization import parse_axis
from ..core.options import ConvertOptions
from ..core.printable import shell_line
from ..io.beside import missing_images, missing_images_notes
from ..io.formats import FRAMES_ONLY, JOINTED, MESH_WRITERS, MORPHED, MOTIONS, in_single_precision
from .driving import animations_note, read_clip
from .notes import lying_note, not_kept, rate_note

USUAL = ConvertOptions()
BONES_ONLY = ".vrma"
"""Format that holds the motion of bones and no mesh."""


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
            + shell_line("mimesh", "animate", "CHARACTER", source.name, "-o", target.name)
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
            f"it with {shell_line('mimesh', 'rig', source.name, '-o', target.name)} --author NAME --license URL"
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
        (far_note(clip.mesh) if in_single_precision(clip.mesh, target) else ())
        + _bones_note(clip.mesh, source, target)
        + not_kept(clip.mesh, target)
        + lying_note(clip.mesh, target)
        + rate_note(clip.fps, target)
    )
    if options.frame is None and options.animation is None:
        notes += animations_note(clip, source)
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
    notes += animations_note(Clip.still(mesh), source) if options.animation is None else ()
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
        converted = shell_line("mimesh", "convert", source.name, kept)
        keeps = f"{converted if kept != source.name else kept} keeps them"
        keeps += f", {shell_line('mimesh', 'capture', source.name)} writes the motion of bones" * bool(
            skins and animations
        )
    return (f"left out of {target.name}: {' and '.join(lost)}; {keeps}",)


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


def _write_mesh(mesh: Mesh, target: Path, frames: int = 1, notes: tuple[str, ...] = ()) -> Converted:
    io.save_mesh(mesh, target)
    notes += far_note(mesh) if in_single_precision(mesh, target) else ()
    notes += not_kept(mesh, target) + lying_note(mesh, target)
    if frames > 1:
        notes += (f"{target.suffix} files hold one mesh: {target.name} is the first of {frames} frames",)
    if mesh.source is None or mesh.source.suffix == target.suffix.lower():
        notes += tuple(getattr(mesh.source, "notes", ()))
    notes += missing_images_notes(missing_images(mesh))
    return Converted(len(mesh.vertices), 1, None, notes)
