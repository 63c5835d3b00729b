"""SHA-256 sums of files, in the format of `sha256sum`, and which files have changed since."""

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

from palpate.files import checked_file
from palpate.records.files.rig_covariance import covariance_file
from palpate.records.files.session import session_file
from palpate.records.text import read_text, read_toml

CHANGED, MISSING, NOT_LISTED = "changed", "missing", "not listed"
# What `sha256sum` puts before and into a name that holds a backslash or a line break.
_ESCAPES = {"\\": "\\\\", "\n": "\\n", "\r": "\\r"}


def file_sum(path: Path) -> str:
    """SHA-256 of a file's content, 64 hexadecimal digits.

    Parameters
    ----------
    path : Path

    Raises
    ------
    RecordError                     not there, no regular file, too large
    OSError                         not readable
    """
    with checked_file(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def file_sums(files: Iterable[Path], *, start: Path) -> dict[str, str]:
    """Sums of some files, by their paths from a folder.

    Parameters
    ----------
    files : iterable of Path        of a folder the files in it
    start : Path                    the folder that the paths start from

    Returns
    -------
    dict of str to str              sorted; names with `/`

    Raises
    ------
    OSError                         one cannot be read
    """
    single = chain.from_iterable(_files_in(path) for path in files)
    below = {Path(os.path.relpath(file, start)).as_posix(): file for file in single}
    return {name: file_sum(file) for name, file in sorted(below.items())}


def sums_text(sums: Mapping[str, str]) -> str:
    """Sums as `sha256sum` writes them and `sha256sum -c` reads them.

    Parameters
    ----------
    sums : mapping of name to sum

    Returns
    -------
    str                             one line a file
    """
    lines = []
    for name, value in sums.items():
        plain = re.sub(r"[\\\n\r]", lambda found: _ESCAPES[found[0]], name)
        lines.append(f"{'' if plain == name else chr(92)}{value}  {plain}\n")
    return "".join(lines)


def parsed_sums(text: str) -> dict[str, str]:
    """Sums from such a text; lines that are none, as comments, are left out.

    Parameters
    ----------
    text : str

    Returns
    -------
    dict of name to sum
    """
    real = {escape: character for character, escape in _ESCAPES.items()}
    sums = {}
    for escaped, value, name in re.findall(r"(?m)^(\\?)([0-9a-f]{64})  (.+)$", text):
        sums[re.sub(r"\\.", lambda e: real.get(e[0], e[0]), name) if escaped else name] = value
    return sums


def changes(folder: Path, sums: Mapping[str, str]) -> dict[str, str]:
    """Files that have changed since their sums were taken.

    Parameters
    ----------
    folder : Path                   that the names start from
    sums : mapping of name to sum

    Returns
    -------
    dict of str to str              name to `CHANGED` or `MISSING`; empty where all is as it was

    Raises
    ------
    OSError                         one cannot be read
    """
    found = {}
    for name, value in sums.items():
        path = folder / name
        if not path.is_file():
            found[name] = MISSING
        elif file_sum(path) != value:
            found[name] = CHANGED
    return found


def session_files(path: Path | str) -> list[Path]:
    """All files that a session is made of: itself, and what its texts name.

    Parameters
    ----------
    path : path                     folder of the session, or a session file in it

    Returns
    -------
    list of Path                    sorted; `{camera}` stands for any name

    Raises
    ------
    RecordError                     no session, not readable
    """
    file = session_file(Path(path))
    found, values = {file}, read_toml(file).values
    for text in _texts(values):
        pattern = "*".join(re.sub(r"([*?[])", r"[\1]", part) for part in text.split("{camera}"))
        below = Path(pattern)
        if "\0" in text or not below.name or len(text) > 1000:
            continue
        top = Path(below.anchor) if below.is_absolute() else file.parent
        found |= set(top.glob(str(below.relative_to(below.anchor))))
    rig = values.get("rig")
    if isinstance(rig, dict) and isinstance(rig.get("cameras"), str):
        beside = covariance_file(file.parent / rig["cameras"])
        found |= {beside} if beside else set()
    return sorted(
        each for each in set(chain.from_iterable(map(_files_in, found))) if each.is_file()
    )


def _files_in(path: Path) -> list[Path]:
    """A path itself, or the regular files in a folder."""
    return [each for each in path.glob("*") if each.is_file()] if path.is_dir() else [path]


def _texts(value: Any) -> Iterator[str]:
    """All texts in a tree of tables and lists."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, (dict, list)):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _texts(item)


def sums_in(path: Path) -> dict[str, str]:
    """Sums from a file; none where there is no such file.

    Parameters
    ----------
    path : Path

    Raises
    ------
    RecordError                     not readable
    """
    return parsed_sums(read_text(path)) if path.is_file() else {}
