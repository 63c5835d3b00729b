"""Error classes of Palpate. Bad input raises; a numerical outcome is data (`Status`)."""

from datetime import date, time

# A value is quoted up to here, and a whole message is no longer than a terminal shows.
_MOST_QUOTED, _MOST_SAID = 80, 1200


def quoted(value: object) -> str:
    """A value as messages quote it: as Python writes it, without the middle where it is long.

    Parameters
    ----------
    value : anything                that a user wrote
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
    """Anything that Palpate raises on purpose; its text says what to do."""

    def __str__(self) -> str:
        # A name in a file may hold what ends a line, or what a terminal obeys.
        text = _cut(super().__str__(), _MOST_SAID)
        return "".join(one if one.isprintable() else repr(one)[1:-1] for one in text)


class InputError(PalpateError, ValueError):
    """A value given by the caller is out of its range or of the wrong shape."""


class MeshError(InputError):
    """A triangle surface that is not the closed boundary of one solid."""


class RecordError(InputError):
    """A file (session, displacement, estimate) that cannot be read as what it claims to be."""


class InUseError(InputError):
    """Another process is writing the same file or folder."""


class CalibrationError(InputError):
    """Camera parameters that are contradictory or do not fit their images."""


class SingularSystemError(PalpateError):
    """The linear system of the model has no unique solution, e.g. too small a support."""


class NotConvergedError(PalpateError):
    """An iteration stopped before it reached its tolerance."""
