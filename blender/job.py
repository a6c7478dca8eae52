# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs mimesh in a thread that does not access Blender's data, reports progress and can be cancelled."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Made = TypeVar("Made")
Progress = Callable[[int, int], None]
PANEL_NAMES = {
    "model": "the model",
    "up": "up of the identity (Facing)",
    "front": "the front of the identity (Facing)",
    "driving_up": "up of the driving (Facing)",
    "driving_front": "the front of the driving (Facing)",
    "body": "Both are",
    "skinned": "New armature",
    "rig": "Own armature",
    "smooth": "Smoothing",
    "root": "Root motion",
}
"""Options of mimesh -> what the panel calls them."""


def panel_name(name: str, value: object = None) -> str:
    """Name an option in a message of mimesh, with a value to choose, as the panel does."""
    known = PANEL_NAMES.get(name, name.replace("_", " "))
    return known if value is None or value is ... else f"{known}: {value}"


def driving_name(name: str, value: object = None) -> str:
    """As `panel_name`, where the driving alone is looked at."""
    return panel_name(f"driving_{name}" if f"driving_{name}" in PANEL_NAMES else name, value)


class Cancelled(Exception):
    """Raised inside a cancelled job."""


class Job(Generic[Made]):
    """One call of mimesh in a thread.

    `fraction` is the progress from 0 to 1; once `running` is false, `result` returns the result or raises the error.
    """

    def __init__(self, call: Callable[[Progress], Made], names: Callable[..., str] = panel_name) -> None:
        """`names` names options in messages, as `panel_name`."""
        self.fraction = 0.0
        self._call, self._names = call, names
        self._result: Made | None = None
        self._error: Exception | None = None
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._work, name="mimesh", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def cancel(self) -> None:
        """Stop at the next frame; returns at once."""
        self._cancelled.set()

    def wait(self, seconds: float) -> None:
        """Wait for the end, for at most so many seconds."""
        self._thread.join(seconds)

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    def result(self) -> Made:
        """Return the result of the call.

        Raises:
            InputError: as the call; any other error of it, too.
        """
        if self._error is not None:
            raise self._error
        assert self._result is not None, "the job has not ended"
        return self._result

    def _work(self) -> None:
        try:
            from mimesh.core.errors import naming_options

            with naming_options(self._names):
                self._result = self._call(self._progress)
        except Exception as error:  # raised again by `result`, in the main thread
            self._error = error

    def _progress(self, done: int, total: int) -> None:
        if self._cancelled.is_set():
            raise Cancelled
        self.fraction = done / total
