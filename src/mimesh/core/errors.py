"""The one exception that a user can cause."""


class InputError(ValueError):
    """The user's file or argument is wrong. One line: what was expected, what was found, what to do."""
