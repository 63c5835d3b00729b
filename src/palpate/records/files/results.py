"""Result folders and files: what Palpate wrote, it knows again, and replaces nothing else."""

import errno
import hashlib
import json
import os
import shutil
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from palpate.disk import placed
from palpate.errors import InputError, RecordError
from palpate.records.files.sums import (
    NOT_LISTED,
    changes,
    file_sums,
    sums_in,
    sums_text,
)
from palpate.records.text import json_text, read_text, write_text

CONTENTS_FILE, INPUTS_FILE = "contents.txt", "inputs.txt"
RESULT_FORMAT = "palpate-result/1"
_EARLIER_MARK = "palpate result folder; files:"
SEAL_NAME = "sha256"
# Work of so many seconds is worth keeping its finished parts when it is stopped.
_WORTH_KEEPING = 60.0
# What a disk says that holds no more, or does not let one write.
_DISK = (
    errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.EFBIG,
    errno.ENAMETOOLONG, errno.EMFILE, errno.ENFILE,
)  # fmt: skip


def default_folder(session: Path, what: str) -> Path:
    """Folder in the current one, named after the session's folder (and its file, if unusual).

    Parameters
    ----------
    session : Path                  folder of a session, or a session file in it
    what : str                      kind of result, the end of the name

    Returns
    -------
    Path
    """
    path = session.resolve()
    folder, file = (path, "session") if path.is_dir() else (path.parent, path.stem)
    return Path(f"{folder.name}-{what}" if file == "session" else f"{folder.name}-{file}-{what}")


@contextmanager
def result_folder(target: Path | str, *, kind: str, force: bool = False) -> Iterator[Path]:
    """A folder to write into; it takes its final name when the block ends well, else vanishes.

    An older result of the same kind is replaced if nothing in it was changed. Anything else stays:
    it is refused, or kept as NAME.old where `force` is given or it came up meanwhile.

    Parameters
    ----------
    target : path                   final name; its parent must be there
    kind : str                      the command that makes it, e.g. "fit"
    force : bool                    write although something else is there

    Yields
    ------
    Path                            folder beside the target, under another name

    Raises
    ------
    InputError                      the target is something else, is being written by another
                                    process, or cannot be written; raised before the block runs
    """
    target = Path(os.path.abspath(target))
    _check_place(target)
    strange = partial(_strange_folder, kind=kind)
    _refuse(target, strange(target), force=force)
    with (
        placed([target], folder=True, aside=strange) as (new,),
        _worth_keeping(parts_folder(new)),
        disk_errors(target),
    ):
        yield new
        sums = file_sums((path for path in new.rglob("*") if path.is_file()), start=new)
        head = f"# {RESULT_FORMAT} {kind}; `palpate verify` and `sha256sum -c` check it\n"
        write_text(new / CONTENTS_FILE, head + sums_text(sums))
    shutil.rmtree(parts_folder(new), ignore_errors=True)


@contextmanager
def _worth_keeping(parts: Path) -> Iterator[None]:
    """Remove finished parts where the block fails, unless they cost long work."""
    start = time.monotonic()
    try:
        yield
    except BaseException:
        if parts.exists() and time.monotonic() - start > _WORTH_KEEPING:
            said = f"finished parts are kept in {parts}: run again to go on"
            print(f"palpate: note: {said}", file=sys.stderr)
        else:
            shutil.rmtree(parts, ignore_errors=True)
        raise


def parts_folder(folder: Path) -> Path:
    """Where finished parts of a result outlive a process that is killed; maybe not there.

    Parameters
    ----------
    folder : Path                   as `result_folder` gives it

    Returns
    -------
    Path
    """
    return folder.with_suffix(".parts")


def record_inputs(folder: Path, files: Iterable[Path]) -> None:
    """Note in a result what it is made from, so that `palpate verify` can tell what has changed.

    Parameters
    ----------
    folder : Path                   as `result_folder` gives it
    files : iterable of Path

    Raises
    ------
    RecordError                     one cannot be read, or the note not be written
    """
    write_text(folder / INPUTS_FILE, sums_text(_sums(files, folder)))


@contextmanager
def result_file(target: Path, *, force: bool = False) -> Iterator[Path]:
    """A JSON file to write; what is there is replaced only if `sealed` made it.

    Parameters
    ----------
    target : Path                   final name; its folder must be there
    force : bool                    write although something else is there, kept as NAME.old

    Yields
    ------
    Path                            file beside the target, under another name

    Raises
    ------
    InputError                      as `result_folder`
    """
    if target.exists() and not target.is_file():
        kind = "a folder" if target.is_dir() else "no regular file"
        raise InputError(f"{target}: is {kind}; name a file with --out")
    _refuse(target, _strange_file(target), force=force)
    with (
        placed([target], aside=lambda old: bool(_strange_file(old))) as (new,),
        disk_errors(target),
    ):
        yield new


def check_free(target: Path, *, force: bool = False) -> None:
    """Refuse to replace a file that cannot tell whose it is: a picture, a table, a page.

    Parameters
    ----------
    target : Path                   that is to be written
    force : bool                    a regular file may be replaced

    Raises
    ------
    InputError                      something is there
    """
    if not os.path.lexists(target) or (force and target.is_file()):
        return
    raise InputError(
        f"{target}: is there already; nothing was touched: choose another name"
        + (", or give --force to replace it" if target.is_file() else "")
    )


def sealed(content: Mapping[str, Any], inputs: Iterable[Path], *, folder: Path) -> str:
    """JSON of a result with the sums of its inputs and, as its last key, its own.

    Parameters
    ----------
    content : mapping               with a `format`
    inputs : iterable of Path       what it is made from
    folder : Path                   that the file will lie in

    Returns
    -------
    str

    Raises
    ------
    RecordError                     an input cannot be read
    """
    whole = {**content, "inputs": _sums(inputs, folder)}
    return json_text({**whole, SEAL_NAME: hashlib.sha256(json_text(whole).encode()).hexdigest()})


