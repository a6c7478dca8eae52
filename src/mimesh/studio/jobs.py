"""One thread that does the work of the studio: long jobs one after another, and urgent ones between their frames.

A job is known by its key. Putting another of the same key drops the older one, whether it waits or runs: the newest
wish wins. Jobs look at whether they are still wanted whenever they tell their progress.
"""

from __future__ import annotations

import sys
import threading
import traceback
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from ..core.errors import InputError
from ..core.frame_buffer import Progress

Work = Callable[[Progress], Any]
"""What a job does; it is given what to tell its progress to."""


class Cancelled(Exception):
    """The job is no longer wanted."""


@dataclass(eq=False)
class Job:
    """One piece of work and what has become of it."""

    key: Hashable
    work: Work
    urgent: bool
    unwanted: bool = False
    future: Future = field(default_factory=Future)
    """What the work gave, or the error that ended it: Dropped, InputError, or a bug of ours."""


class Worker:
    """The thread and its queue."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: list[Job] = []
        self._running: list[Job] = []
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="mimesh-studio", daemon=True)
        self._thread.start()

    def put(self, key: Hashable, work: Work, urgent: bool = False) -> Future:
        """Have work done; what waits or runs under the same key is dropped."""
        job = Job(key, work, urgent)
        with self._changed:
            self.drop(key)
            if self._closed:
                job.future.set_exception(Cancelled())
                return job.future
            self._waiting.append(job)
            self._changed.notify()
        return job.future

    def drop(self, key: Hashable) -> None:
        """Forget the jobs of a key; one that runs ends when it next tells its progress."""
        with self._changed:
            for job in self._running:
                job.unwanted |= job.key == key
            dropped = [job for job in self._waiting if job.key == key]
            self._waiting = [job for job in self._waiting if job.key != key]
        for job in dropped:
            job.future.set_exception(Cancelled())

    def close(self, seconds: float = 0.5) -> None:
        """Take no more work, drop what there is, and wait a little for what runs."""
        with self._changed:
            self._closed = True
            left, self._waiting = self._waiting, []
            self._changed.notify()
        for job in left:
            job.future.set_exception(Cancelled())
        self._thread.join(seconds)

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                job = self._next(urgent=any(each.urgent for each in self._waiting))
            if job is not None:
                self._do(job)
                del job  # with all that it made, while there is no other

    def _next(self, urgent: bool) -> Job | None:
        """Take the first waiting job of a kind off the queue."""
        with self._changed:
            found = next((job for job in self._waiting if job.urgent == urgent), None)
            if found is not None:
                self._waiting.remove(found)
                self._running.append(found)
            return found

    def _do(self, job: Job) -> None:
        try:
            given = job.work(lambda done, total: self._between(job))
            if job.unwanted:
                raise Cancelled
        except (Cancelled, InputError) as error:
            job.future.set_exception(error)
        except Exception as error:
            # A bug of ours must be seen, and must not end the thread.
            traceback.print_exc(file=sys.stderr)
            job.future.set_exception(error)
        else:
            job.future.set_result(given)
        finally:
            with self._changed:
                self._running.remove(job)

    def _between(self, job: Job) -> None:
        """Between two frames of a job: end it if it is unwanted, and do what is urgent first if it is not."""
        if job.unwanted or self._closed:
            raise Cancelled
        while not job.urgent and (urgent := self._next(urgent=True)) is not None:
            self._do(urgent)


def words(error: BaseException) -> str:
    """An error as the page shows it: InputError's own line, that memory ran out, else that it is a bug of ours."""
    if isinstance(error, InputError):
        return " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return "expected enough memory for this, found that it ran out; remove other meshes, or give a smaller file"
    kind = f"{type(error).__name__}: {error}".splitlines()[0]
    return f"{kind}. This is a bug of mimesh: please report it with what the terminal shows."
