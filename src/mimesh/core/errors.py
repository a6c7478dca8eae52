"""The exception for errors that a user can cause and repair."""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar

LONGEST_MESSAGE = 1000
"""Characters of a message: names and numbers in a damaged file may have any length."""


class InputError(ValueError):
    """A wrong file or argument. The message is one line: what was expected, what was found, what to do.

    Everything that a program or a user can get wrong raises it, but for calls with arguments that a function does not
    have: these raise Python's `TypeError`. It is a `ValueError`.

    Example:
        >>> try:
        ...     mimesh.load_mesh("missing.obj")
        ... except mimesh.InputError as error:
        ...     print(error)
        missing.obj: expected a file or folder, found nothing of that name; check the path
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class NotInstalledError(InputError):
    """A package or program that a format needs is not installed."""


class OtherTopologyError(InputError):
    """A frame of a clip that has other triangles than the first."""


class RefusedMeshError(InputError):
    """A mesh that a method would tear: of two meshes one is a person, say, and the other one no person."""


def damaged(path: object, expected: str, found: object) -> InputError:
    """Return the error for a file that contradicts its standard, or itself."""
    return InputError(f"{path}: expected {expected}, found {found}; the file is damaged, export it again")


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


def python_name(name: str, value: object = None) -> str:
    """Name an argument of Python: root, root=..., root="drop", ground=False."""
    if value is None:
        return name
    bare = isinstance(value, bool) or str(value).isdigit()
    return f"{name}=..." if value is ... else f"{name}={value}" if bare else f'{name}="{value}"'


def command_line_name(name: str, value: object = None) -> str:
    """Name an option of the command line: --root, --root drop, --no-ground."""
    flag = "-m" if name == "model" and value is not None else "--" + name.replace("_", "-")
    if value is False:
        return flag.replace("--", "--no-", 1)
    return flag if value is None or value is ... else f"{flag} {value}"


# A context variable belongs to its thread: a program may run a command in one and call functions in another.
_names: ContextVar[Callable[[str, object], str]] = ContextVar("names of options in messages", default=python_name)


def option(name: str, value: object = None) -> str:
    """Name an option in a message as the front end does that runs.

    Args:
        name: the field of `core.options`, or another argument of Python.
        value: what to give, or ... for "some value".
    """
    return _names.get()(name, value)


@contextlib.contextmanager
def naming_options(names: Callable[[str, object], str] = command_line_name) -> Iterator[None]:
    """Name options in messages by a function of name and value, inside a `with` block, for the calling thread."""
    token = _names.set(names)
    try:
        yield
    finally:
        _names.reset(token)


def on_command_line() -> bool:
    """Whether messages are for the command line."""
    return _names.get() is command_line_name
