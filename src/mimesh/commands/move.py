"""The commands `mimesh transfer` and `mimesh animate`: options, files of joints, previews, and what is printed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.printable import say
from .clips import (
    check_clip_output,
    check_frames_size,
    check_rig_layout,
    check_single,
    check_suffix,
    clip_output,
    save_clips,
)
from .common import LOGGER
from .terminal import (
    Animations,
    BlendShapes,
    BodyModel,
    Json,
    Large,
    Model,
    NoClobber,
    NoLimits,
    Open,
    Output,
    Quiet,
    Seed,
    given_path,
    one_of,
    open_page,
    output_beside,
    output_path,
    print_json,
    print_next,
    progress,
    refuse_existing,
    refuse_inputs,
)

if TYPE_CHECKING:
    from ..core.joint_corrections import JointCorrections
    from ..core.mesh import Mesh
    from ..pipeline.result import ClipResult, Result
    from ..tools.convert import DrivingClip

MOST_NAMED = 6
"""Corrected joints up to which their names are printed."""
Identity = Annotated[
    Path, typer.Argument(metavar="IDENTITY", parser=given_path, help="The mesh to move: GLB, USD, OBJ, PLY ...")
]
Axis = Annotated[str | None, typer.Option(metavar="AXIS", help="x, y, z, -x, -y or -z, instead of the one found.")]
Ensemble = Annotated[int, typer.Option(help="Average over this many random pairings (npt, aniformer).")]
Pairing = Annotated[
    str,
    typer.Option(
        help="Pair vertices at random, by order (two shapes of one mesh), by the body that is fitted to both, or auto: "
        "by order where both have the same triangles (npt, aniformer).",
        autocompletion=one_of("pairing"),
    ),
]
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
        help="How far the result goes: scale (as its legs make it); keep (as DRIVING), drop (in place; both mime).",
        autocompletion=one_of("root"),
    ),
]
Ground = Annotated[
    bool,
    typer.Option("--ground/--no-ground", help="Plant soles where DRIVING's stand, by root path and legs (mime)."),
]
Smooth = Annotated[float, typer.Option(metavar="SECONDS", help="Average the motion of joints over time (mime).")]
Rig = Annotated[
    str,
    typer.Option(
        help="own: move IDENTITY on the bones of its file, if it has any; mimesh: find joints (both mime).",
        autocompletion=one_of("rig"),
    ),
]
Body = Annotated[
    str,
    typer.Option(
        help="What both are: human, quadruped (four-legged animals), other, or auto: by rig or shape (mime).",
        autocompletion=one_of("body"),
    ),
]
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
Names = Annotated[
    str,
    typer.Option(
        metavar="SCHEME",
        help="Bone names and hierarchy: mixamo, unreal, vrm, godot or rigify; own keeps the names.",
        autocompletion=one_of("names"),
    ),
]
RootBone = Annotated[
    bool,
    typer.Option(
        "--root-bone", help="Put the way over the ground on a bone above all others; own rigs get one, or use theirs."
    ),
]
Rest = Annotated[
    str,
    typer.Option(
        metavar="POSE",
        help="Pose the skeleton is bound in: file, T or A (not with own rigs).",
        autocompletion=one_of("rest"),
    ),
]
OutputFps = Annotated[
    float | None, typer.Option(help="Frame rate of the joints written, sampled from DRIVING's: 30, 60.")
]
Preview = Annotated[bool, typer.Option("--preview/--no-preview", help="Write a picture and a page beside the output.")]


def transfer(
    identity: Identity,
    driving: Annotated[Path, typer.Argument(metavar="DRIVING", parser=given_path, help="The mesh in the wanted pose.")],
    output: Output = None,
    model: Model = "mime",
    body_model: BodyModel = None,
    up: Axis = None,
    front: Axis = None,
    driving_up: Axis = None,
    driving_front: Axis = None,
    ensemble: Ensemble = 1,
    pairing: Pairing = "auto",
    refine: Refine = None,
    reference: Reference = None,
    markers: Markers = None,
    rig: Rig = "own",
    body: Body = "auto",
    joints: Joints = None,
    driving_joints: DrivingJoints = None,
    no_joints: NoJoints = False,
    save_joints: SaveJoints = None,
    save_driving_joints: SaveDrivingJoints = None,
    preview: Preview = True,
    open_it: Open = False,
    seed: Seed = 0,
    no_clobber: NoClobber = False,
    large: Large = False,
    no_limits: NoLimits = False,
    json: Json = False,
    quiet: Quiet = False,
) -> dict[str, Any]:
    """Give the mesh IDENTITY the pose of DRIVING.

    By default the output is IDENTITY-DRIVING beside IDENTITY and in its format. Of an OBJ or glTF it is the same
    file with its points moved.
    """
    from ..io import load_mesh
    from ..io.atomic import together
    from ..io.formats import MESH_WRITERS
    from ..pipeline import transfer as run_transfer
    from ..tools.convert import taken_pose_note

    suffix = usual_suffix(identity)
    _refuse_motion(identity, output)
    target = output_path(output, lambda: output_beside(identity, driving, suffix))
    check_outputs(target, preview, open_it, identity, driving, reference, markers, body_model, usual=suffix)
    check_joint_outputs((save_joints, save_driving_joints), model, identity, driving, target)
    refuse_existing(no_clobber, target, *_previews(target, preview, usual=suffix), save_joints, save_driving_joints)
    corrected = JointFiles.found(identity, driving, joints, driving_joints, no_joints, model)
    with progress("reading", quiet or json):
        (mesh, (posed, notes)), seconds = _timed(lambda: (load_mesh(identity), _posed_mesh(driving, body_model)))
    check_suffix(target, (*MESH_WRITERS, mesh.source.suffix if mesh.source else ""))
    with progress("transfer", quiet or json):
        result = run_transfer(
            mesh,
            posed,
            model,
            up=up,
            front=front,
            driving_up=driving_up,
            driving_front=driving_front,
            ensemble=ensemble,
            pairing=pairing,
            refine=refine,
            seed=seed,
            reference=reference,
            markers=markers,
            rig=rig,
            body=body,
            joints=corrected.identity,
            driving_joints=corrected.driving,
        )
    result.seconds["load"] += seconds
    replaced = target.is_file()
    with together():
        result.save(target)
        save_joint_files(result, identity, driving, save_joints, save_driving_joints)
        shown = _write_preview(result, target, preview, usual=suffix)
    if open_it:
        open_page(shown["page"])
    _log(result, model, body)
    notes += taken_pose_note(mesh, identity)
    return print_facts(result_facts(result, target, replaced, shown, notes, corrected.described()), json, quiet)


def usual_suffix(identity: Path) -> str:
    """Return the suffix of the default output of `transfer`: not everybody has Blender, which writes FBX."""
    return ".glb" if identity.suffix.lower() == ".fbx" else identity.suffix


def _refuse_motion(identity: Path, output: str | None) -> None:
    """Raise InputError for a file of joints alone as the mesh to move, unless an output is named for it."""
    from ..core.errors import InputError
    from ..io.formats import MOTIONS

    suffix = identity.suffix.lower()
    if suffix in MOTIONS and output is None:
        raise InputError(
            f"{identity}: expected a mesh to move, found {suffix}, which has joints alone; give it as DRIVING, or name "
            "an output such as -o body.glb to move mimesh's own body in its first frame"
        )


def _posed_mesh(path: Path, body_model: Path | None) -> tuple[Mesh, tuple[str, ...]]:
    """Read a mesh in the wanted pose, or with a body model what was recorded with it; returns notes as well."""
    from ..io import load_mesh, load_recorded_mesh
    from ..tools.convert import taken_pose_note

    if body_model is not None:
        return load_recorded_mesh(path, body_model)
    mesh = load_mesh(path)
    return mesh, taken_pose_note(mesh, path)


def animate(
    identity: Identity,
    driving: Annotated[
        list[Path],
        typer.Argument(metavar="DRIVING...", parser=given_path, help="Clips (GLB, USD, PC2 ...), folders, BVH files."),
    ],
    output: Output = None,
    model: Model = "mime",
    fps: Annotated[float | None, typer.Option(help="Frame rate of DRIVING, where its files do not say.")] = None,
    animation: Animations = None,
    body_model: BodyModel = None,
    start: Annotated[int, typer.Option(help="First frame to take, counted from 0.")] = 0,
    stop: Annotated[int | None, typer.Option(help="Frame to stop before.")] = None,
    step: Annotated[int, typer.Option(help="Take every so many frames.")] = 1,
    up: Axis = None,
    front: Axis = None,
    driving_up: Axis = None,
    driving_front: Axis = None,
    ensemble: Ensemble = 1,
    pairing: Pairing = "auto",
    refine: Refine = None,
    reference: Reference = None,
    markers: Markers = None,
    root: Root = "scale",
    ground: Ground = True,
    smooth: Smooth = 0.0,
    rig: Rig = "own",
    body: Body = "auto",
    joints: Joints = None,
    driving_joints: DrivingJoints = None,
    no_joints: NoJoints = False,
    save_joints: SaveJoints = None,
    save_driving_joints: SaveDrivingJoints = None,
    skinned: Annotated[
        bool,
        typer.Option("--skinned", help="Write joints (.glb, .gltf, .fbx; the default of mime) also of a single pose."),
    ] = False,
    morphs: Annotated[
        bool, typer.Option("--morphs", help="Write a morph target for each frame, not joints (.glb, .gltf).")
    ] = False,
    names: Names = "own",
    root_bone: RootBone = False,
    rest: Rest = "file",
    output_fps: OutputFps = None,
    blendshapes: BlendShapes = None,
    preview: Preview = True,
    open_it: Open = False,
    seed: Seed = 0,
    no_clobber: NoClobber = False,
    large: Large = False,
    no_limits: NoLimits = False,
    json: Json = False,
    quiet: Quiet = False,
) -> dict[str, Any]:
    """Make IDENTITY move as the clip DRIVING does.

    By default the output is IDENTITY-DRIVING.glb beside IDENTITY, with joints if the model has them (mime); an output
    without a suffix is a folder of meshes. Several DRIVING, or several animations of one (--animation Walk --animation
    Run, or --animation all), become one .glb with an animation for each.
    """
    from ..bodies.engine_rig import Layout
    from ..io import load_mesh
    from ..io.atomic import together
    from ..methods.find import moves_joints
    from ..pipeline import animate as run_animate
    from ..pipeline.options import Hints, MotionOptions
    from ..tools.convert import choose_clips, hierarchy_note, read_driving, resampled_note

    _refuse_motion(identity, output)
    target = output_path(output, lambda: clip_output(identity, driving), frames=True)
    layout = Layout(names, root_bone, rest, output_fps)
    clips = choose_clips(driving, animation)
    # The preview of a single clip has the name of the output alone.
    titles = [clip.name if len(clips) > 1 else None for clip in clips]
    for title in titles:
        check_outputs(target, preview, open_it, identity, *driving, reference, markers, body_model, clip=title)
    check_joint_outputs((save_joints, save_driving_joints), model, identity, *driving, target)
    check_single(len(clips), {"--driving-joints": driving_joints, "--save-driving-joints": save_driving_joints})
    pages = [page for title in titles for page in _previews(target, preview, title)]
    refuse_existing(no_clobber, target, *pages, save_joints, save_driving_joints)
    as_joints = check_clip_output(target, len(clips), skinned, morphs, blendshapes, layout)
    results, notes, corrections = [], [], []
    for chosen, title in zip(clips, titles, strict=True):
        path = chosen.path
        corrected = JointFiles.found(identity, path, joints, driving_joints, no_joints, model)
        whole = corrected.driving is not None  # these joints may be in a frame that is not taken
        with progress(f"reading {path.name}", quiet or json) as advance:
            (mesh, (clip, of_clip)), seconds = _timed(
                lambda chosen=chosen, advance=advance, whole=whole: (
                    load_mesh(identity),
                    read_driving(chosen, body_model, fps, slice(start, stop, step), advance, whole),
                )
            )
        if as_joints is False or not moves_joints(model):
            taken = len(range(len(clip))[start:stop:step]) if whole else len(clip)
            check_frames_size(mesh, taken, target, blendshapes, quiet or json)
        used = rig if corrected.identity is None else "mimesh"
        check_rig_layout(mesh, clip, model, Hints(rig=used, body=body), MotionOptions(root, ground, smooth), layout)
        with progress(f"frames of {title}" if title else "frames", quiet or json) as advance:
            result = run_animate(
                mesh,
                clip,
                model,
                up=up,
                front=front,
                driving_up=driving_up,
                driving_front=driving_front,
                ensemble=ensemble,
                pairing=pairing,
                refine=refine,
                seed=seed,
                reference=reference,
                markers=markers,
                start=start if whole else 0,
                stop=stop if whole else None,
                step=step if whole else 1,
                root=root,
                ground=ground,
                smooth=smooth,
                skinned=as_joints,
                rig=rig,
                body=body,
                progress=advance,
                joints=corrected.identity,
                driving_joints=corrected.driving,
            )
        result.seconds["load"] += seconds
        hierarchy = hierarchy_note(result.own, names, mesh.name)
        notes.append(of_clip + resampled_note(len(result.frames), result.fps, output_fps) + hierarchy)
        results.append(result)
        corrections.append(corrected.described())
    replaced = target.exists()
    with together():
        with progress("writing", quiet or json) as advance:
            save_clips(results, target, [clip.name for clip in clips], as_joints, blendshapes, layout, advance)
        for result, chosen in zip(results, clips, strict=True):
            save_joint_files(result, identity, chosen.path, save_joints, save_driving_joints, start)
        shown = [_write_preview(result, target, preview, title) for result, title in zip(results, titles, strict=True)]
    if open_it:
        for page in shown:
            open_page(page["page"])
    for result in results:
        _log(result, model, body)
    facts = [
        result_facts(result, target, replaced, paths, about, corrected, output_fps)
        for result, paths, about, corrected in zip(results, shown, notes, corrections, strict=True)
    ]
    return print_facts(facts[0] if len(facts) == 1 else joined_facts(facts, clips), json, quiet)


def _log(result: Result | ClipResult, model: str, body: str) -> None:
    """Write the times of the steps, and what was chosen and why, to the log (--verbose)."""
    import logging

    log, report = logging.getLogger(LOGGER), result.report
    log.info("times: %s", ", ".join(f"{step} {seconds:.2f} s" for step, seconds in result.seconds.items()))
    for which in ("identity", "driving"):
        axes = report[which]
        front = f"found by its shape, margin {axes['margin']:.2f}" if axes["detected"] else "known"
        log.info("%s: up %s (%s), front %s (%s)", which, axes["up"], axes["up_from"], axes["front"], front)
    if "body" in report:
        log.info("body: %s (%s)", report["body"], "found by rig or shape" if body == "auto" else "given by --body")
    why = "the default" if model == "mime" else "given by -m"
    own = report.get("rig") == "own"
    bones = "; on the rig of IDENTITY's own file" if own else "; joints found on the surface" if result.joints else ""
    log.info("method: %s (%s)%s", result.model, why, bones)


def _write_preview(
    result: Result | ClipResult,
    output: Path,
    preview: bool,
    clip: str | None = None,
    usual: str = ".glb",
) -> dict[str, Any]:
    """Write the picture and the page beside the output with `preview`; return paths.

    `clip` is the name of the result's animation where the output has several; `usual` is the default suffix of outputs.
    """
    if not preview:
        return {"pictures": [], "page": None}
    from ..tools.preview import write_preview

    picture, page = write_preview(result, output, clip, usual)
    return {"pictures": [str(picture)], "page": str(page)}


def _previews(output: Path, preview: bool, clip: str | None = None, usual: str = ".glb") -> tuple[Path, ...]:
    """Return the paths of the picture and the page that are written beside an output."""
    if not preview:
        return ()
    from ..tools.preview import names_beside

    return names_beside(output, clip, usual)


def check_outputs(
    output: Path, preview: bool, open_it: bool, *inputs: Path | None, clip: str | None = None, usual: str = ".glb"
) -> None:
    """Check that no output overwrites an input, and that a page to be opened is written."""
    from ..core.errors import InputError

    for written in (output, *_previews(output, preview, clip, usual)):
        refuse_inputs(written, *inputs)
    if open_it and not preview:
        raise InputError("--open: expected a page to open, found --no-preview; leave one of them out")


def _timed(work):
    """Call a function; return its result and the wall time in seconds."""
    import time

    begin = time.perf_counter()
    return work(), time.perf_counter() - begin


@dataclass(frozen=True)
class JointFiles:
    """Corrected joints of both inputs."""

    identity: JointCorrections | None
    driving: JointCorrections | None
    beside: tuple[str, ...] = ()
    """Paths of those found beside the inputs."""

    @classmethod
    def found(
        cls,
        identity: Path,
        driving: Path,
        joints: Path | None,
        driving_joints: Path | None,
        no_joints: bool,
        model: str,
    ) -> JointFiles:
        """Read the files that were given, else those beside the inputs; only models with joints use the latter."""
        from ..io.joint_file import load_corrections, side_file
        from ..methods.find import moves_joints

        corrections, found = [], []
        for mesh, given in ((identity, joints), (driving, driving_joints)):
            beside = side_file(mesh)
            usable = not no_joints and beside.is_file() and moves_joints(model)
            path = given or (beside if usable else None)
            found += [str(beside)] if usable and given is None else []
            corrections.append(None if path is None else load_corrections(path))
        return cls(corrections[0], corrections[1], tuple(found))

    def described(self) -> tuple[str, ...]:
        """Return a line for each of the files that was used."""
        lines = []
        for corrections in filter(None, (self.identity, self.driving)):
            names, count = ", ".join(corrections.positions), len(corrections.positions)
            what = f"{count} joints" if count > MOST_NAMED else names or "none"
            beside = " (--no-joints ignores it)" if corrections.source in self.beside else ""
            lines.append(f"{what} as in {corrections.source}{beside}")
        return tuple(lines)


def check_joint_outputs(paths: tuple[Path | None, Path | None], model: str, *others: Path) -> None:
    """Check that a model has joints to write, and that they are written to .json files that are no inputs."""
    from ..core.errors import InputError
    from ..methods.find import moves_joints

    for path, option in zip(paths, ("--save-joints", "--save-driving-joints"), strict=True):
        if path is None:
            continue
        if not moves_joints(model):
            raise InputError(f"{option}: expected a model with joints (mime), found {model}; choose it with -m")
        refuse_inputs(path, *others)
        if path.suffix.lower() != ".json":
            raise InputError(f"{path}: expected a .json file for the joints, found '{path.suffix}'; rename it")


def save_joint_files(
    result: Result | ClipResult,
    identity: Path,
    driving: Path,
    save_joints: Path | None,
    save_driving_joints: Path | None,
    frame: int = 0,
) -> None:
    """Write the joints that were found to the files that were asked for; `frame` is the first driving frame taken."""
    from ..core.joint_corrections import JointCorrections
    from ..io.joint_file import save_corrections

    clip = result.driving_clip
    outputs = (
        (save_joints, identity, result.joints, result.mesh, 0),
        (save_driving_joints, driving, result.driving_joints, None if clip is None else clip.mesh, frame),
    )
    for path, file, joints, mesh, t in outputs:
        if path is not None and joints is not None and mesh is not None:
            save_corrections(JointCorrections(joints, t, file.name, len(mesh.vertices)), path)


def result_facts(
    result: Result | ClipResult,
    output: Path,
    replaced: bool,
    shown: dict[str, Any],
    driving_notes: tuple[str, ...] = (),
    joints: tuple[str, ...] = (),
    output_fps: float | None = None,
) -> dict[str, Any]:
    """Return the facts about a result and its file, with all notes.

    `replaced`: whether a file or a folder of this name was there. `shown`: the paths of the preview. `output_fps`: the
    rate of the file if it differs from the result's.
    """
    from ..core.animated_rig import frames_around
    from ..pipeline.result import Result
    from ..tools.convert import blend_note, not_kept, posed_vrm_note, rate_note, size_note, skinned_note

    mesh = result.mesh
    fps, frames = (None, 1) if isinstance(result, Result) else (result.fps, len(result.frames))
    if fps is not None and output_fps is not None:
        fps, frames = output_fps, len(frames_around(frames, fps, output_fps)[0])
    rate = () if fps is None else (*rate_note(fps, output), *size_note(output))
    blended = blend_note(result.report.get("blendshapes_deviation"))
    kept = (*not_kept(mesh, output), *posed_vrm_note(output))
    notes = [*result.notes, *kept, *rate, *blended, *skinned_note(result.report), *driving_notes]
    facts: dict[str, Any] = {
        "output": str(output),
        "replaced": replaced,
        "model": result.model,
        "vertices": len(mesh.vertices),
        "frames": frames,
        "fps": fps,
        "seconds": {step: round(value, 4) for step, value in result.seconds.items()},
        "report": {**result.report, "notes": notes, **shown},
    }
    if joints:
        facts["report"]["joints"] = list(joints)
    return facts


def joined_facts(facts: Sequence[dict[str, Any]], driving: Sequence[DrivingClip]) -> dict[str, Any]:
    """Return the facts about one file of several clips: sums and unions, and under "clips" those of each."""
    kept = ("frames", "fps", "seconds", "report")
    clips = [
        {"name": clip.name, "driving": str(clip.path), **{key: one[key] for key in kept}}
        for one, clip in zip(facts, driving, strict=True)
    ]
    rates = {one["fps"] for one in facts}
    reports = [one["report"] for one in facts]
    report = {
        "notes": list(dict.fromkeys(note for report in reports for note in report["notes"])),
        "pictures": [path for report in reports for path in report["pictures"]],
        "page": reports[0]["page"],
    }
    return {
        **{key: facts[0][key] for key in ("output", "replaced", "model", "vertices")},
        "frames": sum(one["frames"] for one in facts),
        "fps": rates.pop() if len(rates) == 1 else None,
        "seconds": {step: round(sum(one["seconds"][step] for one in facts), 4) for step in facts[0]["seconds"]},
        "report": report,
        "clips": clips,
    }


def print_facts(facts: dict[str, Any], json: bool, quiet: bool) -> dict[str, Any]:
    """Print facts about a file as JSON, or as a summary, and return them."""
    if json:
        print_json(facts)
    elif not quiet:
        _print_summary(facts)
    return facts


def _print_summary(facts: dict[str, Any]) -> None:
    """Print the output, its clips if it has several, notes with those that they are about, previews and a next step."""
    from ..render.movie import MOVIES
    from ..tools.convert import frames_at

    clips, seconds = facts.get("clips", ()), sum(facts["seconds"].values())
    reports = [clip["report"] for clip in clips] or [facts["report"]]
    replaced = " (replaced)" if facts["replaced"] else ""
    length = "" if facts["fps"] is None else f", {frames_at(facts['frames'], facts['fps'])}"
    length = f", {len(clips)} clips" if clips else length
    by = "on its own rig" if reports[0].get("rig") == "own" else facts["model"]
    say(f"{facts['output']}{replaced}: {facts['vertices']} vertices{length}, {by}, {seconds:.1f} s")
    for clip in clips:
        say(f"clip: {clip['name']}, {frames_at(clip['frames'], clip['fps'])}")
    for line in dict.fromkeys(line for report in reports for line in report.get("joints", ())):
        say(f"joints: {line}")
    for note in facts["report"]["notes"]:
        about = [clip["name"] for clip in clips if note in clip["report"]["notes"]]
        say(f"note: {note}" if len(about) == len(clips) else f"note: {', '.join(about)}: {note}")
    for report in reports:
        for path in report["pictures"]:
            say(f"picture: {path}")
        if report["page"]:
            say(f"page: {report['page']}")
    if Path(facts["output"]).suffix.lower() not in MOVIES:
        _print_viewing(facts)


def _print_viewing(facts: dict[str, Any]) -> None:
    """Print how to look at a result: its page, or the command that makes a page or a picture of it."""
    output = Path(facts["output"])
    if facts["report"]["page"]:
        say(f"next: open {facts['report']['page']} in a browser")
    elif facts["fps"] is None and "clips" not in facts:
        print_next("render", output, "-o", output.with_suffix(".png"))
    elif output.suffix.lower() == ".vrma":
        print_next("look", output)
    else:
        print_next("render", output, "-o", output.with_suffix(".html"))
