"""The commands `mimesh transfer` and `mimesh animate`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.options import FrameRange, Hints, Layout, ModelOptions, MotionOptions
from ..core.printable import shell_line
from .facts import joined_facts, print_facts, result_facts
from .joint_files import check_joint_outputs, save_joint_files, saved_joints, with_joint_files
from .options import LOGGER, ClipOptions, JointOptions, OutputOptions, ShapeOptions, Without, with_options
from .outputs import (
    check_clip_output,
    check_outputs,
    check_single,
    check_suffix,
    clip_output,
    preview_paths,
    usual_suffix,
)
from .terminal import Model, given_path, open_page, output_beside, output_path, progress, refuse_existing

if TYPE_CHECKING:
    from ..core.mesh import Clip, Mesh
    from ..pipeline.report import SavedClip
    from ..pipeline.result import ClipResult, Result
    from ..tools.driving import DrivingClip

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
    check_joint_outputs(joints, model, *inputs, target)
    pages = preview_paths(target, output.preview, usual=suffix)
    refuse_existing(output.no_clobber, target, *pages, *saved_joints(joints))
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
    _check_clips(target, titles, inputs, model, output, hints, joints)
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
    shown = _write_previews(results, titles, target, output)
    for result in results:
        _log(result, model, hints.body)
    facts = [
        result_facts(result, target, replaced, paths, notes, described, layout.fps, deviations)
        for (result, notes, described), paths, deviations in zip(moved, shown, saved.deviations, strict=True)
    ]
    return print_facts(facts[0] if len(facts) == 1 else joined_facts(facts, clips), output)


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


def _check_clips(
    target: Path,
    titles: Sequence[str | None],
    inputs: Sequence[Path | None],
    model: str,
    output: OutputOptions,
    hints: Hints,
    joints: JointOptions,
) -> None:
    """Check what clips of these titles will write, before anything is read."""
    for title in titles[:SHOWN_CLIPS]:
        check_outputs(target, output, *inputs, clip=title)
    check_joint_outputs(joints, model, *inputs, target)
    of_driving = {"--driving-joints": hints.driving_joints, "--save-driving-joints": joints.save_driving_joints}
    check_single(len(titles), of_driving)
    pages = [page for title in titles[:SHOWN_CLIPS] for page in preview_paths(target, output.preview, title)]
    refuse_existing(output.no_clobber, target, *pages, *saved_joints(joints))


def _files(options: ModelOptions) -> tuple[Path | None, ...]:
    return tuple(file for file in (options.reference, options.markers) if isinstance(file, Path))


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


def _timed(work):
    import time

    begin = time.perf_counter()
    return work(), time.perf_counter() - begin


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


def _write_previews(
    results: Sequence[ClipResult], titles: Sequence[str | None], target: Path, output: OutputOptions
) -> list[dict[str, Any]]:
    """Write the pictures and pages of the first clips, and open these pages if that is asked for."""
    unseen = dataclasses.replace(output, preview=False)
    shown = [
        _write_preview(result, target, output if number < SHOWN_CLIPS else unseen, title)
        for number, (result, title) in enumerate(zip(results, titles, strict=True))
    ]
    if output.preview and len(results) > SHOWN_CLIPS:
        command = shell_line("mimesh", "render", target, "-o", "NAME.html", "--animation", "NAME")
        note = f"pictures and pages are of the first {SHOWN_CLIPS} of {len(results)} clips; {command} shows another"
        shown = [{**paths, "notes": (*paths["notes"], note)} for paths in shown]
    if output.open:
        for page in filter(None, (paths["page"] for paths in shown)):
            open_page(page)
    return shown
