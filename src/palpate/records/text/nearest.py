"""Suggestions of the nearest valid name for a misspelt one."""

import os
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

from palpate.errors import quoted

# Limits on what is compared, as the comparison takes quadratic time.
_LONGEST_WORD, _MAX_NAMES = 100, 1000


def nearest_word(word: str, allowed: Sequence[str]) -> str:
    """Part of an error message that suggests the nearest allowed word, if any.

    Parameters
    ----------
    word : str                      as written by the user
    allowed : sequence of str

    Returns
    -------
    str                             e.g. "; did you mean 'force'?", or empty
    """
    near = get_close_matches(word.lower()[:_LONGEST_WORD], allowed, n=1, cutoff=0.6)
    return f"; did you mean '{near[0]}'?" if near else ""


def not_allowed(word: str, allowed: Sequence[str]) -> str:
    """Part of an error message that quotes a word and lists those that are allowed in its place.

    Parameters
    ----------
    word : str                      as written by the user
    allowed : sequence of str

    Returns
    -------
    str                             e.g. "'forse'; did you mean 'force'? (allowed: force, name)"
    """
    return f"{quoted(word)}{nearest_word(word, allowed)} (allowed: {', '.join(allowed)})"


def nearest_file(path: Path, *, exclude: str = "") -> str:
    """Part of an error message that suggests the file with the nearest name in the same folder.

    Parameters
    ----------
    path : Path                     of the missing file
    exclude : str                   name of the referring file, which is never suggested

    Returns
    -------
    str                             as in `nearest_word`; also empty if there is no such folder
    """
    try:
        others = [name for name in os.listdir(path.parent) if name not in (path.name, exclude)]
        return nearest_word(path.name, sorted(others)[:_MAX_NAMES])
    except (OSError, ValueError):
        return ""
