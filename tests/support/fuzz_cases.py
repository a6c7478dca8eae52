"""Read one damaged file after another in this process, and judge what comes of each."""

from __future__ import annotations

import dataclasses
import resource
import time
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fuzz_seeds import Seed
from fuzz_targets import Target, case_of, problem_of, unclear

from mimesh.core.errors import InputError

SECONDS = 10.0
"""Processor time that a case may take."""
PACKAGE = str(Path("src", "mimesh"))


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What came of one case."""

    kind: str
    """accepted, refused, failed."""
    text: str = ""
    """The refusal without its numbers, or what went wrong."""
    seconds: float = 0.0
    """Processor time, of children as well."""


def run_case(read: Any, path: Path) -> Outcome:
    """Read a file and judge what comes of it."""
    begin = _processor_time()
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            result = read(path)
            kind, text = "accepted", problem_of(result)
    except InputError as error:
        kind, text = "refused", str(error)
        if _caused_by_memory(error):
            kind, text = "failed", "more memory than there is, refused"
        elif unclear(str(error), path):
            kind, text = "failed", f"an unclear refusal: {str(error)[:300]!r}"
    except Exception as error:
        kind, text = "failed", f"{type(error).__name__} at {_place(error)}: {str(error)[:200]}"
    seconds = _processor_time() - begin
    if kind == "accepted" and text:
        kind = "failed"
    if kind != "failed" and warned:
        first = warned[0]
        kind, text = "failed", f"warning at {Path(first.filename).name}:{first.lineno}: {first.message}"
    if kind != "failed" and seconds > SECONDS:
        kind, text = "failed", f"{seconds:.0f} s of processor time"
    return Outcome(kind, text or "", seconds)


def _caused_by_memory(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, MemoryError):
            return True
        error = error.__cause__ or error.__context__
    return False


def _place(error: BaseException) -> str:
    """Return the innermost line of this package that an exception went through."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if PACKAGE in frame.filename] or frames
    return f"{Path(own[-1].filename).name}:{own[-1].lineno}"


def _processor_time() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def write_case(case: Seed, target: Target, folder: Path, number: int) -> Path:
    """Write the files of a case, after those of the last one were deleted.

    Libraries of native formats know layers by their path, so there each case has a name of its own.
    """
    for path in folder.iterdir():
        path.unlink()
    for name, content in case.files.items():
        (folder / name).write_bytes(content)
    path = folder / case.main
    return path.rename(folder / f"n{number}{target.suffix}") if target.native else path


def run_cases(target: Target, numbers: range, seed: int, folder: Path) -> Iterator[tuple[int, Outcome]]:
    """Run cases in this process."""
    sound = target.seeds()
    for number in numbers:
        path = write_case(case_of(target, sound, seed, number), target, folder, number)
        outcome = run_case(target.reads[number % len(target.reads)], path)
        if number < len(sound) and not any(run_case(read, path).kind == "accepted" for read in target.reads):
            outcome = Outcome("failed", f"a sound file is refused: {outcome.text}", outcome.seconds)
        yield number, outcome
