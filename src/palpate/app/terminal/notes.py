"""Notes to the person at the keyboard, on standard error."""

import sys
from collections.abc import Iterable


def print_notes(notes: Iterable[str]) -> None:
    """Print what was mended, converted or looks implausible, one line each.

    Parameters
    ----------
    notes : iterable of str
    """
    for note in notes:
        print(f"palpate: note: {note}", file=sys.stderr)
