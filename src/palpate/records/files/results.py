"""Result folders: Palpate recognises its own unchanged results and replaces only them.

They are recognised by SHA-256 checksums of their files, in the format of `sha256sum`.
"""

import errno
import hashlib
import os
import re
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

from palpate.disk import atomic_replacement, put_back_interrupted
from palpate.errors import InputError, RecordError, print_message
from palpate.files import checked_file
from palpate.records.files.series import frame_files
from palpate.records.files.session import session_file
from palpate.records.rig import covariance_file
from palpate.records.text.text_file import read_text, write_text
from palpate.records.text.toml_table import nearest_file, read_toml

CONTENTS_FILE, INPUTS_FILE = "contents.txt", "inputs.txt"
_RESULT_FORMAT = "palpate-result/1"
_EARLIER_MARK = "palpate result folder; files:"
# The one file of a fit that may be made again.
REPORT_FILE = "report.html"
# Finished parts are kept after an interruption if the work took at least this long [s].
_MIN_SECONDS_TO_KEEP = 60.0
# Errors of a full, read-only or failing file system.
_DISK_ERRORS = (
    errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.EFBIG,
    errno.ENAMETOOLONG, errno.EMFILE, errno.ENFILE,
)  # fmt: skip
# Endings of files that people expect where a command writes a folder.
_FILE_ENDINGS = frozenset((
    ".ply", ".obj", ".stl", ".off", ".msh", ".vtu", ".csv", ".json", ".toml", ".npz", ".html",
    ".pdf", ".png", ".svg", ".xml",
))  # fmt: skip
CHANGED, MISSING, NOT_LISTED = "changed", "missing", "not listed"
# Escapes of `sha256sum` in names that contain a backslash or a line break.
_ESCAPES = {"\\": "\\\\", "\n": "\\n", "\r": "\\r"}


def default_folder(session: Path, what: str) -> Path:
    """Default name of a result folder, after the session's folder (and file, if not session.toml).

    Parameters
    ----------
    session : Path                  folder of a session, or a session file in it
    what : str                      kind of result, with which the name ends

    Returns
    -------
    Path                            relative to the current folder
    """
    path = session.resolve()
    folder, file = (path, "session") if path.is_dir() else (path.parent, path.stem)
    return Path(f"{folder.name}-{what}" if file == "session" else f"{folder.name}-{file}-{what}")


@contextmanager
def result_folder(target: Path | str, *, kind: str, force: bool = False) -> Iterator[Path]:
    """A temporary folder to write into; renamed to the target if the block succeeds, else removed.

    An older result of the same kind is replaced if it is unchanged. Anything else at the target is
    refused, or kept as NAME.old if `force` is given or it appeared while the block was running.

    Parameters
    ----------
    target : path                   final name; its parent must exist
    kind : str                      the command that makes it, e.g. "fit"
    force : bool                    write even if something else lies there

    Yields
    ------
    Path                            temporary folder next to the target

    Raises
    ------
    InputError                      something else lies at the target, another process is writing
                                    there, or it cannot be written; raised before the block runs
    """
    target = Path(os.path.abspath(target))
    _check_place(target)
    objection = partial(_folder_objection, kind=kind)
    _refuse(target, objection(target), force=force)
    with (
        atomic_replacement(target, folder=True, keep_old=objection) as new,
        _keep_long_work(parts_folder(new)),
        disk_errors(target),
    ):
        yield new
        sums = file_sums((path for path in new.rglob("*") if path.is_file()), start=new)
        head = f"# {_RESULT_FORMAT} {kind}; `sha256sum -c` checks it\n"
        # Not by `write_text`: a lock that cannot be removed would lie there, and not be listed.
        (new / CONTENTS_FILE).write_bytes(
            (head + sums_text(sums)).encode("utf-8", "surrogateescape")
        )
    shutil.rmtree(parts_folder(new), ignore_errors=True)


@contextmanager
def _keep_long_work(parts: Path) -> Iterator[None]:
    """Remove finished parts if the block fails, unless they took long to compute."""
    start = time.monotonic()
    try:
        yield
    except BaseException:
        if parts.exists() and time.monotonic() - start > _MIN_SECONDS_TO_KEEP:
            print_message(f"note: finished parts are kept in {parts}: run again to go on")
        else:
            shutil.rmtree(parts, ignore_errors=True)
        raise


def parts_folder(folder: Path) -> Path:
    """Folder in which finished parts of a result survive an interruption; it may not exist.

    Parameters
    ----------
    folder : Path                   temporary folder from `result_folder`

    Returns
    -------
    Path
    """
    return folder.with_suffix(".parts")


