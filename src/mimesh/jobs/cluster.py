"""Have the jobs of a batch done by a Ray cluster (the extra `cluster`)."""

from __future__ import annotations

import os
import sys
from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from importlib import import_module
from typing import Any

from ..core.errors import InputError
from ..io.child_process import VARIABLES as LIBRARY_THREADS
from ..methods.mime.kept_results import keep_results
from ..methods.onnx_runtime import THREADS
from .table import FAILED
from .worker import answer_call

MOST_CALLS = 8
"""Jobs of one identity that a task does one after another. A task that is lost with its machine is done again, without
the jobs whose records say that they are finished."""
RETRIES = -1
"""A task is done again as often as its machine is lost."""
LOCAL = "local"
"""Address of a cluster that is started on this machine, and ended with the batch."""


def run_on_cluster(
    calls: Sequence[dict[str, Any]],
    groups: Sequence[Hashable],
    address: str,
    answered: Callable[[int, dict[str, Any]], None],
) -> None:
    """Have a cluster answer calls, each task with one core and one thread.

    Args:
        calls: see `worker.answer_call`.
        groups: of each call; calls of one group share an identity.
        address: of the cluster, "auto" for the one that this machine belongs to, or LOCAL.
        answered: gets the number of each call and its answer as it comes.

    Raises:
        InputError: Ray is not installed, or there is no cluster at the address.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a cluster that is started here reports to nobody
    try:
        ray: Any = import_module("ray")
    except ImportError:
        raise InputError(
            "ray: expected it for --cluster, found it not installed; pip install 'mimesh[cluster]'"
        ) from None
    begun = not ray.is_initialized()
    if begun:
        _connect(ray, address)
    try:
        do = ray.remote(num_cpus=1, max_retries=RETRIES)(_answer_all)
        here = os.getcwd()
        tasks = {do.remote([calls[k] for k in numbers], here): numbers for numbers in chunks(groups)}
        while tasks:
            (ready,), _ = ray.wait(list(tasks), num_returns=1)
            numbers = tasks.pop(ready)
            for number, answer in zip(numbers, _answers(ray, ready, len(numbers)), strict=True):
                answered(number, answer)
    finally:
        if begun:
            ray.shutdown()


def chunks(groups: Sequence[Hashable]) -> list[list[int]]:
    """Divide calls into tasks: up to MOST_CALLS of one group each."""
    members: defaultdict[Hashable, list[int]] = defaultdict(list)
    for number, group in enumerate(groups):
        members[group].append(number)
    return [numbers[k : k + MOST_CALLS] for numbers in members.values() for k in range(0, len(numbers), MOST_CALLS)]


def _connect(ray: Any, address: str) -> None:
    """Connect to a cluster, whose workers find the modules that this process has."""
    variables = {**LIBRARY_THREADS, THREADS: "1", "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    options = {"include_dashboard": False} if address == LOCAL else {}
    try:
        ray.init(address=address, runtime_env={"env_vars": variables}, log_to_driver=False, **options)
    except (ConnectionError, ValueError, RuntimeError) as error:
        found = str(error).splitlines()[0]
        raise InputError(f"--cluster: expected a Ray cluster at {address}, found '{found}'; start it first") from error


def _answers(ray: Any, ready: Any, count: int) -> list[dict[str, Any]]:
    """Return the answers of a task; one that Ray gave up is a failure of its jobs."""
    try:
        return ray.get(ready)
    except ray.exceptions.RayError as error:
        message = f"expected a result, found that Ray gave its task up ({str(error).splitlines()[0]})"
        return [{"state": FAILED, "error": message}] * count


def _answer_all(calls: list[dict[str, Any]], folder: str) -> list[dict[str, Any]]:
    """Answer calls one after another, with paths that start in a folder; runs on the cluster."""
    os.chdir(folder)
    keep_results()
    return [answer_call(call) for call in calls]
