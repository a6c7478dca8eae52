"""Waiting for what other threads do: for a state, not for a time, and long enough for a busy machine."""

import time
from collections.abc import Callable
from typing import Any


def wait_until(condition: Callable[[], Any], seconds: float = 120.0) -> Any:
    """Wait until a condition holds, and return what it returned; fails after so many seconds.

    It is asked ever more rarely: to ask a server all the time takes as long as what it waits for.
    """
    end, pause = time.monotonic() + seconds, 0.005
    while not (found := condition()):
        assert time.monotonic() < end, "the condition did not come to hold"
        time.sleep(pause)
        pause = min(1.5 * pause, 0.2)
    return found


def finished(session: Any, seconds: float = 120.0) -> Any:
    """Wait until a studio's session has the result, or the error, of its only mesh; returns the mesh."""

    def item() -> Any:
        first = next(iter(session.identities.values()), None)
        outcome = first and first.outcome
        return first if outcome is not None and (outcome.current or outcome.error) else None

    return wait_until(item, seconds)
