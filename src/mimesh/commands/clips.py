"""What `mimesh animate` writes: frames or joints, and one clip or several of one identity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.options import Hints, Layout, MotionOptions
from .options import ShapeOptions
from .terminal import output_beside

if TYPE_CHECKING:
    from ..core.mesh import Clip, Mesh
    from ..pipeline.report import SavedClip
    from ..pipeline.result import ClipResult


def clip_output(identity: Path, driving: Sequence[Path]) -> Path:
    """Return the default output: IDENTITY-DRIVING.glb, or for several clips IDENTITY-clips.glb."""
    beside = output_beside(identity, driving[0], ".glb")
    return beside if len(driving) == 1 else identity.with_name(f"{identity.stem}-clips.glb")


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


def check_rig_layout(
    identity: Mesh, clip: Clip, model: str, hints: Hints, options: MotionOptions, layout: Layout
) -> None:
    """Check that the identity's own rig can get a layout if it is used, before anything is moved."""
    from ..methods.find import moves_joints
    from ..pipeline.file_rigs import read_rigs
    from ..pipeline.known import Known
    from ..pipeline.parts import find_part
    from ..pipeline.skinned import check_own_layout

    bones = layout.names != "own" or layout.root_bone or layout.rest != "file"
    if not bones or hints.rig != "own" or hints.joints is not None or not moves_joints(model):
        return
    part = find_part(identity, hints.part)
    identity = identity if part is None else part.mesh
    rigs = read_rigs(identity, clip, Known(body=hints.body), copy=True)
    if rigs.identity is not None:
        check_own_layout(rigs.identity.person, layout, identity.name)
    elif rigs.copied is not None and not options.changes_motion:
        check_own_layout({}, layout, identity.name)


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


def save_clips(
    results: Sequence[ClipResult],
    output: Path,
    names: Sequence[str],
    skinned: bool | None,
    layout: Layout,
    progress: Callable[[int, int], None] | None,
) -> SavedClip:
    """Write results as joints, with `skinned` None where they move or are the file's own; else the one as frames."""
    from ..pipeline.skinned import save_skinned

    first = results[0]
    jointed = first.skeleton is not None or first.own is not None
    moving = len(first.frames) > 1 or first.own is not None  # the pose of a file's own bones keeps its skin
    if skinned or (skinned is None and jointed and moving):
        return save_skinned(results, output, animations=names, layout=layout)
    return first.save(output, progress=progress)
