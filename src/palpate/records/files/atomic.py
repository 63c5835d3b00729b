"""Files and folders that appear whole or not at all."""

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from palpate.errors import InputError, RecordError

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
    folder, file = (path, "session") if path.is_dir() else (path.parent, path.stem)
    return Path(f"{folder.name}-{what}" if file == "session" else f"{folder.name}-{file}-{what}")


def file_stem(name: str, *, otherwise: str) -> str:
    """A name as the stem of a file's name.

    Parameters
    ----------
    name : str
    otherwise : str                 stands in where a system may refuse or hide a file so named

    Returns
    -------
    str
    """
    plain = name.replace("_", "").replace("-", "").replace(".", "")
    return name if plain.isalnum() and name[0] != "." else otherwise


@contextmanager
def placed_files(targets: Sequence[Path]) -> Iterator[tuple[Path, ...]]:
    """Files to write to; they take their final names when the block ends well, else vanish.

    Older files of these names are replaced in the order given; where one cannot be, those before
    it are put back.

    Parameters
    ----------
    targets : sequence of Path      final names, in folders that are there

    Yields
    ------
    tuple of Path                   beside the targets, empty, under other names

    Raises
    ------
    RecordError                     one cannot be written; raised before the block runs where the
                                    folder does not allow it
    """
    finals = [Path(os.path.realpath(target)) for target in targets]
    with _staged(finals, Path.touch) as staged:
        yield staged


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
    with _staged([target], Path.mkdir) as (staging,):
        yield staging
        names = sorted(str(path.relative_to(staging)) for path in staging.rglob("*"))
        with _refused(target):
            lines = "\n".join([_MARK, *names]) + "\n"
            (staging / CONTENTS_FILE).write_text(lines, encoding="utf-8")


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


@contextmanager
def _staged(finals: Sequence[Path], make: Callable[[Path], object]) -> Iterator[tuple[Path, ...]]:
    """Files or folders beside the final ones; put in place when the block ends well, else gone."""
    staged = tuple(final.with_name(f".{final.name}.{os.getpid()}.partial") for final in finals)
    try:
        for path, final in zip(staged, finals, strict=True):
            with _refused(final):
                _remove(path)
                make(path)
        yield staged
        _put_in_place(staged, finals)
    finally:
        for path in staged:
            _remove(path)


def _put_in_place(staged: Sequence[Path], finals: Sequence[Path]) -> None:
    """Give files or folders their names; the older ones go only when all of that has worked."""
    placed: list[tuple[Path, Path]] = []
    try:
        for path, final in zip(staged, finals, strict=True):
            older = path.with_suffix(".older")
            with _refused(final):
                if final.is_file():
                    shutil.copymode(final, path)
                if final.exists():
                    final.rename(older)
                placed.append((final, older))
                path.rename(final)
    except RecordError:
        for final, older in reversed(placed):
            _remove(final)
            if older.exists():
                older.rename(final)
        raise
    for _, older in placed:
        _remove(older)


def _remove(path: Path) -> None:
    """Remove a file or a folder, if it is there and as far as the disk allows."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def _refused(final: Path) -> Iterator[None]:
    """Name the file or folder that a disk refuses within the block."""
    try:
        yield
    except OSError as error:
        raise RecordError(
            f"{final}: cannot be written ({error.strerror}); nothing was changed: check the"
            " folder's rights, or choose another place with --out"
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
