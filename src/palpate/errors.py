"""Error classes of Palpate. Bad input raises; a numerical outcome is data (`Status`)."""

from datetime import date, time

# Longest quoted value, and longest message, in characters: no more than a terminal shows.
_MOST_QUOTED, _MOST_SAID = 80, 1200


def quoted(value: object) -> str:
    """A value as error messages quote it: its `repr`, with the middle elided if it is long.

    Parameters
    ----------
    value : anything                as given by the user; dates and times are shown in ISO format
    """
    try:
        if isinstance(value, date | time):
            return value.isoformat()
        return _cut(repr(value), _MOST_QUOTED)
    except (ValueError, RecursionError):
        return "a number of too many digits, or lists in lists without end"


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 3 :]}"


class PalpateError(Exception):
    """Base class of all errors that Palpate raises deliberately; the text says what to do."""

    def __str__(self) -> str:
        # A name from a file may contain line breaks or terminal control characters: escape them.
        text = _cut(super().__str__(), _MOST_SAID)
        return "".join(one if one.isprintable() else repr(one)[1:-1] for one in text)


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
