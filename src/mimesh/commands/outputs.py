"""Where the commands that move meshes write: default outputs, and checks before the work is done."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..core.options import Layout
from .options import OutputOptions, ShapeOptions
from .terminal import output_beside, refuse_inputs


def usual_suffix(identity: Path) -> str:
    """Return the suffix of the default output of `transfer`: not everybody has Blender, which writes FBX."""
    return ".glb" if identity.suffix.lower() == ".fbx" else identity.suffix


def clip_output(identity: Path, driving: Sequence[Path]) -> Path:
    """Return the default output: IDENTITY-DRIVING.glb, or for several clips IDENTITY-clips.glb."""
    beside = output_beside(identity, driving[0], ".glb")
    return beside if len(driving) == 1 else identity.with_name(f"{identity.stem}-clips.glb")


def preview_paths(output: Path, preview: bool, clip: str | None = None, usual: str = ".glb") -> tuple[Path, ...]:
    """Return the paths of the picture and the page beside an output, if there will be any; see `names_beside`."""
    if not preview:
        return ()
    from ..tools.preview import names_beside

    return names_beside(output, clip, usual)


def check_outputs(
    target: Path, output: OutputOptions, *inputs: Path | None, clip: str | None = None, usual: str = ".glb"
) -> None:
    """Check that no output overwrites an input, and that a page to be opened is written."""
    from ..core.errors import InputError

    for written in (target, *preview_paths(target, output.preview, clip, usual)):
        refuse_inputs(written, *inputs)
    if output.open and not output.preview:
        raise InputError("--open: expected a page to open, found --no-preview; leave one of them out")


def check_clip_output(output: Path, clips: int, skinned: bool, shapes: ShapeOptions, layout: Layout) -> bool | None:
    """Check that the format of the output can hold what is asked for, of so many clips.

    Returns:
        Whether joints are written; None: if the model has any.

    Raises:
        InputError: options that exclude each other, or a format that cannot hold the clip, joints or several clips.
    """
    from ..core.errors import InputError
    from ..io import clip_suffixes, refuse_vrm
    from ..io.formats import FRAME_SUFFIXES, JOINTED
    from ..pipeline.vrm import check_bones_layout
    from ..tools.convert import BONES_ONLY
    from ..view.movie import MOVIES

    refuse_vrm(output)
    frames = shapes.morphs
    if frames and skinned:
        raise InputError("--morphs: expected it without --skinned, found both; choose one of them")
    playing = tuple(suffix for suffix in JOINTED if suffix != ".vrm")
    jointed = (*playing, BONES_ONLY)
    if clips > 1 and (frames or output.suffix.lower() not in jointed):
        found = "--morphs" if frames else f"'{output.suffix}'"
        raise InputError(
            f"{output}: expected joints in a .glb, .gltf, .fbx or .vrma for {clips} clips, found {found}; "
            "animate one clip at a time, or change the output"
        )
    held = playing if frames else jointed
    if not (frames or skinned) and output.suffix.lower() in FRAME_SUFFIXES:
        raise InputError(
            f"{output}: expected a format for a clip, found '{output.suffix}', which holds one mesh; for a folder of "
            f"them name it without a suffix: -o {output.with_suffix('')}"
        )
    check_suffix(output, held if frames or skinned else (*clip_suffixes(), *MOVIES, BONES_ONLY, ""))
    if layout != Layout() and (frames or output.suffix.lower() not in jointed):
        raise InputError(
            "--names, --root-bone, --rest, --output-fps: expected joints in a .glb, .gltf or .fbx, found "
            f"{output.name} without; change the output, or leave these options out"
        )
    if output.suffix.lower() == BONES_ONLY:
        check_bones_layout(layout, output)
        return True
    if skinned or clips > 1 or layout != Layout():
        return True
    return False if frames or output.suffix.lower() not in playing else None


def check_suffix(output: Path, suffixes: tuple[str, ...]) -> None:
    """Check that a format can be written, before the work is done."""
    from ..core.errors import InputError
    from ..io import check_writable

    if output.suffix.lower() not in suffixes:
        known = " ".join(sorted({suffix for suffix in suffixes if suffix}))
        raise InputError(
            f"{output}: expected an output in one of {known}, found '{output.suffix}'; name another with -o"
        )
    check_writable(output)


def check_single(clips: int, options: dict[str, object]) -> None:
    """Check that options about one driving clip are not given with several."""
    from ..core.errors import InputError

    for option, value in options.items():
        if value is not None and clips > 1:
            raise InputError(f"{option}: expected one clip with it, found {clips}; animate one clip at a time")
