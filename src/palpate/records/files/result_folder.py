"""Result folders that appear whole or not at all."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from palpate.errors import InputError

CONTENTS_FILE = "contents.txt"
_MARK = "palpate result folder; files:"


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
    if path.is_dir():
        return Path(f"{path.name}-{what}")
    name = path.parent.name if path.stem == "session" else f"{path.parent.name}-{path.stem}"
    return Path(f"{name}-{what}")


@contextmanager
def result_folder(target: Path | str) -> Iterator[Path]:
    """A folder to write into; it takes its final name when the block ends well, else vanishes.

    An older result folder is replaced if it holds nothing but what Palpate wrote.

    Parameters
    ----------
    target : path                   final name; its parent must be there

    Yields
    ------
    Path                            folder beside the target, under another name

    Raises
    ------
    InputError                      the target is something else already, or cannot be written;
                                    raised before the block runs
    """
    target = Path(os.path.abspath(target))
    _check_target(target)
    staging = target.parent / f".{target.name}.{os.getpid()}.partial"
    try:
        shutil.rmtree(staging, ignore_errors=True)
        staging.mkdir()
    except OSError as error:
        raise InputError(
            f"{target}: the result folder cannot be written ({error.strerror});"
            " choose another place with --out"
        ) from error
    try:
        yield staging
        _finish(staging, target)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


@contextmanager
def disk_errors(folder: Path) -> Iterator[None]:
    """Turn what a disk refuses within the block into a message.

    Parameters
    ----------
    folder : Path                   that is written into, for the message

    Raises
    ------
    InputError
    """
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{error.filename or folder}: cannot be written ({error.strerror}); nothing was left:"
            " choose another place with --out"
        ) from error


def _check_target(target: Path) -> None:
    """Refuse a target that holds anything that Palpate did not write."""
    if not target.parent.is_dir():
        raise InputError(
            f"{target}: the result folder cannot be written: {target.parent} is not a folder;"
            " make it first, or choose another place with --out"
        )
    if target.is_symlink() or (target.exists() and not target.is_dir()):
        raise InputError(f"{target}: is not a folder; choose another name with --out")
    if not target.exists():
        return
    found = {str(path.relative_to(target)) for path in target.rglob("*")}
    strangers = sorted(found - _written(target))
    if strangers:
        raise InputError(
            f"{target}: holds files that are no result of Palpate's, the first: {strangers[:3]};"
            " nothing was touched: choose another folder with --out, or empty it"
        )


def _written(target: Path) -> set[str]:
    """Names that a result folder says were written into it."""
    contents = target / CONTENTS_FILE
    if not contents.is_file():
        return set()
    lines = contents.read_text(encoding="utf-8", errors="replace").splitlines()
    return {*lines[1:], CONTENTS_FILE} if lines and lines[0] == _MARK else set()


def _finish(staging: Path, target: Path) -> None:
    """List what was written, and give the folder its name."""
    names = sorted(str(path.relative_to(staging)) for path in staging.rglob("*"))
    try:
        (staging / CONTENTS_FILE).write_text("\n".join([_MARK, *names]) + "\n", encoding="utf-8")
        _put_in_place(staging, target)
    except OSError as error:
        raise InputError(
            f"{target}: the result cannot be put in place ({error.strerror}); nothing was left:"
            " choose another place with --out"
        ) from error


def _put_in_place(staging: Path, target: Path) -> None:
    """Give the finished folder its name; the older one goes only when that has worked."""
    if not target.exists():
        staging.rename(target)
        return
    older = staging.with_suffix(".older")
    target.rename(older)
    try:
        staging.rename(target)
    except OSError:
        older.rename(target)
        raise
    shutil.rmtree(older)
