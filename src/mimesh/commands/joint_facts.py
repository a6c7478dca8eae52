"""Shared by `mimesh rig` and `mimesh capture`: facts about a file of joints, and what is printed of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.printable import say
from .options import OutputOptions
from .terminal import print_json, print_next

if TYPE_CHECKING:
    from ..pipeline.capturing import CapturedClip
    from ..pipeline.rigging import RiggedMesh

SOURCES = {"file": "of the file", "found": "found", "corrected": "found with corrections"}
"""Where joints are from -> what the summary says."""


def joint_facts(
    made: RiggedMesh | CapturedClip, output: Path, replaced: bool, joints: int, corrected: Sequence[str]
) -> dict[str, Any]:
    """Return the facts that both commands have in common; docs/commands.md lists all keys.

    Args:
        replaced: whether a file of this name was there.
        joints: how many there are.
        corrected: a line for each file of corrected joints.
    """
    found = "corrected" if corrected else "found"
    return {
        "output": str(output),
        "replaced": replaced,
        "body": made.body,
        "source": found if "confidence" in made.report else "file",
        "joints": joints,
        "seconds": {step: round(value, 4) for step, value in made.seconds.items()},
        "report": {**made.report, "corrected": list(corrected), "notes": list(made.notes)},
    }


def print_joint_facts(
    facts: dict[str, Any], output: OutputOptions, then: Sequence[str], length: str = ""
) -> dict[str, Any]:
    """Print facts as JSON or as a summary with a next step, and return them.

    Args:
        then: the next command.
        length: frames and frame rate of a clip.
    """
    if output.json:
        print_json(facts)
    elif not output.quiet:
        _print_summary(facts, then, length)
    return facts


def _print_summary(facts: dict[str, Any], then: Sequence[str], length: str) -> None:
    from ..pipeline.look import KINDS

    report = facts["report"]
    sure = f", confidence {report['confidence']:.2f}" if "confidence" in report else ""
    replaced = " (replaced)" if facts["replaced"] else ""
    about = f"{facts['joints']} joints of {KINDS[facts['body']]}, {SOURCES[facts['source']]}{sure}{length}"
    say(f"{facts['output']}{replaced}: {about}, {sum(facts['seconds'].values()):.1f} s")
    for line in report["corrected"]:
        say(f"joints: {line}")
    for note in report["notes"]:
        say(f"note: {note}")
    for path in report.get("pictures", ()):
        say(f"picture: {path}")
    print_next(*then)
