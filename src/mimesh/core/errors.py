"""The exception for errors that a user can cause and repair."""

import contextlib
from collections.abc import Iterable, Iterator
from contextvars import ContextVar

LONGEST_MESSAGE = 1000
"""Characters of a message: names and numbers in a damaged file may have any length."""
# A context variable belongs to its thread: a program may run a command in one and call functions in another.
_command_line: ContextVar[bool] = ContextVar("messages of mimesh name options", default=False)


class InputError(ValueError):
    """A wrong file or argument. The message is one line: what was expected, what was found, what to do.

    Everything that a program or a user can get wrong raises it; it is a `ValueError`. Calls with arguments that a
    function does not have raise a subclass that is a `TypeError`, too.

    Example:
        >>> try:
        ...     mimesh.load_mesh("missing.obj")
        ... except mimesh.InputError as error:
        ...     print(error)
        missing.obj: expected a file or folder, found nothing of that name; check the path
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class RefusedMeshError(InputError):
    """A mesh that a method would tear: of two meshes one is a person, say, and the other one no person."""


def one_line(message: str) -> str:
    """Join the lines of a message, and leave out the middle of a long one: its end says what to do."""
    line = " ".join(message.splitlines())
    if len(line) <= LONGEST_MESSAGE:
        return line
    return f"{line[: LONGEST_MESSAGE // 2]} ... {line[-LONGEST_MESSAGE // 3 :]}"


def did_you_mean(word: str, known: Iterable[str], similarity: float = 0.6) -> str:
    """Return the end of a message that names the known word nearest to the one found: "; did you mean npt?", or ""."""
    from difflib import get_close_matches

    by_lower = {name.lower(): name for name in known}
    close = get_close_matches(word.lower(), by_lower, 1, similarity)
    return f"; did you mean {by_lower[close[0]]}?" if close else ""


@contextlib.contextmanager
def command_line_words() -> Iterator[None]:
    """Leave options of the command line in messages inside a `with` block, for the calling thread.

    Elsewhere public functions name arguments of Python; see `core.arguments`.
    """
    token = _command_line.set(True)
    try:
        yield
    finally:
        _command_line.reset(token)


def names_options() -> bool:
    """Whether messages name options of the command line."""
    return _command_line.get()
