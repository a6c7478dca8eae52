"""One worker thread for the studio: runs long jobs one after another, and urgent ones between their frames.

Jobs are identified by keys. Submitting another one with the same key cancels the earlier one, whether it waits or runs:
only the newest request counts. A running job checks for cancellation whenever it reports progress, and all the time
while it waits for a child process that reads a file, which then ends at once. One thread needs no locks around models,
and an urgent job waits for one frame at most.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from ..core.errors import InputError, naming_options
from ..core.frame_buffer import Progress
from ..core.printable import say
from ..io.child_process import watched
from .items import field_name

Work = Callable[[Progress], Any]
"""The function of a job; its argument is to be called with the progress."""


class Cancelled(Exception):
    """Raised in a cancelled job, and by its future."""


@dataclass(eq=False)
class Job:
    """One function to be run by the worker, and its future result."""

    key: Hashable
    work: Work
    urgent: bool
    cancelled: bool = False
    future: Future = field(default_factory=Future)
    """Gives the return value of the work, or raises its error: Cancelled, InputError, or any other for a bug."""


class Worker:
    """The thread and its queue."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: list[Job] = []
        self._running: list[Job] = []
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="mimesh-studio", daemon=True)
        self._thread.start()

    def submit(self, key: Hashable, work: Work, urgent: bool = False) -> Future:
        """Queue work; a job with the same key, whether it waits or runs, is cancelled."""
        job = Job(key, work, urgent)
        with self._changed:  # the condition's lock is reentrant, so that `cancel` may take it again
            self.cancel(key)
            if self._closed:
                job.future.set_exception(Cancelled())
                return job.future
            self._waiting.append(job)
            self._changed.notify()
        return job.future

    def cancel(self, key: Hashable) -> None:
        """Cancel the jobs of a key; a running one ends when it next reports progress or waits for a child."""
        with self._changed:
            for job in self._running:
                job.cancelled |= job.key == key
            cancelled = [job for job in self._waiting if job.key == key]
            self._waiting = [job for job in self._waiting if job.key != key]
        for job in cancelled:
            job.future.set_exception(Cancelled())

    def close(self, seconds: float = 0.5) -> None:
        """Accept no more work, cancel all jobs, and wait up to so many seconds for the running one."""
        with self._changed:
            self._closed = True
            cancelled, self._waiting = self._waiting, []
            self._changed.notify()
        for job in cancelled:
            job.future.set_exception(Cancelled())
        self._thread.join(seconds)

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                job = self._next(urgent=any(waiting.urgent for waiting in self._waiting))
            if job is not None:
                self._run(job)
                del job  # so that its result is not kept in memory while waiting for the next

    def _next(self, urgent: bool) -> Job | None:
        """Remove the first waiting job from the queue, of the urgent or of the other ones."""
        with self._changed:
            job = next((job for job in self._waiting if job.urgent == urgent), None)
            if job is not None:
                self._waiting.remove(job)
                self._running.append(job)
            return job

    def _run(self, job: Job) -> None:
        try:
            with naming_options(field_name), watched(lambda: self._check(job)):
                value = job.work(lambda done, total: self._between_frames(job))
            self._check(job)
        except (Cancelled, InputError) as error:
            job.future.set_exception(error)
        except Exception as error:
            if job.cancelled:  # its inputs may have been replaced while it ran
                job.future.set_exception(Cancelled())
            else:  # a bug must be visible in the terminal, and must not end the thread
                say(*traceback.format_exc().splitlines(), error=True)
                job.future.set_exception(error)
        else:
            job.future.set_result(value)
        finally:
            with self._changed:
                self._running.remove(job)

    def _check(self, job: Job) -> None:
        """Raise Cancelled if a job is cancelled, or the worker closed."""
        if job.cancelled or self._closed:
            raise Cancelled

    def _between_frames(self, job: Job) -> None:
        """Called between two frames of a job: end it if it is cancelled, else run urgent jobs first."""
        self._check(job)
        while not job.urgent and (urgent := self._next(urgent=True)) is not None:
            self._run(urgent)


def error_line(error: BaseException) -> str:
    """Describe an error in one line: an InputError's message, that memory ran out, or else that it is a bug."""
    if isinstance(error, InputError):
        return " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return "expected enough memory for this, found that it ran out; remove other meshes, or give a smaller file"
    kind = f"{type(error).__name__}: {error}".splitlines()[0]
    return f"{kind}. This is a bug of mimesh: please report it with what the terminal shows."
