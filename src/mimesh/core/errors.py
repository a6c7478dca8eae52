"""The exception for errors that a user can cause and repair."""

from collections.abc import Iterable

LONGEST_MESSAGE = 1000
"""Characters of a message: names and numbers in a damaged file may have any length."""


class InputError(ValueError):
    """A wrong file or argument. The message is one line: what was expected, what was found, what to do."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def one_line(message: str) -> str:
    """Join the lines of a message, and leave out the middle of a long one: its end says what to do."""
    line = " ".join(message.splitlines())
    if len(line) <= LONGEST_MESSAGE:
        return line
    return f"{line[: LONGEST_MESSAGE // 2]} ... {line[-LONGEST_MESSAGE // 3 :]}"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the end of a message that names the known word nearest to the one found: "; did you mean npt?", or ""."""
    from difflib import get_close_matches

    by_lower = {name.lower(): name for name in known}
    close = get_close_matches(word.lower(), by_lower, 1)
    return f"; did you mean {by_lower[close[0]]}?" if close else ""