def record_inputs(folder: Path, files: Iterable[Path]) -> None:
    """Record the checksums of a result's input files, so that changes can be detected.

    Parameters
    ----------
    folder : Path                   temporary folder from `result_folder`
    files : iterable of Path        input files, or folders of such

    Raises
    ------
    RecordError                     an input cannot be read, or the record cannot be written
    """
    write_text(folder / INPUTS_FILE, sums_text(file_sums(files, start=folder)))


def check_free(target: Path, *, force: bool = False) -> None:
    """Refuse to replace a file, or to write one into a folder that does not exist, before any work.

    Parameters
    ----------
    target : Path                   file that is to be written: a picture, a table, a page
    force : bool                    a regular file may be replaced

    Raises
    ------
    InputError                      something already lies there, or no file can
    """
    if not target.parent.is_dir():
        raise InputError(
            f"{target}: cannot be written: {target.parent} is not a folder; make it first"
        )
    if not os.path.lexists(target) or (force and target.is_file()):
        return
    raise InputError(
        f"{target}: is there already; nothing was touched: choose another name"
        + (", or give --force to replace it" if target.is_file() else "")
    )


def folder_changes(folder: Path) -> tuple[str, dict[str, str], dict[str, str]]:
    """The kind of a result folder, its changes since it was written, and its checksums.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    kind : str                      command that made it; empty: not a result of this version
    changes : dict of str to str    name -> "changed", "missing" or "not listed"
    sums : dict of str to str       name -> checksum, of all files as written

    Raises
    ------
    RecordError                     the folder cannot be read
    """
    kind = _kind(folder)
    if not kind:
        return "", {}, {}
    with _unreadable_errors():
        sums = sums_in(folder / CONTENTS_FILE)
        present = {path.relative_to(folder).as_posix() for path in _all_files(folder)}
        unlisted = sorted(present - {*sums, CONTENTS_FILE})
        return kind, _changes(folder, sums) | dict.fromkeys(unlisted, NOT_LISTED), sums


def check_fit_result(folder: Path) -> None:
    """Refuse a folder that is not an unchanged result of `palpate fit`; its report may be another.

    Parameters
    ----------
    folder : Path

    Raises
    ------
    RecordError                     it is something else, was changed, or was copied incompletely
    InUseError                      another process is writing it
    """
    put_back_interrupted(folder)
    kind, changed, _ = folder_changes(folder)
    if not folder.exists():
        raise RecordError(
            f"{folder}: no such folder; give one of `palpate fit`{nearest_file(folder)}"
        )
    if kind != "fit":
        what = f"a result of `palpate {kind}`" if kind else "no result of this version of Palpate"
        raise RecordError(f"{folder}: is {what}; give one of `palpate fit`")
    wrong = {name: how for name, how in changed.items() if name != REPORT_FILE}
    if wrong:
        name, how = next(iter(wrong.items()))
        raise RecordError(
            f"{folder}: is not as it was written ({name}: {how}), perhaps half copied; copy it"
            " again, or fit the session again"
        )


@contextmanager
def disk_errors(target: Path) -> Iterator[None]:
    """Turn errors of the file system while a target is written into `RecordError`.

    Parameters
    ----------
    target : Path                   that is being written, for the message

    Raises
    ------
    RecordError                     in place of an OSError that concerns writing
    """
    try:
        yield
    except OSError as error:
        # An error may concern a file that was read; written files have the target's name in theirs.
        elsewhere = os.path.isabs(str(error.filename)) and target.name not in str(error.filename)
        if error.errno not in _DISK_ERRORS or elsewhere:
            raise
        raise RecordError(
            f"{target}: cannot be written ({error.strerror}); nothing was changed: make room, or"
            " choose another place with --out"
        ) from error


def _check_place(target: Path) -> None:
    """Refuse a target that cannot be a folder, or that contains the current or home folder."""
    if not target.parent.is_dir():
        raise InputError(
            f"{target}: the result folder cannot be written: {target.parent} is not a folder;"
            " make it first, or choose another place with --out"
        )
    if target.is_symlink() or (target.exists() and not target.is_dir()):
        raise InputError(f"{target}: is not a folder; choose another name with --out")
    if target.suffix.lower() in _FILE_ENDINGS and not target.exists():
        raise InputError(
            f"{target}: names a file, but a result is a folder: --out {target.with_suffix('')}"
        )
    real, here = Path(os.path.realpath(target)), Path.cwd()
    if real in (here, *here.parents, Path(os.path.expanduser("~"))):
        raise InputError(
            f"{target}: a result takes the place of a whole folder, and this one holds more than"
            " that; name a new folder in it with --out"
        )


