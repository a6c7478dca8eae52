# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs mimesh in a thread that does not access Blender's data, reports progress and can be cancelled."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mimesh import Clip, ClipResult, Mesh

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


class Cancelled(Exception):
    """Raised inside a cancelled job."""


class Job:
    """One call of `mimesh.animate` in a thread.

    `fraction` is the progress from 0 to 1; once `running` is false, `result` returns the result or raises the error.
    """

    def __init__(self, identity: Mesh, driving: Clip, options: dict) -> None:
        self.fraction = 0.0
        self._inputs = identity, driving, options
        self._result: ClipResult | None = None
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

    def result(self) -> ClipResult:
        """Return the result of `mimesh.animate`.

        Raises:
            InputError: as `mimesh.animate`; any other error of it, too.
        """
        if self._error is not None:
            raise self._error
        assert self._result is not None, "the job has not ended"
        return self._result

    def _work(self) -> None:
        identity, driving, options = self._inputs
        try:
            import mimesh
            from mimesh.core.errors import naming_options

            with naming_options(panel_name):
                self._result = mimesh.animate(identity, driving, progress=self._progress, **options)
        except Exception as error:  # raised again by `result`, in the main thread
            self._error = error

    def _progress(self, done: int, total: int) -> None:
        if self._cancelled.is_set():
            raise Cancelled
        self.fraction = done / total
