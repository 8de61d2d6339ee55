"""Errors that a user can cause and cure.

The text of an error is one line. It says where the error happened (file, line or field), what is wrong, and how to cure
it. The command line prints the text and exits with code 2. The user never sees a traceback for such an error.
"""


class SugiyamaError(Exception):
    """Base class of all errors that a user can cause."""


class InputError(SugiyamaError):
    """An input cannot be used: a file, a line of a file, an option or an argument."""


class OutputError(SugiyamaError):
    """An output cannot be written to the place that the user asked for."""
