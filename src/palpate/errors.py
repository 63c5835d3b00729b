"""Error classes of Palpate, and messages on the terminal. Bad input raises; a numerical outcome is
data (`Status`)."""

import sys
from datetime import date, time

# Longest quoted value, and longest message, in characters: no more than a terminal shows.
_MAX_QUOTED, _MAX_MESSAGE = 80, 1200


def quoted(value: object) -> str:
    """A value as error messages quote it: its `repr`, with the middle elided if it is long.

    Parameters
    ----------
    value : anything                as given by the user; dates and times are shown in ISO format

    Returns
    -------
    str                             at most 80 characters
    """
    try:
        if isinstance(value, date | time):
            return value.isoformat()
        return _elided(repr(value), _MAX_QUOTED)
    except (ValueError, RecursionError):
        return "a number of too many digits, or lists in lists without end"


def _elided(text: str, max_length: int) -> str:
    return (
        text
        if len(text) <= max_length
        else f"{text[: max_length // 2]} ... {text[-max_length // 3 :]}"
    )


def visible(text: str) -> str:
    """A line of text as it may be printed: names from files may hold what commands a terminal.

    Parameters
    ----------
    text : str

    Returns
    -------
    str                             line breaks, control characters and marks that turn the
                                    direction of writing are shown as in Python: `\\x1b`
    """
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def print_message(text: str) -> None:
    """Print a line on stderr, after the program's name.

    Parameters
    ----------
    text : str
    """
    print(f"palpate: {visible(text)}", file=sys.stderr)


def counted(count: int, what: str) -> str:
    """A number with its noun: 1 probing, 2 probings.

    Parameters
    ----------
    count : int
    what : str                      in the singular, of a regular plural
    """
    return f"{count} {what}{'s' * (count != 1)}"


class PalpateError(Exception):
    """Base class of all errors that Palpate raises deliberately; the text says what to do."""

    def __str__(self) -> str:
        return visible(_elided(super().__str__(), _MAX_MESSAGE))


class InputError(PalpateError, ValueError):
    """A value given by the caller is out of range or has the wrong shape."""


class MeshError(InputError):
    """A triangle surface that is not the closed boundary of one solid."""


class RecordError(InputError):
    """A file (session, displacement, estimate, ...) that cannot be read or written as intended."""


class InUseError(InputError):
    """Another process is writing the same file or folder."""


class CalibrationError(InputError):
    """Camera parameters that are inconsistent or do not fit their images."""


class SingularSystemError(PalpateError):
    """The linear system of the model has no unique solution, e.g. because the support is too small
    to prevent rigid motion."""


class NotConvergedError(PalpateError):
    """An iteration stopped before it reached its tolerance."""
