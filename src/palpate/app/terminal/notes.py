"""Sentences to the person at the keyboard: below a table, or notes on standard error."""

from collections.abc import Iterable

from palpate.app.terminal.output import print_text
from palpate.errors import print_message


def print_notes(notes: Iterable[str]) -> None:
    """Print what was mended, converted or looks implausible on stderr, one line each.

    Parameters
    ----------
    notes : iterable of str
    """
    for note in notes:
        print_message(f"note: {note}")


def print_file_notes(notes: Iterable[tuple[str, str]], *, files: int) -> None:
    """Print each note once, with the file that it is about, or how many they are.

    Parameters
    ----------
    notes : iterable of two str     name of a file, note about it
    files : int                     all of them
    """
    names: dict[str, list[str]] = {}
    for name, note in notes:
        names.setdefault(note, []).append(name)
    for note, each in names.items():
        whose = each[0] if len(each) == 1 else f"{len(each)} of {files} files"
        print_text(f"Note ({whose}): {note}")
