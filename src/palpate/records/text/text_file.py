"""Whole text files, and names that people give to probings and cameras as names of files.

Every name that a file is written under comes through here, whoever wrote it: one that leads to
another folder, or to another one's file, is refused before anything is done.
"""

import os
import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path

from palpate.disk import write_bytes
from palpate.errors import InputError, RecordError, quoted
from palpate.files import read_bytes

# Characters that separate folders or that Windows allows in no name, and names of its devices.
_REFUSED_CHARACTERS = '/\\<>:"|?*'
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
# Endings that are appended to a stem; no other stem may coincide with the result.
_ENDINGS = ("", "_flow", "_quality")
# Longest name [bytes]: with any ending within the limit of file systems.
_LONGEST_NAME = 200
# Larger than any hand-written text or calibration; parsing more would take minutes.
_MAX_BYTES = 4 * 2**20


def check_file_names(
    names: Sequence[str],
    *,
    what: str,
    taken: Sequence[str] = (),
    kind: type[InputError] = InputError,
) -> None:
    """Refuse names of which a file system would not make one file each, where they are meant to be.

    Parameters
    ----------
    names : sequence of str
    what : str                      what they are names of, e.g. "probing", for the message
    taken : sequence of str         names that other files beside them have
    kind : class                    class of the error to raise

    Raises
    ------
    InputError of that kind         a name that holds a separator of folders, a control character or
                                    one that Windows refuses, begins with a dot, ends in one, is
                                    that of a device, too long or taken; two that differ only in
                                    case
    """
    known = {_key(name): name for name in taken}
    for name in names:
        if fault := _fault(name):
            raise kind(
                f"{what} {quoted(name)}: files are named after it, and its name {fault}; use"
                " letters, digits, -, _ and spaces"
            )
        if other := known.get(_key(name)):
            raise kind(
                f"{what} {quoted(name)}: there are files named {quoted(other)} already; names must"
                " be distinct, in more than upper and lower case"
            )
        known[_key(name)] = name


def _key(name: str) -> str:
    """What some file systems know a name by: upper case is lower case to them, and an accent may be
    written in two ways."""
    return unicodedata.normalize("NFC", name).casefold()


def _fault(name: str) -> str:
    """Why no file can have a name; empty: one can."""
    refused = [c for c in name if c in _REFUSED_CHARACTERS or not c.isprintable()]
    if refused:
        return f"holds {quoted(refused[0])}"
    if not name or name[0] in ". " or name[-1] in ". ":
        return "is empty, or begins or ends with a dot or a space"
    if len(os.fsencode(name)) > _LONGEST_NAME:
        return f"has {len(name)} characters, where files have at most {_LONGEST_NAME} bytes"
    return "is that of a device on Windows" if _DEVICE.fullmatch(name) else ""


def path_below(folder: Path, name: str) -> Path:
    """The path of a file named by untrusted input, if it is below a folder.

    Parameters
    ----------
    folder : Path
    name : str                      path relative to it

    Returns
    -------
    Path

    Raises
    ------
    RecordError                     it leads out of the folder
    """
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise RecordError(f"{name}: leads out of the folder that it is unpacked in")
    return folder / name


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
        stem = name if _is_plain(name) else fallback
        while taken & {_key(stem + ending) for ending in _ENDINGS}:
            stem = fallback if stem == name else f"{stem}-"
        taken |= {_key(stem + ending) for ending in _ENDINGS}
        stems.append(stem)
    return stems


def _is_plain(name: str) -> bool:
    """Whether a name is a file's on every system, needs no quotes and is no result's own file."""
    plain = name.replace("_", "").replace("-", "").replace(".", "")
    return plain.isalnum() and not _fault(name) and name.lower() != "contents"


def read_text(path: Path) -> str:
    """Content of a text file in UTF-8, without its byte order mark.

    Parameters
    ----------
    path : Path

    Returns
    -------
    str

    Raises
    ------
    RecordError                     missing, not readable, too large, not UTF-8
    """
    try:
        return read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordError(f"{path}: is not a text file in UTF-8; save it as such") from error


def write_text(path: Path | str, text: str) -> None:
    """Write a text file in UTF-8.

    Parameters
    ----------
    path : path
    text : str

    Raises
    ------
    RecordError                     the file cannot be written; it is then unchanged
    """
    write_bytes(Path(path), text.encode("utf-8", "surrogateescape"))
