"""The exception for errors that a user can cause and repair."""

from collections.abc import Iterable


class InputError(ValueError):
    """A wrong file or argument. The message is one line: what was expected, what was found, what to do."""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the end of a message that names the known word nearest to the one found: "; did you mean npt?", or ""."""
    from difflib import get_close_matches

    by_lower = {name.lower(): name for name in known}
    close = get_close_matches(word.lower(), by_lower, 1)
    return f"; did you mean {by_lower[close[0]]}?" if close else ""
