"""Worker processes: who gets which job, and what happens when one ends."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
from collections import deque
from contextlib import closing
from pathlib import Path
from typing import Any

import crashing
import pytest
import zoo

from mimesh.io import save_mesh
from mimesh.jobs import run
from mimesh.jobs.run import BatchTask, next_job
from mimesh.jobs.table import BatchJob

SCRIPT = """
import mimesh
print("script")
result = mimesh.batch("a.obj", "a.obj", "out/b.obj", command="transfer", options={"model": "copy"}, workers=1)
print(result.counts["done"])
"""


@pytest.fixture(autouse=True)
def repeating(monkeypatch) -> None:
    """Replace what workers do: they repeat the driving's name, and crash at one of them."""
    monkeypatch.setattr(run, "_do_or_exit", crashing.repeat_or_crash)


def tasks(*drivings: str, identities: int = 1) -> dict[int, BatchTask]:
    jobs = [BatchJob("row", "transfer", str(k % identities), driving, "out") for k, driving in enumerate(drivings)]
    return {k: BatchTask(job, "") for k, job in enumerate(jobs)}


def outcomes(given: dict[int, BatchTask], workers: int) -> list[dict[str, Any]]:
    """Have workers do tasks; outcomes by number, each of which may come once only."""
    found = list(run._do_with_workers(given, workers))
    assert sorted(number for number, _ in found) == sorted(given)
    return [outcome for _, outcome in sorted(found, key=lambda pair: pair[0])]


@pytest.mark.slow
def test_every_job_is_done_once():
    names = [str(k) for k in range(50)]
    assert [outcome["value"] for outcome in outcomes(tasks(*names, identities=7), 2)] == names


@pytest.mark.slow
def test_a_crash_costs_one_job_and_the_worker_is_replaced():
    before, crashed, after = outcomes(tasks("a", "crash", "b"), 1)
    assert (before["value"], after["value"]) == ("a", "b")
    assert crashed["state"] == "failed"
    assert "signal SIGABRT" in crashed["error"]
    assert before["process"] != after["process"]


@pytest.mark.slow
def test_a_caller_that_stops_ends_the_workers():
    with closing(run._do_with_workers(tasks(*"abcdefghi"), 1)) as finished:
        next(finished)
    assert list(finished) == []
    assert not multiprocessing.active_children()


def test_a_worker_stays_with_its_identity_and_helps_others_at_the_end():
    waiting, begun = {"a": deque([0, 2]), "b": deque([1, 3, 4, 5])}, set()
    assert next_job(waiting, begun, None) == ("a", 0)
    assert next_job(waiting, begun, None) == ("b", 1)
    assert next_job(waiting, begun, "a") == ("a", 2)
    assert next_job(waiting, begun, "b") == ("b", 3)
    assert next_job(waiting, begun, "a") == ("b", 4)
    assert next_job(waiting, begun, "b") == ("b", 5)
    assert not waiting


@pytest.mark.slow
def test_a_script_without_a_guard_runs_once(tmp_path):
    save_mesh(zoo.cube(), tmp_path / "a.obj")
    Path(tmp_path, "script.py").write_text(SCRIPT)
    done = subprocess.run([sys.executable, "script.py"], capture_output=True, text=True, cwd=tmp_path)
    assert (done.stdout.split(), done.stderr) == (["script", "1"], "")
