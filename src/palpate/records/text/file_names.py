"""Safe file names from the names of probings and motions."""

import os
from collections.abc import Sequence

# Endings that are appended to a stem; no other stem may coincide with the result.
_ENDINGS = ("", "_flow", "_quality")
# Longest stem [bytes]: with any ending within the limit of file systems.
_LONGEST_STEM = 200


def file_stems(names: Sequence[str], *, kind: str) -> list[str]:
    """File names without endings for k named items, all different.

    Parameters
    ----------
    names : sequence of k str       names of the items
    kind : str                      what they are, e.g. "motion"

    Returns
    -------
    list of k str                   an item's own name, or `KIND-NUMBER` (from 1) if a file system
                                    might refuse or hide that name, or if it would collide with the
                                    files of an earlier item
    """
    stems: list[str] = []
    taken: set[str] = set()
    for number, name in enumerate(names, start=1):
        fallback = f"{kind}-{number}"
        stem = name if _is_file_name(name) else fallback
        # Some file systems do not distinguish upper and lower case.
        while taken & {(stem + ending).lower() for ending in _ENDINGS}:
            stem = fallback if stem == name else f"{stem}-"
        taken |= {(stem + ending).lower() for ending in _ENDINGS}
        stems.append(stem)
    return stems


def _is_file_name(name: str) -> bool:
    """Whether a name is valid on every file system and not that of a result's own file."""
    plain = name.replace("_", "").replace("-", "").replace(".", "")
    fits = plain.isalnum() and name[0] != "." and len(os.fsencode(name)) <= _LONGEST_STEM
    return fits and name.lower() != "contents"
