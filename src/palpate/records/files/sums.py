"""SHA-256 checksums of files, in the format of `sha256sum`, and detection of changed files."""

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

from palpate.errors import RecordError
from palpate.files import checked_file
from palpate.records.files.rig_covariance import covariance_file
from palpate.records.files.session import session_file
from palpate.records.text.text_file import read_text
from palpate.records.text.toml_table import read_toml

CHANGED, MISSING, NOT_LISTED = "changed", "missing", "not listed"
# Escapes of `sha256sum` in names that contain a backslash or a line break.
_ESCAPES = {"\\": "\\\\", "\n": "\\n", "\r": "\\r"}


@contextmanager
def unreadable_errors() -> Iterator[None]:
    """Turn errors of the file system within the block, or the decorated function, into
    `RecordError`, which names the file.

    Raises
    ------
    RecordError                     in place of an OSError
    """
    try:
        yield
    except OSError as error:
        raise RecordError(f"{error.filename}: cannot be read ({error.strerror})") from error


def file_sum(path: Path) -> str:
    """SHA-256 of a file's content.

    Parameters
    ----------
    path : Path

    Returns
    -------
    str                             64 hexadecimal digits

    Raises
    ------
    RecordError                     missing, not a regular file, too large
    OSError                         not readable
    """
    with checked_file(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@unreadable_errors()
def file_sums(files: Iterable[Path], *, start: Path) -> dict[str, str]:
    """Checksums of some files, by their paths relative to a folder.

    Parameters
    ----------
    files : iterable of Path        a folder stands for the files in it
    start : Path                    folder that the paths are relative to

    Returns
    -------
    dict of str to str              path, with `/`, -> checksum; sorted by path

    Raises
    ------
    RecordError                     missing, not readable, not a regular file, too large
    """
    single = chain.from_iterable(_files_in(path) for path in files)
    by_name = {Path(os.path.relpath(file, start)).as_posix(): file for file in single}
    return {name: file_sum(file) for name, file in sorted(by_name.items())}


def sums_text(sums: Mapping[str, str]) -> str:
    """Checksums as text in the format of `sha256sum`, for `sha256sum -c`.

    Parameters
    ----------
    sums : mapping                  name -> checksum

    Returns
    -------
    str                             one line per file
    """
    lines = []
    for name, value in sums.items():
        plain = re.sub(r"[\\\n\r]", lambda found: _ESCAPES[found[0]], name)
        lines.append(f"{'' if plain == name else chr(92)}{value}  {plain}\n")
    return "".join(lines)


def parsed_sums(text: str) -> dict[str, str]:
    """Parse checksums in the format of `sha256sum`; other lines, such as comments, are ignored.

    Parameters
    ----------
    text : str

    Returns
    -------
    dict of str to str              name -> checksum
    """
    real = {escape: character for character, escape in _ESCAPES.items()}
    sums = {}
    for escaped, value, name in re.findall(r"(?m)^(\\?)([0-9a-f]{64})  (.+)$", text):
        sums[re.sub(r"\\.", lambda e: real.get(e[0], e[0]), name) if escaped else name] = value
    return sums


@unreadable_errors()
def changes(folder: Path, sums: Mapping[str, str]) -> dict[str, str]:
    """Files that have changed since their checksums were taken.

    Parameters
    ----------
    folder : Path                   folder that the names are relative to
    sums : mapping                  name -> checksum

    Returns
    -------
    dict of str to str              name -> `CHANGED` or `MISSING`; empty if nothing has changed

    Raises
    ------
    RecordError                     missing, not readable, not a regular file, too large
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
    """All files of a session: the session file, every file it names, and the rig's covariance.

    Parameters
    ----------
    path : path                     folder of the session, or a session file in it

    Returns
    -------
    list of Path                    sorted; `{camera}` in a name matches anything

    Raises
    ------
    RecordError                     no session, not readable
    """
    file = session_file(Path(path))
    found, values = {file}, read_toml(file).values
    for text in _texts(values):
        pattern = "*".join(re.sub(r"([*?[])", r"[\1]", part) for part in text.split("{camera}"))
        relative = Path(pattern)
        if "\0" in text or not relative.name or len(text) > 1000:
            continue
        start = Path(relative.anchor) if relative.is_absolute() else file.parent
        found |= set(start.glob(str(relative.relative_to(relative.anchor))))
    rig = values.get("rig")
    if isinstance(rig, dict) and isinstance(rig.get("cameras"), str):
        covariance = covariance_file(file.parent / rig["cameras"])
        found |= {covariance} if covariance else set()
    return sorted(
        each for each in set(chain.from_iterable(map(_files_in, found))) if each.is_file()
    )


def _files_in(path: Path) -> list[Path]:
    """A path itself, or the regular files in a folder."""
    return [each for each in path.glob("*") if each.is_file()] if path.is_dir() else [path]


def _texts(value: Any) -> Iterator[str]:
    """All texts in nested tables and lists."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, (dict, list)):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _texts(item)


def sums_in(path: Path) -> dict[str, str]:
    """Checksums from a file; empty if there is no such file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict of str to str              name -> checksum

    Raises
    ------
    RecordError                     not readable
    """
    return parsed_sums(read_text(path)) if path.is_file() else {}
