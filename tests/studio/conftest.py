"""Pages of studios, closed at the end of a test."""

from contextlib import ExitStack

import pytest
from studio_client import studio_client


@pytest.fixture
def visit():
    """A function that gives the page of a session, in a browser that has its cookie, or none with `entered=False`."""
    with ExitStack() as opened:
        yield lambda session, entered=True: opened.enter_context(studio_client(session, entered))
