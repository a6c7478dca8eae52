"""The commands `mimesh transfer` and `mimesh animate`: options, files of joints, previews, and what is printed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.options import FrameRange, Hints, Layout, ModelOptions, MotionOptions
from ..core.printable import listed, say
from .options import LOGGER, ClipOptions, JointOptions, OutputOptions, ShapeOptions, Without, with_options
from .terminal import (
    Model,
    given_path,
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
    from ..core.mesh import Clip, Mesh
    from ..pipeline.report import Deviations, SavedClip
    from ..pipeline.result import ClipResult, Result
    from ..tools.driving import DrivingClip

MOST_NAMED = 6
"""Corrected joints up to which their names are printed, and clips that a note names."""
SHOWN_CLIPS = 3
"""Clips of one output, the first ones, that get a picture and a page: these take a second of a core each, and were 60 %
of the time of a file of 15 clips of bones."""
Identity = Annotated[
    Path, typer.Argument(metavar="IDENTITY", parser=given_path, help="The mesh to move: GLB, USD, OBJ, PLY ...")
]


@with_options
def transfer(
    identity: Identity,
    driving: Annotated[Path, typer.Argument(metavar="DRIVING", parser=given_path, help="The mesh in the wanted pose.")],
    *,
    model: Model = "mime",
    output: OutputOptions,
    hints: Hints,
    options: ModelOptions,
    motion: Annotated[MotionOptions, Without("root", "ground", "smooth", "skinned", "influences")],
    joints: JointOptions,
    taken: Annotated[ClipOptions, Without("start", "stop", "step", "fps", "animation")],
) -> dict[str, Any]:
    """Give the mesh IDENTITY the pose of DRIVING.

    By default the output is IDENTITY-DRIVING beside IDENTITY and in its format. Of an OBJ or glTF it is the same
    file with its points moved.
    """
    from ..io import check_writable, load_mesh
    from ..io.atomic import together
    from ..io.formats import MESH_WRITERS
    from ..pipeline import transfer as run_transfer
    from ..tools.notes import taken_pose_note

    suffix = usual_suffix(identity)
    _refuse_motion(identity, output.output)
    target = output_path(output.output, lambda: output_beside(identity, driving, suffix))
    check_writable(target)
    inputs = identity, driving, *_files(options), taken.body_model
    check_outputs(target, output, *inputs, usual=suffix)
    check_joint_outputs(joints, model, identity, driving, target)
    refuse_existing(output.no_clobber, target, *_previews(target, output.preview, usual=suffix), *saved_joints(joints))
    hints, corrected = with_joint_files(hints, identity, driving, joints, model)
    with progress("reading", output.silent):
        (mesh, (posed, notes)), seconds = _timed(lambda: (load_mesh(identity), _posed_mesh(driving, taken.body_model)))
    check_suffix(target, (*MESH_WRITERS, *([mesh.source.suffix] if mesh.source else [])))
    with progress("transfer", output.silent):
        result = run_transfer(mesh, posed, model, hints=hints, options=options, motion=motion)
    result.seconds["load"] += seconds
    replaced = target.is_file()
    with together():
        result.save(target)
        save_joint_files(result, identity, driving, joints)
    shown = _write_preview(result, target, output, usual=suffix)
    if output.open and shown["page"]:
        open_page(shown["page"])
    _log(result, model, hints.body)
    notes += taken_pose_note(mesh, identity)
    return print_facts(result_facts(result, target, replaced, shown, notes, corrected), output)


def usual_suffix(identity: Path) -> str:
    """Return the suffix of the default output of `transfer`: not everybody has Blender, which writes FBX."""
    return ".glb" if identity.suffix.lower() == ".fbx" else identity.suffix


def _refuse_motion(identity: Path, output: str | None) -> None:
    """Raise InputError for a file of joints alone as the mesh to move, unless an output is named for it."""
    from ..core.errors import InputError
    from ..tools.notes import has_joints_alone

    if output is None and identity.is_file() and has_joints_alone(identity):
        raise InputError(
            f"{identity}: expected a mesh to move, found a file of joints alone; give it as DRIVING, or name "
            "an output such as -o body.glb to move mimesh's own body in its first frame"
        )


def _posed_mesh(path: Path, body_model: Path | None) -> tuple[Mesh, tuple[str, ...]]:
    """Read a mesh in the wanted pose, or with a body model what was recorded with it; returns notes as well."""
    from ..io import load_mesh, load_recorded_clip
    from ..tools.notes import taken_pose_note

    if body_model is not None:
        clip, notes = load_recorded_clip(path, body_model, count=1)
        return clip.mesh, notes
    mesh = load_mesh(path)
    return mesh, taken_pose_note(mesh, path)


@with_options
def animate(
    identity: Identity,
    driving: Annotated[
        list[Path],
        typer.Argument(metavar="DRIVING...", parser=given_path, help="Clips (GLB, USD, PC2 ...), folders, BVH files."),
    ],
    *,
    model: Model = "mime",
    output: OutputOptions,
    hints: Hints,
    options: ModelOptions,
    motion: MotionOptions,
    taken: ClipOptions,
    layout: Layout,
    shapes: ShapeOptions,
    joints: JointOptions,
) -> dict[str, Any]:
    """Make IDENTITY move as the clip DRIVING does.

    By default the output is IDENTITY-DRIVING.glb beside IDENTITY, with joints if the model has them (mime); an output
    without a suffix is a folder of meshes. Several DRIVING, or several animations of one (--animation Walk --animation
    Run, or --animation all), become one .glb with an animation for each.
    """
    from ..io import check_writable, load_mesh
    from ..io.atomic import together
    from ..pipeline.skinned import free_names
    from ..tools.driving import choose_clips
    from ..tools.notes import own_body_note

    _refuse_motion(identity, output.output)
    target = output_path(output.output, lambda: clip_output(identity, driving), frames=True)
    check_writable(target)
    clips = choose_clips(driving, taken.animation)
    # The preview of a single clip has the name of the output alone.
    titles = [clip.name if len(clips) > 1 else None for clip in clips]
    inputs = identity, *driving, *_files(options), taken.body_model
    for title in titles[:SHOWN_CLIPS]:
        check_outputs(target, output, *inputs, clip=title)
    check_joint_outputs(joints, model, identity, *driving, target)
    of_driving = {"--driving-joints": hints.driving_joints, "--save-driving-joints": joints.save_driving_joints}
    check_single(len(clips), of_driving)
    pages = [page for title in titles[:SHOWN_CLIPS] for page in _previews(target, output.preview, title)]
    refuse_existing(output.no_clobber, target, *pages, *saved_joints(joints))
    as_joints = check_clip_output(target, len(clips), bool(motion.skinned), shapes, layout)
    motion = dataclasses.replace(motion, skinned=as_joints)
    with progress(f"reading {identity.name}", output.silent):
        mesh, seconds = _timed(lambda: load_mesh(identity))
    swapped = "the character comes first, then what it follows"
    of_identity, moved = tuple(f"{note}; {swapped}" for note in own_body_note(identity)), []
    for chosen, title in zip(clips, titles, strict=True):
        with_files, described = with_joint_files(hints, identity, chosen.path, joints, model)
        job = ClipJob(mesh, chosen, title, target, model, with_files, options, motion, taken, layout, shapes)
        result, notes = job.run(output.silent)
        moved.append((result, of_identity + notes, described))
    results = [result for result, _, _ in moved]
    names = free_names(results, [clip.name for clip in clips], target)
    clips = [dataclasses.replace(clip, name=name) for clip, name in zip(clips, names, strict=True)]
    results[0].seconds["load"] += seconds
    replaced = target.exists()
    with together():
        with progress("writing", output.silent) as advance:
            saved = save_clips(results, target, names, as_joints, layout, advance)
        for result, chosen in zip(results, clips, strict=True):
            save_joint_files(result, identity, chosen.path, joints, taken.start)
    unseen = dataclasses.replace(output, preview=False)
    shown = [
        _write_preview(result, target, output if number < SHOWN_CLIPS else unseen, title)
        for number, (result, title) in enumerate(zip(results, titles, strict=True))
    ]
    if output.preview and len(clips) > SHOWN_CLIPS:
        command = f"mimesh render {target.name} -o NAME.html --animation NAME"
        note = f"pictures and pages are of the first {SHOWN_CLIPS} of {len(clips)} clips; {command} shows another"
        shown = [{**paths, "notes": (*paths["notes"], note)} for paths in shown]
    if output.open:
        for page in filter(None, (page["page"] for page in shown)):
            open_page(page)
    for result in results:
        _log(result, model, hints.body)
    facts = [
        result_facts(result, target, replaced, paths, notes, described, layout.fps, deviations)
        for (result, notes, described), paths, deviations in zip(moved, shown, saved.deviations, strict=True)
    ]
    return print_facts(facts[0] if len(facts) == 1 else joined_facts(facts, clips), output)


@dataclass(frozen=True)
class ClipJob:
    """One clip of `mimesh animate`, with all options of the command."""

    identity: Mesh
    clip: DrivingClip
    title: str | None
    """Name of the clip where there are several."""
    target: Path
    model: str
    hints: Hints
    options: ModelOptions
    motion: MotionOptions
    taken: ClipOptions
    layout: Layout
    shapes: ShapeOptions

    def run(self, silent: bool) -> tuple[ClipResult, tuple[str, ...]]:
        """Read the clip, and move the identity by it; return the result and notes on the file."""
        from ..pipeline import animate as run_animate
        from ..tools.driving import read_driving
        from ..tools.notes import hierarchy_note, resampled_note

        # Corrected joints may be in a frame that is not taken.
        whole, taken = self.hints.driving_joints is not None, self.taken
        told = (self.hints.driving_up, self.hints.driving_front, self.hints.body)
        with progress(f"reading {self.clip.path.name}", silent) as advance:
            (clip, of_clip), seconds = _timed(
                lambda: read_driving(self.clip, taken.body_model, taken.fps, taken.slice, advance, whole, told)
            )
        mesh = self.identity
        check_rig_layout(mesh, clip, self.model, self.hints, self.motion, self.layout)
        with progress(f"frames of {self.title}" if self.title else "frames", silent) as advance:
            result = run_animate(
                mesh,
                clip,
                self.model,
                hints=self.hints,
                options=self.options,
                motion=self.motion,
                frames=FrameRange(taken.start, taken.stop, taken.step) if whole else FrameRange(),
                progress=advance,
            )
        result.seconds["load"] += seconds
        hierarchy = hierarchy_note(result.own, self.layout.names, mesh.name)
        of_clip += resampled_note(len(result.frames), result.fps, self.layout.fps)
        return result, of_clip + hierarchy


def _log(result: Result | ClipResult, model: str, body: str) -> None:
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
    result: Result | ClipResult, target: Path, output: OutputOptions, clip: str | None = None, usual: str = ".glb"
) -> dict[str, Any]:
    """Write the picture and the page beside a result where they are asked for; return paths, and notes on what failed.

    `clip` is the name of the result's animation where the output has several; `usual` is the default suffix of outputs.
    """
    if not output.preview:
        return {"pictures": [], "page": None, "notes": ()}
    from ..tools.preview import write_preview

    with progress(f"preview of {clip}" if clip else "preview", output.silent):
        pictures, pages, notes = write_preview(result, target, clip, usual)
    return {"pictures": [*map(str, pictures)], "page": str(pages[0]) if pages else None, "notes": notes}


def _previews(output: Path, preview: bool, clip: str | None = None, usual: str = ".glb") -> tuple[Path, ...]:
    if not preview:
        return ()
    from ..tools.preview import names_beside

    return names_beside(output, clip, usual)


def check_outputs(
    target: Path, output: OutputOptions, *inputs: Path | None, clip: str | None = None, usual: str = ".glb"
) -> None:
    """Check that no output overwrites an input, and that a page to be opened is written."""
    from ..core.errors import InputError

    for written in (target, *_previews(target, output.preview, clip, usual)):
        refuse_inputs(written, *inputs)
    if output.open and not output.preview:
        raise InputError("--open: expected a page to open, found --no-preview; leave one of them out")


def _timed(work):
    import time

    begin = time.perf_counter()
    return work(), time.perf_counter() - begin


def with_joint_files(
    hints: Hints, identity: Path, driving: Path | None, joints: JointOptions, model: str
) -> tuple[Hints, tuple[str, ...]]:
    """Read the files of corrected joints that were given, else those beside the inputs if the model has joints.

    Returns:
        The hints with the corrections, and a line for each file that was used.
    """
    from ..io.joint_file import load_corrections, side_file
    from ..methods.find import moves_joints

    read, lines = {}, []
    for name, mesh in (("joints", identity), ("driving_joints", driving)):
        path, beside = getattr(hints, name), ""
        if path is None and mesh and not joints.no_joints and side_file(mesh).is_file() and moves_joints(model):
            path, beside = side_file(mesh), " (--no-joints ignores it)"
        if path is not None:
            read[name] = load_corrections(path)
            named, count = read[name].positions, len(read[name].positions)
            known = f"{count} joints" if count > MOST_NAMED else ", ".join(named) or "none"
            lines.append(f"{known} as in {read[name].source}{beside}")
    return dataclasses.replace(hints, **read), tuple(lines)


def _files(options: ModelOptions) -> tuple[Path | None, ...]:
    return tuple(file for file in (options.reference, options.markers) if isinstance(file, Path))


def saved_joints(joints: JointOptions) -> tuple[Path | None, Path | None]:
    """Return the files of joints that are written."""
    return joints.save_joints, joints.save_driving_joints


def check_joint_outputs(joints: JointOptions, model: str, *others: Path) -> None:
    """Check that a model has joints to write, and that they are written to .json files that are no inputs."""
    from ..core.errors import InputError
    from ..core.options import needs_joints
    from ..methods.find import moves_joints

    for path, name in zip(saved_joints(joints), ("save_joints", "save_driving_joints"), strict=True):
        if path is None:
            continue
        if not moves_joints(model):
            raise needs_joints(name, model)
        refuse_inputs(path, *others)
        if path.suffix.lower() != ".json":
            raise InputError(f"{path}: expected a .json file for the joints, found '{path.suffix}'; rename it")


def save_joint_files(
    result: Result | ClipResult, identity: Path, driving: Path, joints: JointOptions, frame: int = 0
) -> None:
    """Write the joints that were found to the files that were asked for; `frame` is the first driving frame taken."""
    clip = result.driving_clip
    save_found(result.joints, joints.save_joints, identity, result.identity)
    save_found(result.driving_joints, joints.save_driving_joints, driving, None if clip is None else clip.mesh, frame)


def save_found(joints: Any, path: Path | None, file: Path, mesh: Mesh | None, frame: int = 0) -> None:
    """Write the joints that were found on a mesh to a file, to be edited, if there is one."""
    from ..core.joint_corrections import JointCorrections
    from ..io.joint_file import save_corrections

    if path is not None and joints is not None and mesh is not None:
        save_corrections(JointCorrections.found_on(mesh.vertices, joints, frame, file.name), path)


def result_facts(
    result: Result | ClipResult,
    output: Path,
    replaced: bool,
    shown: dict[str, Any],
    driving_notes: tuple[str, ...] = (),
    joints: tuple[str, ...] = (),
    output_fps: float | None = None,
    deviations: Deviations | None = None,
) -> dict[str, Any]:
    """Return the facts about a result and its file, with all notes.

    `replaced`: whether a file or a folder of this name was there. `shown`: see `_write_preview`. `output_fps`: the rate
    of the file if it differs from the result's. `deviations`: those of the file from the frames of a clip.
    """
    from ..core.animated_rig import frames_around
    from ..pipeline.result import Result
    from ..tools.notes import not_kept, posed_vrm_note, rate_note, size_note, skinned_note

    mesh = result.mesh
    fps, frames = (None, 1) if isinstance(result, Result) else (result.fps, len(result.frames))
    if fps is not None and output_fps is not None:
        fps, frames = output_fps, len(frames_around(frames, fps, output_fps)[0])
    rate = () if fps is None else (*rate_note(fps, output), *size_note(output))
    report = {**result.report, **(deviations or {})}
    kept = (*not_kept(result.identity or mesh, output, report.get("body")), *posed_vrm_note(output))
    notes = [*result.notes, *kept, *rate, *skinned_note(report), *driving_notes]
    notes += shown["notes"]
    facts: dict[str, Any] = {
        "output": str(output),
        "replaced": replaced,
        "model": result.model,
        "vertices": len(mesh.vertices),
        "frames": frames,
        "fps": fps,
        "seconds": {step: round(value, 4) for step, value in result.seconds.items()},
        "report": {**report, **shown, "notes": notes},
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
        "notes": list(_notes_of_clips(clips)),
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


def _notes_of_clips(clips: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield the notes on several clips, each with the names of those that it is about if it is not about all."""
    for note in dict.fromkeys(note for clip in clips for note in clip["report"]["notes"]):
        about = [clip["name"] for clip in clips if note in clip["report"]["notes"]]
        yield note if len(about) == len(clips) else f"{listed(about, MOST_NAMED)}: {note}"


def print_facts(facts: dict[str, Any], output: OutputOptions) -> dict[str, Any]:
    """Print facts about a file as JSON, or as a summary, and return them."""
    if output.json:
        print_json(facts)
    elif not output.quiet:
        _print_summary(facts)
    return facts


def _print_summary(facts: dict[str, Any]) -> None:
    """Print the output, its clips if it has several, notes with those that they are about, previews and a next step."""
    from ..tools.notes import frames_at
    from ..view.movie import MOVIES

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
        say(f"note: {note}")
    for report in reports:
        for path in report["pictures"]:
            say(f"picture: {path}")
        if report["page"]:
            say(f"page: {report['page']}")
    if Path(facts["output"]).suffix.lower() not in MOVIES:
        _print_viewing(facts)


def _print_viewing(facts: dict[str, Any]) -> None:
    output = Path(facts["output"])
    if facts["report"]["page"]:
        say(f"next: open {facts['report']['page']} in a browser")
    elif facts["fps"] is None and "clips" not in facts:
        print_next("render", output, "-o", output.with_suffix(".png"))
    elif output.suffix.lower() == ".vrma":
        print_next("look", output)
    else:
        print_next("render", output, "-o", output.with_suffix(".html"))


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
