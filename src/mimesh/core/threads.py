"""Threads: two functions at once, and how many linear algebra has."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from functools import lru_cache
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

A = TypeVar("A")
B = TypeVar("B")

LINEAR_ALGEBRA = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables of the threads of linear algebra, which its libraries read when they are loaded."""


def both(first: Callable[[], A], second: Callable[[], B]) -> tuple[A, B]:
    """Run two functions that do not depend on each other, the first in a thread of its own; return what they return.

    The thread has the context of the caller: messages of both name options alike (`errors.option`).
    """
    with ThreadPoolExecutor(1) as executor:
        beside = executor.submit(copy_context().run, first)
        here = second()
        return beside.result(), here


@contextmanager
def one_thread() -> Iterator[None]:
    """Let linear algebra have one thread in this context, unless the environment says how many it has.

    Products are small here. A second thread gains little, and on a busy machine the first waits for it by spinning:
    transfers take 2.5 times as long (benchmarks/threads.json). The limit is of the whole process, and of contexts that
    overlap in time the first one's.
    """
    if any(os.environ.get(name) for name in LINEAR_ALGEBRA):
        yield
    else:
        with _libraries(len(sys.modules)).limit(limits=1):
            yield


@lru_cache(maxsize=1)
def _libraries(_modules: int) -> ThreadpoolController:
    """Return the libraries of linear algebra that are loaded: 2 ms, so again only after imports."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")