def is_sealed(text: str) -> bool:
    """Whether a text is what `sealed` gave, to the letter.

    Parameters
    ----------
    text : str
    """
    try:
        content = json.loads(text)
        value = content.pop(SEAL_NAME)
        own = json_text(content)
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
        return False
    same = hashlib.sha256(own.encode()).hexdigest() == value
    return same and text == json_text({**content, SEAL_NAME: value})


def folder_changes(folder: Path) -> tuple[str, dict[str, str], dict[str, str]]:
    """The kind of a result folder, what in it is not as it was written, and all its sums.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    kind : str                      empty: it is no result of this version
    changes : dict of str to str    name to "changed", "missing" or "not listed"
    sums : dict of str to str       name to sum, of all that was written

    Raises
    ------
    RecordError                     it cannot be read
    """
    kind = _kind(folder)
    if not kind:
        return "", {}, {}
    try:
        sums = sums_in(folder / CONTENTS_FILE)
        there = {path.relative_to(folder).as_posix() for path in _everything(folder)}
        strangers = sorted(there - {*sums, CONTENTS_FILE})
        return kind, changes(folder, sums) | dict.fromkeys(strangers, NOT_LISTED), sums
    except OSError as error:
        raise RecordError(f"{error.filename}: cannot be read ({error.strerror})") from error


@contextmanager
def disk_errors(target: Path) -> Iterator[None]:
    """Turn what a disk refuses within the block into a message.

    Parameters
    ----------
    target : Path                   that is being written, for the message

    Raises
    ------
    RecordError
    """
    try:
        yield
    except OSError as error:
        # What was read may be to blame; what is written has the target's name in its path.
        elsewhere = os.path.isabs(str(error.filename)) and target.name not in str(error.filename)
        if error.errno not in _DISK or elsewhere:
            raise
        raise RecordError(
            f"{target}: cannot be written ({error.strerror}); nothing was changed: make room, or"
            " choose another place with --out"
        ) from error


def _sums(files: Iterable[Path], folder: Path) -> dict[str, str]:
    try:
        return file_sums(files, start=folder)
    except OSError as error:
        raise RecordError(f"{error.filename}: cannot be read ({error.strerror})") from error


def _check_place(target: Path) -> None:
    """Refuse a place where no folder can be made, or that somebody stands in."""
    if not target.parent.is_dir():
        raise InputError(
            f"{target}: the result folder cannot be written: {target.parent} is not a folder;"
            " make it first, or choose another place with --out"
        )
    if target.is_symlink() or (target.exists() and not target.is_dir()):
        raise InputError(f"{target}: is not a folder; choose another name with --out")
    real, here = Path(os.path.realpath(target)), Path.cwd()
    if real in (here, *here.parents, Path(os.path.expanduser("~"))):
        raise InputError(
            f"{target}: a result takes the place of a whole folder, and this one holds more than"
            " that; name a new folder in it with --out"
        )


def _refuse(target: Path, strange: str, *, force: bool) -> None:
    if strange and not force:
        raise InputError(
            f"{target}: {strange}; nothing was touched: choose another place with --out, or give"
            f" --force to keep that as {target.name}.old"
        )


def _strange_folder(target: Path, kind: str) -> str:
    """Why a folder is not an unchanged result of some kind; empty where it is, or is empty."""
    if not target.is_dir():
        return ""
    try:
        names = sorted(os.listdir(target))
    except OSError as error:
        raise RecordError(f"{target}: cannot be read ({error.strerror})") from error
    if not names:
        return ""
    found, changed, _ = folder_changes(target)
    if not found:
        if _EARLIER_MARK in _first_line(target):
            return "is a result of an earlier version, which cannot tell whether it was changed"
        return f"holds files that are no result of Palpate's, e.g. {_few(names)}"
    if changed:
        whole = [f"{name} ({how})" for name, how in changed.items()]
        return f"is a result that was changed since: {_few(whole)}"
    return "" if found == kind else f"is a result of `palpate {found}`"


def _strange_file(target: Path) -> str:
    """Why a file is not an unchanged result; empty where it is, or is not there."""
    if not os.path.lexists(target):
        return ""
    try:
        text = read_text(target)
    except RecordError:
        return "is no result of Palpate's"
    if is_sealed(text):
        return ""
    mark = '"format": "palpate-' in text[:200]
    return "is a result that was changed since" if mark else "is no result of Palpate's"


def _kind(folder: Path) -> str:
    """What the first line of a result folder's contents says of its kind."""
    mark, _, rest = _first_line(folder).removeprefix("# ").partition(" ")
    return rest.partition(";")[0] if mark == RESULT_FORMAT else ""


def _first_line(folder: Path) -> str:
    contents = folder / CONTENTS_FILE
    with suppress(RecordError):
        return read_text(contents).partition("\n")[0] if contents.is_file() else ""
    return ""


def _everything(folder: Path) -> Iterator[Path]:
    """All files and links below a folder; links are not followed."""
    for top, folders, files in os.walk(folder, onerror=_raised):
        links = [name for name in folders if os.path.islink(os.path.join(top, name))]
        yield from (Path(top, name) for name in (*files, *links))


def _raised(error: OSError) -> None:
    raise error


def _few(names: list[str]) -> str:
    """The first names of a list, short, and how many there are besides."""
    shown = ", ".join(name if len(name) <= 40 else f"{name[:37]}..." for name in names[:3])
    return shown + (f" and {len(names) - 3} more" if len(names) > 3 else "")
