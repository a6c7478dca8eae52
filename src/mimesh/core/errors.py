"""The exception for errors that a user can cause and repair."""

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
