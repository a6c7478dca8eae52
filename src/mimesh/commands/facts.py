"""Facts about a moved mesh or clip and its file: as JSON, or as a summary on the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.printable import listed, say, shell_line
from .options import OutputOptions
from .terminal import print_json, print_next

if TYPE_CHECKING:
    from ..pipeline.report import Deviations
    from ..pipeline.result import ClipResult, Result
    from ..tools.driving import DrivingClip

MOST_NAMED = 6
"""Clips that a note names."""


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
        say(f"next: open {shell_line(facts['report']['page'])} in a browser")
    elif facts["fps"] is None and "clips" not in facts:
        print_next("render", output, "-o", output.with_suffix(".png"))
    elif output.suffix.lower() == ".vrma":
        print_next("look", output)
    else:
        print_next("render", output, "-o", output.with_suffix(".html"))