def _refuse(target: Path, objection: str, *, force: bool) -> None:
    if objection and not force:
        raise InputError(
            f"{target}: {objection}; nothing was touched: choose another place with --out, or give"
            f" --force (in Python force=True) to keep that as {target.name}.old"
        )


def _folder_objection(target: Path, kind: str) -> str:
    """Why a folder may not be replaced; empty if it is an unchanged result of that kind, or empty,
    or missing."""
    if not target.is_dir():
        return ""
    with _unreadable_errors():
        names = sorted(os.listdir(target))
    if not names:
        return ""
    kind_found, changed, _ = folder_changes(target)
    if not kind_found:
        if _EARLIER_MARK in _first_line(target):
            return "is a result of an earlier version, which cannot tell whether it was changed"
        return f"holds files that are no result of Palpate's, e.g. {_first_names(names)}"
    if changed:
        descriptions = [f"{name} ({how})" for name, how in changed.items()]
        return f"is a result that was changed since: {_first_names(descriptions)}"
    return "" if kind_found == kind else f"is a result of `palpate {kind_found}`"


def _kind(folder: Path) -> str:
    """Kind of a result folder according to the first line of its contents; empty if unknown."""
    mark, _, rest = _first_line(folder).removeprefix("# ").partition(" ")
    return rest.partition(";")[0] if mark == _RESULT_FORMAT else ""


def _first_line(folder: Path) -> str:
    contents = folder / CONTENTS_FILE
    with suppress(RecordError):
        return read_text(contents).partition("\n")[0] if contents.is_file() else ""
    return ""


def _all_files(folder: Path) -> Iterator[Path]:
    """All files and links below a folder; links are not followed."""
    for top, folders, files in os.walk(folder, onerror=_raise):
        links = [name for name in folders if os.path.islink(os.path.join(top, name))]
        yield from (Path(top, name) for name in (*files, *links))


def _raise(error: OSError) -> None:
    raise error


def _first_names(names: list[str]) -> str:
    """The first names of a list, shortened, and the number of the others."""
    shown = ", ".join(name if len(name) <= 40 else f"{name[:37]}..." for name in names[:3])
    return shown + (f" and {len(names) - 3} more" if len(names) > 3 else "")


@contextmanager
def _unreadable_errors() -> Iterator[None]:
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


@_unreadable_errors()
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
        plain = re.sub(r"[\\\n\r]", lambda match: _ESCAPES[match[0]], name)
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


@_unreadable_errors()
def _changes(folder: Path, sums: Mapping[str, str]) -> dict[str, str]:
    """Files that have changed since their checksums were taken, or are gone: name -> `CHANGED` or
    `MISSING`."""
    changes = {}
    for name, value in sums.items():
        path = folder / name
        if not path.is_file():
            changes[name] = MISSING
        elif file_sum(path) != value:
            changes[name] = CHANGED
    return changes


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
    named, values = {file}, read_toml(file).values
    for text in _texts(values):
        pattern = "*".join(re.sub(r"([*?[])", r"[\1]", part) for part in text.split("{camera}"))
        relative = Path(pattern)
        if "\0" in text or not relative.name or len(text) > 1000:
            continue
        start = Path(relative.anchor) if relative.is_absolute() else file.parent
        named |= set(start.glob(str(relative.relative_to(relative.anchor))))
    for series in _texts_of(values.get("probe"), "series"):
        # What is no series any more names no frames.
        with suppress(RecordError):
            named |= set(frame_files(file.parent / series))
    rig = values.get("rig")
    if isinstance(rig, dict) and isinstance(rig.get("cameras"), str):
        covariance = covariance_file(file.parent / rig["cameras"])
        named |= {covariance} if covariance else set()
    files = set(chain.from_iterable(map(_files_in, named)))
    return sorted(path for path in files if path.is_file())


def _files_in(path: Path) -> list[Path]:
    """A path itself, or the regular files in a folder."""
    return [file for file in path.glob("*") if file.is_file()] if path.is_dir() else [path]


def _texts_of(tables: Any, key: str) -> list[str]:
    """The texts under a key of some tables."""
    given = tables if isinstance(tables, list) else []
    texts = [table.get(key) for table in given if isinstance(table, dict)]
    return [text for text in texts if isinstance(text, str)]


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
