"""Two functions at once: both know what the caller knows, and errors of both are raised."""

from __future__ import annotations

import threading

import pytest

from mimesh.core.errors import InputError, naming_options, option
from mimesh.core.threads import both


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
