"""StopRequest: when a training has to end before its schedule does."""

from __future__ import annotations

import signal
import threading
import time
from typing import Any


class StopRequest:
    """Tells when a training has to end before its schedule does: after a time limit, or on SIGTERM or SIGINT.

    A signal is only recorded, so that the current step can be finished and saved; at the end of the block it becomes a
    KeyboardInterrupt. A second one acts at once. Outside the main thread, which alone may handle signals, only the
    time limit counts.
    """

    def __init__(self, max_minutes: float | None) -> None:
        self.deadline = time.monotonic() + 60 * max_minutes if max_minutes else float("inf")
        self.signal: signal.Signals | None = None
        self.handlers: dict[signal.Signals, Any] = {}

    def __call__(self) -> bool:
        return self.signal is not None or time.monotonic() >= self.deadline

    def reason(self) -> str:
        """Say what ended the training."""
        return "the time given is over" if self.signal is None else f"ended by {self.signal.name}"

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            self.handlers = {s: signal.signal(s, self._record) for s in (signal.SIGTERM, signal.SIGINT)}
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._restore()
        if kind is None and self.signal is not None:
            raise KeyboardInterrupt

    def _record(self, number: int, _: object) -> None:
        self.signal = signal.Signals(number)
        self._restore()

    def _restore(self) -> None:
        while self.handlers:
            signal.signal(*self.handlers.popitem())
