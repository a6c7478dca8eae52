"""The exception for errors that a user can cause and repair."""


class InputError(ValueError):
    """A wrong file or argument. The message is one line: what was expected, what was found, what to do."""
