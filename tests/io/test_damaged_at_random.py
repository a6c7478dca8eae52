"""Files of every format, damaged at random, are read or clearly refused: some hundred of each, always the same ones."""

from __future__ import annotations

import dataclasses
import re
import warnings
from collections import Counter
from pathlib import Path

import fuzz_cases
import numpy as np
import pytest
import zoo
from fuzz_targets import TARGETS, case_of

from mimesh.core.errors import InputError

CASES = {"bvh": 80, "amass": 80, "vrma": 60, "glb": 200, "gltf": 200, "vrm": 150, "onnx": 200}
"""Cases of the slower readers; the limit is a number of cases, so that every machine reads the same."""
OTHERS, NATIVE = 300, 40
"""Cases of other readers, and of those whose library decodes each file in a guarded process of its own."""


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_damaged_files_are_read_or_refused(name, tmp_path):
    target, kinds = TARGETS[name], Counter()
    if not target.installed:
        pytest.skip(f"needs {target.needs}")
    for number, outcome in fuzz_cases.run_cases(
        target, range(CASES.get(name, NATIVE if target.native else OTHERS)), 0, tmp_path
    ):
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
    outcome = fuzz_cases.run_case(read, tmp_path / "a.obj")
    assert outcome.kind == "failed"
    assert re.search(expected, outcome.text)


def test_slow_case_is_a_failure(tmp_path, monkeypatch):
    monkeypatch.setattr(fuzz_cases, "SECONDS", -1.0)
    assert fuzz_cases.run_case(lambda path: zoo.cube(), tmp_path / "a.obj").kind == "failed"
