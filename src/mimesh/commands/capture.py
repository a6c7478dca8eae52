"""The command `mimesh capture`: read the motion of joints out of a clip of surfaces."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.options import FrameRange, Hints, MotionOptions
from ..core.printable import say
from .move import with_joint_files
from .options import ClipOptions, JointOptions, OutputOptions, Without, with_options
from .terminal import (
    Model,
    Seed,
    given_path,
    output_path,
    print_json,
    print_next,
    progress,
    refuse_existing,
    refuse_inputs,
    single,
)

if TYPE_CHECKING:
    from ..pipeline.capturing import CapturedClip


@with_options
def capture(
    clip: Annotated[
        Path, typer.Argument(metavar="CLIP", parser=given_path, help="A folder of meshes, GLB, ABC, USD, PC2, NPZ ...")
    ],
    *,
    model: Model = "mime",
    output: Annotated[OutputOptions, Without("open", "preview")],
    taken: Annotated[ClipOptions, Without("body_model")],
    motion: Annotated[MotionOptions, Without("root", "ground", "skinned")],
    hints: Annotated[Hints, Without("driving_up", "driving_front", "driving_joints")],
    joints: Annotated[JointOptions, Without("save_joints", "save_driving_joints")],
    seed: Seed = 0,
) -> dict[str, Any]:
    """Read the motion of joints out of the surfaces of CLIP: scans, caches, another character.

    By default the output is CLIP.bvh beside CLIP. A .vrma plays on any VRM character. Joints that the file has are
    taken as they are.
    """
    from ..io import load_driving
    from ..pipeline.capturing import JOINT_FILES
    from ..pipeline.capturing import capture as capture_joints
    from .clips import check_suffix

    target = output_path(output.output, lambda: clip.with_name(f"{clip.stem if clip.is_file() else clip.name}.bvh"))
    refuse_inputs(target, clip)
    check_suffix(target, JOINT_FILES)
    refuse_existing(output.no_clobber, target)
    hints, corrected = with_joint_files(hints, clip, None, joints, model)
    with progress(f"reading {clip.name}", output.silent) as advance:
        whole = load_driving(clip, fps=taken.fps, animation=single("--animation", taken.animation), progress=advance)
    frames = FrameRange(taken.start, taken.stop, taken.step)
    with progress("finding joints", output.silent) as advance:
        captured = capture_joints(
            whole, model, hints=hints, frames=frames, smooth=motion.smooth, seed=seed, progress=advance
        )
    replaced = target.is_file()
    captured.save(target)
    facts = _facts(captured, target, replaced, corrected)
    if output.json:
        print_json(facts)
    elif not output.quiet:
        _print_summary(facts)
    return facts


def _facts(captured: CapturedClip, output: Path, replaced: bool, joints: tuple[str, ...]) -> dict[str, Any]:
    """Return the facts about a motion and its file, with all notes."""
    return {
        "output": str(output),
        "replaced": replaced,
        "body": captured.body,
        "joints": len(captured.names),
        "frames": len(captured.root),
        "fps": captured.fps,
        "seconds": {step: round(value, 4) for step, value in captured.seconds.items()},
        "report": {**captured.report, "corrected": list(joints), "notes": list(captured.notes)},
    }


def _print_summary(facts: dict[str, Any]) -> None:
    """Print the output, how certain the joints are, notes, and a next step."""
    from ..pipeline.look import KINDS
    from ..tools.convert import frames_at

    report, seconds = facts["report"], sum(facts["seconds"].values())
    kind = KINDS[facts["body"]]
    sure = f"found, confidence {report['confidence']:.2f}" if "confidence" in report else "of the file"
    replaced = " (replaced)" if facts["replaced"] else ""
    length = frames_at(facts["frames"], facts["fps"])
    say(f"{facts['output']}{replaced}: {facts['joints']} joints of {kind}, {sure}, {length}, {seconds:.1f} s")
    for line in report["corrected"]:
        say(f"joints: {line}")
    for note in report["notes"]:
        say(f"note: {note}")
    print_next("animate", "hero.glb", facts["output"])
