"""The commands `mimesh transfer` and `mimesh animate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .joint_files import JointFiles, check_joint_outputs, save_joint_files
from .terminal import (
    Animation,
    BlendShapes,
    Json,
    Model,
    Open,
    Output,
    Quiet,
    Seed,
    open_page,
    output_beside,
    print_json,
    print_next,
    progress,
    refuse_inputs,
)

if TYPE_CHECKING:
    from ..pipeline.result import ClipResult, Result

Identity = Annotated[Path, typer.Argument(metavar="IDENTITY", help="The mesh to move: GLB, USD, OBJ, PLY ...")]
Axis = Annotated[str | None, typer.Option(metavar="AXIS", help="x, y, z, -x, -y or -z, instead of the one found.")]
Ensemble = Annotated[int, typer.Option(help="Average over this many random pairings (npt, aniformer).")]
Refine = Annotated[
    bool | None,
    typer.Option("--refine/--no-refine", help="Smooth the result along IDENTITY's surface; by default npt, aniformer."),
]
Reference = Annotated[
    Path | None, typer.Option(help="The driving mesh in IDENTITY's pose (deformation-transfer).", metavar="MESH")
]
Markers = Annotated[
    Path | None,
    typer.Option(help="Lines 'identity driving' of corresponding vertices (deformation-transfer).", metavar="FILE"),
]
Root = Annotated[
    str,
    typer.Option(
        help="How far the result goes: scale (as its legs make it); keep (as DRIVING), drop (in place; both mime)."
    ),
]
Ground = Annotated[
    bool,
    typer.Option("--ground/--no-ground", help="Plant soles where DRIVING's stand, by root path and legs (mime)."),
]
Smooth = Annotated[float, typer.Option(metavar="SECONDS", help="Average the motion of joints over time (mime).")]
Joints = Annotated[
    Path | None,
    typer.Option(help="Joints of IDENTITY picked by hand; by default IDENTITY's .joints.json (mime).", metavar="FILE"),
]
DrivingJoints = Annotated[
    Path | None, typer.Option(help="The same of DRIVING, beside which it is found, too (mime).", metavar="FILE")
]
NoJoints = Annotated[bool, typer.Option("--no-joints", help="Ignore the .joints.json beside IDENTITY and DRIVING.")]
SaveJoints = Annotated[
    Path | None, typer.Option(help="Write the joints found on IDENTITY, to be edited (mime).", metavar="FILE")
]
SaveDrivingJoints = Annotated[
    Path | None, typer.Option(help="Write those found on DRIVING's first frame (mime).", metavar="FILE")
]
Preview = Annotated[bool, typer.Option("--preview/--no-preview", help="Write a picture and a page beside the output.")]


def transfer(
    identity: Identity,
    driving: Annotated[Path, typer.Argument(metavar="DRIVING", help="The mesh in the wanted pose.")],
    output: Output = None,
    model: Model = "mime",
    up: Axis = None,
    front: Axis = None,
    driving_up: Axis = None,
    driving_front: Axis = None,
    ensemble: Ensemble = 1,
    refine: Refine = None,
    reference: Reference = None,
    markers: Markers = None,
    joints: Joints = None,
    driving_joints: DrivingJoints = None,
    no_joints: NoJoints = False,
    save_joints: SaveJoints = None,
    save_driving_joints: SaveDrivingJoints = None,
    preview: Preview = True,
    open_it: Open = False,
    seed: Seed = 0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Give the mesh IDENTITY the pose of DRIVING.

    By default the output is IDENTITY-DRIVING beside IDENTITY and in its format: the same file with its points moved.
    """
    from ..io import MESH_WRITERS, load_mesh
    from ..pipeline import transfer as run_transfer

    # FBX is read only: the result of an .fbx is a .glb.
    suffix = ".glb" if identity.suffix.lower() == ".fbx" else identity.suffix
    output = output or output_beside(identity, driving, suffix)
    _check_outputs(output, preview, open_it, identity, driving, reference, markers)
    check_joint_outputs((save_joints, save_driving_joints), model, identity, driving, output)
    corrected = JointFiles.found(identity, driving, joints, driving_joints, no_joints, model)
    meshes, seconds = _timed(lambda: (load_mesh(identity), load_mesh(driving)))
    _check_suffix(output, (*MESH_WRITERS, meshes[0].source.suffix if meshes[0].source else ""))
    result = run_transfer(
        *meshes,
        model,
        up=up,
        front=front,
        driving_up=driving_up,
        driving_front=driving_front,
        ensemble=ensemble,
        refine=refine,
        seed=seed,
        reference=reference,
        markers=markers,
        joints=corrected.identity,
        driving_joints=corrected.driving,
    )
    result.seconds["load"] += seconds
    result.save(output)
    save_joint_files(result, identity, driving, save_joints, save_driving_joints)
    shown = _write_preview(result, output, preview, open_it)
    _print_result(result, output, shown, json, quiet, joints=corrected.described())


