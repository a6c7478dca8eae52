# SPDX-License-Identifier: GPL-3.0-or-later
"""mimesh at work in a thread of its own, which touches nothing of Blender, says how far it is and can be stopped."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mimesh import Clip, ClipResult, Mesh

CONTROLS = {
    "give --driving-front": "choose a front of the driving (Facing)",
    "give --front": "choose a front of the identity (Facing)",
    "choose it with -m": "choose it as the model",
    "--skinned": "Armature",
}
"""What messages of mimesh say to those at the command line, and what it is called here."""


class Cancelled(Exception):
    """Raised inside the work once nobody wants its result."""


class Job:
    """One call of `mimesh.animate`.

    `fraction` goes from 0 to 1; once `running` is false, `result` gives what came out or raises what went wrong.
    """

    def __init__(self, identity: Mesh, driving: Clip, options: dict) -> None:
        self.fraction = 0.0
        self._inputs = identity, driving, options
        self._result: ClipResult | None = None
        self._error: Exception | None = None
        self._unwanted = threading.Event()
        self._thread = threading.Thread(target=self._work, name="mimesh", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def cancel(self) -> None:
        """Stop the work at its next step; the caller need not wait for that."""
        self._unwanted.set()

    def wait(self, seconds: float) -> None:
        """Wait for the end, but no longer than so many seconds."""
        self._thread.join(seconds)

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    def result(self) -> ClipResult:
        """What `mimesh.animate` gave.

        Raises:
            InputError: what it raised, as any other error of it.
        """
        if self._error is not None:
            raise self._error
        assert self._result is not None, "the work has not ended"
        return self._result

    def _work(self) -> None:
        identity, driving, options = self._inputs
        try:
            import mimesh

            self._result = mimesh.animate(identity, driving, progress=self._progress, **options)
        except Exception as error:  # raised again by `result`, in the thread that can tell the user
            self._error = error

    def _progress(self, done: int, total: int) -> None:
        if self._unwanted.is_set():
            raise Cancelled
        self.fraction = done / total


def spoken(message: str) -> str:
    """A message of mimesh in the words of the panel."""
    for option, name in CONTROLS.items():
        message = message.replace(option, name)
    return message
