"""Two functions at once."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def both(first: Callable[[], A], second: Callable[[], B]) -> tuple[A, B]:
    """Run two functions that do not depend on each other, the first in a thread of its own; return what they return.

    The thread has the context of the caller: messages of both name options alike (`errors.option`).
    """
    with ThreadPoolExecutor(1) as executor:
        beside = executor.submit(copy_context().run, first)
        here = second()
        return beside.result(), here