def animate(
    identity: Identity,
    driving: Annotated[Path, typer.Argument(metavar="DRIVING", help="A clip (GLB, USD, PC2 ...), a folder, a BVH.")],
    output: Output = None,
    model: Model = "mime",
    fps: Annotated[float | None, typer.Option(help="Frame rate of DRIVING, where its files do not say.")] = None,
    animation: Animation = None,
    start: Annotated[int, typer.Option(help="First frame to take, counted from 0.")] = 0,
    stop: Annotated[int | None, typer.Option(help="Frame to stop before.")] = None,
    step: Annotated[int, typer.Option(help="Take every so many frames.")] = 1,
    up: Axis = None,
    front: Axis = None,
    driving_up: Axis = None,
    driving_front: Axis = None,
    ensemble: Ensemble = 1,
    refine: Refine = None,
    reference: Reference = None,
    markers: Markers = None,
    root: Root = "scale",
    ground: Ground = True,
    smooth: Smooth = 0.0,
    joints: Joints = None,
    driving_joints: DrivingJoints = None,
    no_joints: NoJoints = False,
    save_joints: SaveJoints = None,
    save_driving_joints: SaveDrivingJoints = None,
    skinned: Annotated[
        bool, typer.Option("--skinned", help="Write joints, weights and turns instead of frames (mime; .glb, .gltf).")
    ] = False,
    blendshapes: BlendShapes = None,
    preview: Preview = True,
    open_it: Open = False,
    seed: Seed = 0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make IDENTITY move as the clip DRIVING does.

    By default the output is IDENTITY-DRIVING.glb beside IDENTITY; an output without a suffix is a folder of meshes.
    """
    from ..io import load_clip, load_mesh
    from ..pipeline import animate as run_animate
    from ..tools.convert import animations_note, taken_rate_note

    output = output or output_beside(identity, driving, ".glb")
    _check_outputs(output, preview, open_it, identity, driving, reference, markers)
    check_joint_outputs((save_joints, save_driving_joints), model, identity, driving, output)
    _check_clip_output(output, skinned, blendshapes)
    corrected = JointFiles.found(identity, driving, joints, driving_joints, no_joints, model)
    (mesh, clip), seconds = _timed(lambda: (load_mesh(identity), load_clip(driving, fps, animation)))
    with progress("frames", quiet or json) as advance:
        result = run_animate(
            mesh,
            clip,
            model,
            up=up,
            front=front,
            driving_up=driving_up,
            driving_front=driving_front,
            ensemble=ensemble,
            refine=refine,
            seed=seed,
            reference=reference,
            markers=markers,
            start=start,
            stop=stop,
            step=step,
            root=root,
            ground=ground,
            smooth=smooth,
            skinned=skinned,
            progress=advance,
            joints=corrected.identity,
            driving_joints=corrected.driving,
        )
    result.seconds["load"] += seconds
    save_joint_files(result, identity, driving, save_joints, save_driving_joints, start)
    with progress("writing", quiet or json) as advance:
        result.save_skinned(output) if skinned else result.save(output, blendshapes, advance)
    notes = animations_note(clip.mesh, driving) if animation is None else ()
    notes += taken_rate_note(clip, driving) if fps is None else ()
    shown = _write_preview(result, output, preview, open_it)
    _print_result(result, output, shown, json, quiet, notes, corrected.described())


def _print_result(
    result: Result | ClipResult,
    output: Path,
    shown: dict[str, Any],
    json: bool,
    quiet: bool,
    driving_notes: tuple[str, ...] = (),
    joints: tuple[str, ...] = (),
) -> None:
    """Print the report as JSON, or a summary with all notes; `shown` are the paths of the preview."""
    from ..pipeline.result import Result
    from ..tools.convert import blend_note, not_kept, rate_note, size_note

    mesh = result.moved.mesh
    fps = None if isinstance(result, Result) else result.fps
    rate = () if fps is None else (*rate_note(fps, output), *size_note(output))
    blended = blend_note(result.report.get("blendshapes_deviation"))
    notes = [*result.notes, *not_kept(mesh, output), *rate, *blended, *driving_notes]
    facts: dict[str, Any] = {
        "output": str(output),
        "model": result.model,
        "vertices": len(mesh.vertices),
        "frames": len(result.moved),
        "fps": fps,
        "seconds": {step: round(value, 4) for step, value in result.seconds.items()},
        "report": {**result.report, "notes": notes, **shown},
    }
    if joints:
        facts["report"]["joints"] = list(joints)
    if json:
        print_json(facts)
    elif not quiet:
        _print_summary(facts)


def _print_summary(facts: dict[str, Any]) -> None:
    """Print the output, its notes and previews, and a command for the next step."""
    from ..render.movie import MOVIES
    from ..tools.convert import frames_at

    length = "" if facts["fps"] is None else f", {frames_at(facts['frames'], facts['fps'])}"
    seconds = sum(facts["seconds"].values())
    print(f"{facts['output']}: {facts['vertices']} vertices{length}, {facts['model']}, {seconds:.1f} s")
    for line in facts["report"].get("joints", ()):
        print(f"joints: {line}")
    for note in facts["report"]["notes"]:
        print(f"note: {note}")
    for path in facts["report"]["pictures"]:
        print(f"picture: {path}")
    if facts["report"]["page"]:
        print(f"page: {facts['report']['page']}")
    if Path(facts["output"]).suffix.lower() in MOVIES:
        return
    if facts["report"]["pictures"] or facts["fps"] is not None:
        print_next("look", facts["output"])
    else:
        print_next("render", facts["output"], "-o", Path(facts["output"]).with_suffix(".png"))


def _write_preview(result: Result | ClipResult, output: Path, preview: bool, open_it: bool) -> dict[str, Any]:
    """Write the picture and the page beside the output with `preview`, open the page with `open_it`; return paths."""
    from ..tools.preview import write_preview

    if not preview:
        return {"pictures": [], "page": None}
    picture, page = write_preview(result, output)
    if open_it:
        open_page(page)
    return {"pictures": [str(picture)], "page": str(page)}


def _check_outputs(output: Path, preview: bool, open_it: bool, *inputs: Path | None) -> None:
    """Check that no output overwrites an input, and that a page to be opened is written."""
    from ..core.errors import InputError
    from ..tools.preview import names_beside

    for written in (output, *(names_beside(output) if preview else ())):
        refuse_inputs(written, *inputs)
    if open_it and not preview:
        raise InputError("--open: expected a page to open, found --no-preview; leave one of them out")


def _check_clip_output(output: Path, skinned: bool, blendshapes: int | None) -> None:
    """Check that the format of the output can hold a clip, or joints or morph targets."""
    from ..core.errors import InputError
    from ..io import clip_suffixes
    from ..render.movie import MOVIES

    if skinned and blendshapes:
        raise InputError("--blendshapes: expected it without --skinned, found both; choose one of them")
    _check_suffix(output, (".glb", ".gltf") if skinned or blendshapes else (*clip_suffixes(), *MOVIES, ""))


def _check_suffix(output: Path, suffixes: tuple[str, ...]) -> None:
    """Check that a format can be written, before the work is done."""
    from ..core.errors import InputError

    if output.suffix.lower() not in suffixes:
        known = " ".join(sorted({suffix for suffix in suffixes if suffix}))
        raise InputError(
            f"{output}: expected an output in one of {known}, found '{output.suffix}'; name another with -o"
        )


def _timed(work):
    """Call a function; return its result and the wall time in seconds."""
    import time

    begin = time.perf_counter()
    return work(), time.perf_counter() - begin
