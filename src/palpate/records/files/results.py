"""Result folders and files: Palpate recognises its own unchanged results and replaces only them."""

import errno
import hashlib
import json
import os
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from palpate.disk import atomic_replacement
from palpate.errors import InputError, RecordError, print_message
from palpate.records.files.sums import (
    NOT_LISTED,
    changes,
    file_sums,
    sums_in,
    sums_text,
    unreadable_errors,
)
from palpate.records.text.json_file import json_text
from palpate.records.text.text_file import read_text, write_text

CONTENTS_FILE, INPUTS_FILE = "contents.txt", "inputs.txt"
RESULT_FORMAT = "palpate-result/1"
_EARLIER_MARK = "palpate result folder; files:"
SEAL_NAME = "sha256"
# The one file of a fit that may be made again.
REPORT_FILE = "report.html"
# Finished parts are kept after an interruption if the work took at least this long [s].
_MIN_SECONDS_TO_KEEP = 60.0
# Errors of a full, read-only or failing file system.
_DISK_ERRORS = (
    errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.EFBIG,
    errno.ENAMETOOLONG, errno.EMFILE, errno.ENFILE,
)  # fmt: skip


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
        atomic_replacement([target], folder=True, keep_old=objection) as (new,),
        _keep_long_work(parts_folder(new)),
        disk_errors(target),
    ):
        yield new
        sums = file_sums((path for path in new.rglob("*") if path.is_file()), start=new)
        head = f"# {RESULT_FORMAT} {kind}; `sha256sum -c` checks it\n"
        write_text(new / CONTENTS_FILE, head + sums_text(sums))
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


def target_parts_folder(target: Path) -> Path:
    """`parts_folder` of the result folder that was to be put in place as `target`.

    Parameters
    ----------
    target : Path                   final name

    Returns
    -------
    Path
    """
    return target.with_name(f".{target.name}.parts")


def record_inputs(folder: Path, files: Iterable[Path]) -> None:
    """Record the checksums of a result's input files, so that changes can be told.

    Parameters
    ----------
    folder : Path                   temporary folder from `result_folder`
    files : iterable of Path        input files, or folders of such

    Raises
    ------
    RecordError                     an input cannot be read, or the record cannot be written
    """
    write_text(folder / INPUTS_FILE, sums_text(file_sums(files, start=folder)))


@contextmanager
def result_file(target: Path, *, force: bool = False) -> Iterator[Path]:
    """A temporary JSON file to write; an existing target is replaced only if `sealed` made it.

    Parameters
    ----------
    target : Path                   final name; its folder must exist
    force : bool                    write even if something else lies there, which is then kept as
                                    NAME.old

    Yields
    ------
    Path                            temporary file next to the target

    Raises
    ------
    InputError                      as in `result_folder`
    """
    if target.exists() and not target.is_file():
        kind = "a folder" if target.is_dir() else "no regular file"
        raise InputError(f"{target}: is {kind}; name a file with --out")
    _refuse(target, _file_objection(target), force=force)
    with (
        atomic_replacement([target], keep_old=lambda old: bool(_file_objection(old))) as (new,),
        disk_errors(target),
    ):
        yield new


def check_free(target: Path, *, force: bool = False) -> None:
    """Refuse to replace a file whose origin cannot be recognised: a picture, a table, a page.

    Parameters
    ----------
    target : Path                   file that is to be written
    force : bool                    a regular file may be replaced

    Raises
    ------
    InputError                      something already lies there
    """
    if not os.path.lexists(target) or (force and target.is_file()):
        return
    raise InputError(
        f"{target}: is there already; nothing was touched: choose another name"
        + (", or give --force to replace it" if target.is_file() else "")
    )


def sealed(content: Mapping[str, Any], inputs: Iterable[Path], *, folder: Path) -> str:
    """JSON of a result with the checksums of its inputs and, as the last key, its own checksum.

    Parameters
    ----------
    content : mapping               with a key `format`
    inputs : iterable of Path       input files, or folders of such
    folder : Path                   folder that the file will be in; names of inputs are relative

    Returns
    -------
    str

    Raises
    ------
    RecordError                     an input cannot be read
    """
    with_inputs = {**content, "inputs": file_sums(inputs, start=folder)}
    return json_text(
        {**with_inputs, SEAL_NAME: hashlib.sha256(json_text(with_inputs).encode()).hexdigest()}
    )


def is_sealed(text: str) -> bool:
    """Whether a text is unchanged output of `sealed`.

    Parameters
    ----------
    text : str

    Returns
    -------
    bool
    """
    try:
        content = json.loads(text)
        value = content.pop(SEAL_NAME)
        unsealed = json_text(content)
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
        return False
    same = hashlib.sha256(unsealed.encode()).hexdigest() == value
    return same and text == json_text({**content, SEAL_NAME: value})


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
    with unreadable_errors():
        sums = sums_in(folder / CONTENTS_FILE)
        present = {path.relative_to(folder).as_posix() for path in _all_files(folder)}
        unlisted = sorted(present - {*sums, CONTENTS_FILE})
        return kind, changes(folder, sums) | dict.fromkeys(unlisted, NOT_LISTED), sums


def check_fit_result(folder: Path) -> None:
    """Refuse a folder that is not an unchanged result of `palpate fit`; its report may be another.

    Parameters
    ----------
    folder : Path

    Raises
    ------
    RecordError                     it is something else, was changed, or was copied incompletely
    """
    kind, changed, _ = folder_changes(folder)
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
            f" --force to keep that as {target.name}.old"
        )


def _folder_objection(target: Path, kind: str) -> str:
    """Why a folder may not be replaced; empty if it is an unchanged result of that kind, or empty,
    or missing."""
    if not target.is_dir():
        return ""
    with unreadable_errors():
        names = sorted(os.listdir(target))
    if not names:
        return ""
    found, changed, _ = folder_changes(target)
    if not found:
        if _EARLIER_MARK in _first_line(target):
            return "is a result of an earlier version, which cannot tell whether it was changed"
        return f"holds files that are no result of Palpate's, e.g. {_first_names(names)}"
    if changed:
        descriptions = [f"{name} ({how})" for name, how in changed.items()]
        return f"is a result that was changed since: {_first_names(descriptions)}"
    return "" if found == kind else f"is a result of `palpate {found}`"


def _file_objection(target: Path) -> str:
    """Why a file may not be replaced; empty if it is an unchanged result, or missing."""
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
    """Kind of a result folder according to the first line of its contents; empty if unknown."""
    mark, _, rest = _first_line(folder).removeprefix("# ").partition(" ")
    return rest.partition(";")[0] if mark == RESULT_FORMAT else ""


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
