"""Worker processes of a batch on this machine: each gets one job at a time, if possible of the identity it has.

Workers are programs of their own that are spoken to over pipes: one that crashes, or that the system ends for its
memory, costs its job alone and is replaced.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from typing import Any

from ..io.child_process import VARIABLES as LIBRARY_THREADS
from ..methods.onnx_runtime import THREADS

Answer = Callable[[int, dict[str, Any]], None]
"""Gets the number of a call and its answer; is called from one thread at a time."""
POLL = 0.2
"""Seconds between looks for Ctrl-C."""


class CallQueue:
    """Calls in groups that share an identity. A worker stays in its group while it has calls left."""

    def __init__(self, groups: Sequence[Hashable]) -> None:
        self._lock = threading.Lock()
        self._new: dict[Hashable, deque[int]] = {}
        """Groups that no worker has begun."""
        self._begun: dict[Hashable, deque[int]] = {}
        for number, group in enumerate(groups):
            self._new.setdefault(group, deque()).append(number)

    def take(self, group: Hashable) -> tuple[Hashable, int] | None:
        """Return a group and a call of it: of the worker's own, else of a new one, else the last of the longest."""
        with self._lock:
            if group in self._begun:
                return self._taken(group, last=False)
            if self._new:
                group = next(iter(self._new))
                self._begun[group] = self._new.pop(group)
                return self._taken(group, last=False)
            if self._begun:
                return self._taken(max(self._begun, key=lambda name: len(self._begun[name])), last=True)
            return None

    def clear(self) -> None:
        """Drop all calls that no worker has taken."""
        with self._lock:
            self._new.clear()
            self._begun.clear()

    def _taken(self, group: Hashable, last: bool) -> tuple[Hashable, int]:
        calls = self._begun[group]
        number = calls.pop() if last else calls.popleft()
        if not calls:
            del self._begun[group]
        return group, number


class WorkerProcess:
    """A worker and the pipes to it; started with its first call, and again after it has ended."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._stopped = False
        self.ending = "not started"
        """How the last process ended."""

    def call(self, call: dict[str, Any]) -> dict[str, Any] | None:
        """Return the answer to a call; None if the process ended instead."""
        process = self._process
        if process is None:
            process = self._process = _start()
        if self._stopped:  # between the start and now
            process.terminate()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps(call) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except OSError:
            line = ""
        if line:
            return json.loads(line)
        self.end()
        return None

    def stop(self) -> None:
        """End a call at once; its temporary files are removed by the worker."""
        self._stopped = True
        if self._process is not None:
            self._process.terminate()

    def end(self) -> None:
        """Wait for the end of the process."""
        process, self._process = self._process, None
        if process is None:
            return
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):  # the process has ended with a call in the pipe
                    pipe.close()
        code = process.wait()
        self.ending = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def run_calls(
    calls: Sequence[dict[str, Any]],
    groups: Sequence[Hashable],
    workers: int,
    answered: Answer,
    lost: Callable[[int, str], dict[str, Any]],
) -> None:
    """Have workers answer calls; ends when all have been answered.

    Args:
        calls: see `worker.main`.
        groups: of each call; calls of one group go to one worker, as long as others have work.
        workers: number of processes.
        answered: gets every answer as it comes.
        lost: makes the answer to a call whose worker ended, from how it ended.

    Raises:
        KeyboardInterrupt: Ctrl-C; the workers have ended and left nothing incomplete.
    """
    queue, lock, ended = CallQueue(groups), threading.Lock(), threading.Semaphore(0)
    processes = [WorkerProcess() for _ in range(max(1, min(workers, len(calls))))]
    stopped = threading.Event()
    errors: list[BaseException] = []

    def serve(worker: WorkerProcess) -> None:
        group: Hashable = None
        try:
            while (taken := queue.take(group)) is not None:
                group, number = taken
                answer = worker.call(calls[number])
                if stopped.is_set():
                    break
                with lock:
                    answered(number, lost(number, worker.ending) if answer is None else answer)
        except BaseException as error:
            errors.append(error)
            queue.clear()
        finally:
            worker.end()
            ended.release()

    threads = [threading.Thread(target=serve, args=(worker,), daemon=True) for worker in processes]
    try:
        for thread in threads:
            thread.start()
        left = len(threads)
        while left:
            left -= ended.acquire(timeout=POLL)
    except BaseException:
        stopped.set()
        queue.clear()
        for worker in processes:
            worker.stop()
        for thread in threads:
            thread.join()
        raise
    if errors:
        raise errors[0]


def _start() -> subprocess.Popen[str]:
    """Start a worker with one thread."""
    environment = {**os.environ, **LIBRARY_THREADS, THREADS: "1"}
    # The worker finds the modules that this process has, also where they are not installed.
    environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    command = [sys.executable, "-m", "mimesh.jobs.worker"]
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, text=True, encoding="utf-8"
    )
