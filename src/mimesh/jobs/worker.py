"""A worker process of a batch: does the jobs that come as lines of JSON on stdin, and answers in lines on stdout."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
import traceback
from typing import Any

from ..core.errors import InputError, command_line_words
from ..core.system import resident_memory
from ..methods.mime.kept_results import keep_results
from .command_lines import run_command
from .records import finished, record_path, write_record
from .sheet import draw_tile
from .table import DONE, DONE_BEFORE, FAILED, BatchJob

TRACEBACK_LINES = 6


def main() -> None:
    """Answer every line on stdin until it ends.

    A call has "job"; "made_from", its fingerprint, if it is to be done; and "draw", whether a picture is wanted.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the batch itself ends its workers
    signal.signal(signal.SIGTERM, _stop)
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print must not be taken for an answer
    keep_results()
    try:
        for line in sys.stdin:
            print(json.dumps(answer_call(json.loads(line))), file=answers, flush=True)
    except (KeyboardInterrupt, BrokenPipeError):
        pass
    # Whoever started this process may be gone: skip the flush of a closed pipe.
    os._exit(0)


def answer_call(call: dict[str, Any]) -> dict[str, Any]:
    """Return the outcome of a job, if it was to be done, and "tile", a picture of its result or None."""
    job = BatchJob.from_dict(call["job"])
    outcome = run_job(job, call["made_from"]) if "made_from" in call else {}
    drawn = call["draw"] and outcome.get("state") != FAILED
    return {**outcome, "tile": draw_tile(job) if drawn else None}


def run_job(job: BatchJob, made_from: str) -> dict[str, Any]:
    """Do a job unless it is finished, and write its record; return its outcome."""
    before = finished(job, made_from)
    if before is not None:
        return {**before, "state": DONE_BEFORE}
    record_path(job).unlink(missing_ok=True)
    begin = time.perf_counter()
    try:
        with command_line_words():
            facts = run_command(job)
    except InputError as error:
        return _failed(job, " ".join(str(error).split()), begin)
    except MemoryError:
        return _failed(job, f"{job.identity}: expected enough memory, found too little; use fewer --workers", begin)
    except Exception as error:
        kind = f"{type(error).__name__}: {error}".splitlines()[0]
        lines = "".join(traceback.format_exception(error)[-TRACEBACK_LINES:])
        return {**_failed(job, f"{kind} (a bug of mimesh; please report it)", begin), "traceback": lines}
    outcome = {"state": DONE, "seconds": _since(begin), **_summary(facts)}
    try:
        write_record(job, made_from, outcome)
    except OSError as error:
        return _failed(job, f"{record_path(job)}: expected a place to write to, found '{error.strerror}'", begin)
    return {**outcome, "memory_mib": resident_memory()}


def _summary(facts: dict[str, Any]) -> dict[str, Any]:
    """Return what the summary of a batch has of the facts about a result."""
    reports = [clip["report"] for clip in facts.get("clips", ())] or [facts["report"]]
    found = [report[which].get("confidence") for report in reports for which in ("identity", "driving")]
    known = [confidence for confidence in found if confidence is not None]
    return {
        "frames": facts["frames"],
        "vertices": facts["vertices"],
        "confidence": min(known) if known else None,
        "steps": facts["seconds"],
        "notes": facts["report"]["notes"],
        "error": None,
    }


def _failed(job: BatchJob, error: str, begin: float) -> dict[str, Any]:
    return {"state": FAILED, "seconds": _since(begin), "error": error, "memory_mib": resident_memory()}


def _since(begin: float) -> float:
    return round(time.perf_counter() - begin, 3)


def _stop(*_: object) -> None:
    """Handle SIGTERM as Ctrl-C, so that temporary files are removed."""
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
