"""What a person may have meant who wrote a word that is not there."""

import os
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

# Words are compared letter by letter: no name that is meant is longer.
_LONGEST_WORD, _MOST_NAMES = 100, 1000


def nearest_word(word: str, allowed: Sequence[str]) -> str:
    """Sentence part that offers the nearest allowed word, or nothing.

    Parameters
    ----------
    word : str                      as it was written
    allowed : sequence of str

    Returns
    -------
    str                             e.g. "; did you mean 'force'?", or empty
    """
    near = get_close_matches(word.lower()[:_LONGEST_WORD], allowed, n=1, cutoff=0.6)
    return f"; did you mean '{near[0]}'?" if near else ""


def nearest_file(path: Path, *, but: str = "") -> str:
    """Sentence part that offers the file of the nearest name in the same folder, or nothing.

    Parameters
    ----------
    path : Path                     that is not there
    but : str                       name of the file that asks, which it cannot mean

    Returns
    -------
    str                             as `nearest_word`; empty too where there is no such folder
    """
    try:
        beside = [name for name in os.listdir(path.parent) if name not in (path.name, but)]
        return nearest_word(path.name, sorted(beside)[:_MOST_NAMES])
    except (OSError, ValueError):
        return ""
