"""Worker processes: who gets which call, and what happens when one ends."""

from __future__ import annotations

import subprocess
import sys

import pytest

from mimesh.jobs import pool
from mimesh.jobs.pool import CallQueue, run_calls

PROGRAM = """
import json, os, sys
for line in sys.stdin:
    call = json.loads(line)
    if call["value"] == "crash":
        os.abort()
    print(json.dumps({"value": call["value"], "process": os.getpid()}), flush=True)
"""


@pytest.fixture
def program(monkeypatch):
    """Replace the program of workers by one that repeats values, and crashes at one of them."""

    def start() -> subprocess.Popen[str]:
        command = [sys.executable, "-c", PROGRAM]
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    monkeypatch.setattr(pool, "_start", start)


def answers(values: list, groups: list, workers: int) -> dict[int, dict]:
    """Have workers answer calls; answers by number, each of which may come once only."""
    found: dict[int, dict] = {}

    def answered(number: int, answer: dict) -> None:
        assert number not in found
        found[number] = answer

    run_calls([{"value": v} for v in values], groups, workers, answered, lambda number, ending: {"lost": ending})
    return found


def test_every_call_is_answered_once(program):
    found = answers(list(range(50)), [k % 7 for k in range(50)], 3)
    assert [found[k]["value"] for k in range(50)] == list(range(50))


def test_a_crash_costs_one_call_and_the_worker_is_replaced(program):
    found = answers(["a", "crash", "b", "crash", "c"], [0] * 5, 1)
    assert [found[k].get("value") for k in (0, 2, 4)] == ["a", "b", "c"]
    assert [found[k]["lost"] for k in (1, 3)] == ["signal SIGABRT"] * 2
    assert len({found[k]["process"] for k in (0, 2, 4)}) == 3


def test_an_error_of_the_caller_ends_all(program):
    def answered(number: int, answer: dict) -> None:
        raise ValueError("full disk")

    with pytest.raises(ValueError, match="full disk"):
        run_calls([{"value": k} for k in range(9)], [0] * 9, 2, answered, lambda number, ending: {})


def test_a_worker_stays_with_its_identity_and_helps_others_at_the_end():
    queue = CallQueue(["a", "b", "a", "b", "b", "b"])
    assert queue.take(None) == ("a", 0)
    assert queue.take(None) == ("b", 1)
    assert queue.take("a") == ("a", 2)
    assert queue.take("b") == ("b", 3)
    assert queue.take("a") == ("b", 5)  # the last of what is left: the other worker goes on from the front
    assert queue.take("b") == ("b", 4)
    assert queue.take("a") is None
