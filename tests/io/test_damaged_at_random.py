"""Files of every format, damaged at random, are read or clearly refused: some hundred of each, always the same ones."""

from __future__ import annotations

import dataclasses
import re
import resource
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from fork_server import ForkServer
from fuzz_seeds import Seed
from fuzz_targets import TARGETS, Target, case_of, problem_of, unclear
from matrix import matrix

from mimesh.core.errors import InputError
from mimesh.io import child_process

CASES = {"bvh": 40, "amass": 40, "vrma": 30, "glb": 100, "gltf": 100, "vrm": 75, "onnx": 100}
"""Cases of the slower readers; the limit is a number of cases, so that every machine reads the same."""
OTHERS, NATIVE = 150, 40
"""Cases of other readers, and of those whose library decodes each file in a guarded process of its own."""
SECONDS = 10.0
"""Processor time that a case may take."""
PACKAGE = str(Path("src", "mimesh"))
SERVER = ForkServer()


@pytest.fixture(scope="module", autouse=True)
def forked():
    """Have native decoders run in children that are forked."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(child_process, "_run", SERVER.run)
        yield
    SERVER.close()


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
    return time.process_time() + children.ru_utime + children.ru_stime + SERVER.seconds


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


@matrix("name", TARGETS, quick=["off", "npy"])
def test_damaged_files_are_read_or_refused(name, tmp_path):
    target, kinds = TARGETS[name], Counter()
    if not target.installed:
        pytest.skip(f"needs {target.needs}")
    count = CASES.get(name, NATIVE if target.native else OTHERS)
    for number, outcome in run_cases(target, range(count), 0, tmp_path):
        assert outcome.kind != "failed", f"case {number} of {name}: {outcome.text}"
        kinds[outcome.kind] += 1
    assert kinds["accepted"] > 2
    assert kinds["refused"] > 2


def test_cases_are_the_same_each_time():
    for target in TARGETS.values():
        if target.installed and target.name not in ("hdf5", "alembic"):  # their files have times
            first, second = (case_of(target, target.seeds(), 3, 40).files for _ in range(2))
            assert first == second, target.name


def _raise(error: BaseException):
    raise error


def _warn(path: Path):
    warnings.warn("careful", RuntimeWarning, stacklevel=1)
    return zoo.cube()


def _refuse_for_memory(path: Path):
    try:
        raise MemoryError
    except MemoryError as error:
        raise InputError(f"{path}: expected little, found much; less") from error


BAD_UV = dataclasses.replace(zoo.cube(), corner_uv=np.full((12, 3, 2), np.nan))
OUTSIDE = dataclasses.replace(zoo.tetrahedron(), faces=np.array([[0, 1, 4]]))
FAILURES = {
    "exception": (lambda path: _raise(KeyError("x")), r"^KeyError at test_damaged_at_random.py:\d+: 'x'"),
    "unclear": (lambda path: _raise(InputError("no")), "^an unclear refusal: 'no'"),
    "warning": (_warn, r"^warning at test_damaged_at_random.py:\d+: careful"),
    "memory": (_refuse_for_memory, "^more memory than there is"),
    "not finite": (lambda path: BAD_UV, "^corner_uv of another size or not finite"),
    "out of range": (lambda path: OUTSIDE, "^faces out of range"),
}


@pytest.mark.parametrize("name", FAILURES)
def test_failures_are_seen(name, tmp_path):
    read, expected = FAILURES[name]
    outcome = run_case(read, tmp_path / "a.obj")
    assert outcome.kind == "failed"
    assert re.search(expected, outcome.text)


def test_slow_case_is_a_failure(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "SECONDS", -1.0)
    assert run_case(lambda path: zoo.cube(), tmp_path / "a.obj").kind == "failed"
