"""Names that people give to probings and motions as names of files."""

import os
from collections.abc import Sequence

# What is put behind a stem; another thing's name must not end up there.
_ENDINGS = ("", "_flow", "_quality")
# With any ending less than what file systems allow [bytes].
_LONGEST_STEM = 200


def file_stems(names: Sequence[str], *, kind: str) -> list[str]:
    """File names without their endings, one for each of k things, all different.

    Parameters
    ----------
    names : sequence of k str       of the things
    kind : str                      what they are, e.g. "motion"

    Returns
    -------
    list of k str                   a thing's own name, or `KIND-NUMBER` (from 1) where a system may
                                    refuse or hide a file so named, or where it would meet the files
                                    of an earlier one
    """
    stems: list[str] = []
    taken: set[str] = set()
    for number, name in enumerate(names, start=1):
        other = f"{kind}-{number}"
        stem = name if _names_file(name) else other
        # Some file systems do not tell upper from lower case.
        while taken & {(stem + ending).lower() for ending in _ENDINGS}:
            stem = other if stem == name else f"{stem}-"
        taken |= {(stem + ending).lower() for ending in _ENDINGS}
        stems.append(stem)
    return stems


def _names_file(name: str) -> bool:
    """Whether every system takes a name for a file's, and no file of a result is called so."""
    plain = name.replace("_", "").replace("-", "").replace(".", "")
    fits = plain.isalnum() and name[0] != "." and len(os.fsencode(name)) <= _LONGEST_STEM
    return fits and name.lower() != "contents"
