"""Errors that a user can cause and cure.

The text of each is one line: where it happened (file, line or field), what is wrong, and the cure. The command line
prints it and exits with code 2; nothing else may end there in a traceback.
"""


class SugiyamaError(Exception):
    """Base of all errors that a user can cause."""


class InputError(SugiyamaError):
    """Something that was given cannot be used as it is: a file, a line of it, an option."""


class OutputError(SugiyamaError):
    """Something cannot be written where it was asked for."""
