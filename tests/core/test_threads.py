"""Two functions at once: both know what the caller knows, and errors of both are raised. Threads of linear algebra."""

from __future__ import annotations

import threading

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from mimesh.core.arguments import public
from mimesh.core.errors import InputError, naming_options, option
from mimesh.core.threads import LINEAR_ALGEBRA, both


def test_both_run_at_once_in_the_context_of_the_caller():
    """Each waits for the other; messages of both name options as the front end does."""
    meet = threading.Barrier(2, timeout=10)

    def name() -> str:
        meet.wait()
        return option("driving_up")

    with naming_options():
        assert both(name, name) == ("--driving-up", "--driving-up")


@pytest.mark.parametrize("which", [0, 1])
def test_an_error_of_either_is_raised(which):
    def fail() -> None:
        raise InputError("too far")

    functions = [lambda: None, lambda: None]
    functions[which] = fail
    with pytest.raises(InputError, match="too far"):
        both(*functions)


def threads() -> set[int]:
    """Return how many threads the libraries of linear algebra have."""
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture
def two_threads(monkeypatch):
    for name in LINEAR_ALGEBRA:
        monkeypatch.delenv(name, raising=False)
    with threadpool_limits(2, user_api="blas"):
        yield


def test_linear_algebra_has_one_thread_while_public_functions_run(two_threads):
    """The second one, in another thread, begins before the first one ends, and ends after it."""
    began, ended, seen = threading.Event(), threading.Event(), []

    @public
    def second() -> None:
        began.set()
        assert ended.wait(10)

    beside = threading.Thread(target=second)

    @public
    def first() -> None:
        beside.start()
        assert began.wait(10)
        public(lambda: seen.append(threads()))()
        seen.append(threads())

    first()
    ended.set()
    beside.join()
    assert seen == [{1}, {1}]
    assert threads() == {2}


def test_an_error_sets_the_threads_back(two_threads):
    @public
    def fail() -> None:
        raise InputError("too far")

    with pytest.raises(InputError):
        fail()
    assert threads() == {2}


def test_threads_that_the_environment_names_stay(two_threads, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    assert public(threads)() == {2}
