"""What `mimesh transfer` and `mimesh animate` print about a result: facts as JSON, or a summary and the next step."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.printable import say
from .terminal import print_json, print_next

if TYPE_CHECKING:
    from ..pipeline.result import ClipResult, Result
    from ..tools.driving_clips import DrivingClip


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


def print_facts(facts: dict[str, Any], json: bool, quiet: bool) -> dict[str, Any]:
    """Print facts about a file as JSON, or as a summary, and return them."""
    if json:
        print_json(facts)
    elif not quiet:
        _print_clips(facts) if "clips" in facts else _print_summary(facts)
    return facts


def _print_summary(facts: dict[str, Any]) -> None:
    """Print the output, its notes and previews, and a command for the next step."""
    from ..render.movie import MOVIES
    from ..tools.convert import frames_at

    length = "" if facts["fps"] is None else f", {frames_at(facts['frames'], facts['fps'])}"
    seconds = sum(facts["seconds"].values())
    say(f"{_written(facts)}: {facts['vertices']} vertices{length}, {_moved_by(facts)}, {seconds:.1f} s")
    for line in facts["report"].get("joints", ()):
        say(f"joints: {line}")
    for note in facts["report"]["notes"]:
        say(f"note: {note}")
    _print_previews(facts["report"])
    if Path(facts["output"]).suffix.lower() not in MOVIES:
        _print_viewing(facts)


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


def _written(facts: dict[str, Any]) -> str:
    """Name the output, and tell that it took the place of a file."""
    return facts["output"] + (" (replaced)" if facts["replaced"] else "")


def _moved_by(facts: dict[str, Any]) -> str:
    """Name what moved the identity: the model, or the rig of its own file."""
    return "on its own rig" if facts["report"].get("rig") == "own" else facts["model"]


def _print_clips(facts: dict[str, Any]) -> None:
    """Print a file of several clips: a line for each, notes with the clips that they are about, and the pages."""
    from ..tools.convert import frames_at

    clips, seconds = facts["clips"], sum(facts["seconds"].values())
    by = _moved_by({**facts, "report": clips[0]["report"]})
    say(f"{_written(facts)}: {facts['vertices']} vertices, {len(clips)} clips, {by}, {seconds:.1f} s")
    for clip in clips:
        say(f"clip: {clip['name']}, {frames_at(clip['frames'], clip['fps'])}")
    for line in dict.fromkeys(line for clip in clips for line in clip["report"].get("joints", ())):
        say(f"joints: {line}")
    for note in facts["report"]["notes"]:
        about = [clip["name"] for clip in clips if note in clip["report"]["notes"]]
        say(f"note: {note}" if len(about) == len(clips) else f"note: {', '.join(about)}: {note}")
    for clip in clips:
        _print_previews(clip["report"])
    _print_viewing(facts)


def _print_previews(report: dict[str, Any]) -> None:
    """Print the paths of the picture and the page of a result, if they were written."""
    for path in report["pictures"]:
        say(f"picture: {path}")
    if report["page"]:
        say(f"page: {report['page']}")


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
