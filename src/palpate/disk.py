"""Files and folders that appear whole or not at all, whatever stops the process in between.

While NAME is written there are beside it `.NAME.lock`, who writes it; `.NAME.partial`, what is to
take its place; `.NAME.older` and `.NAME.journal`, how to undo a change of several files. What a
process that was killed leaves of them is tidied by the next one that writes there.
"""

import ctypes
import errno
import json
import os
import re
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path

from palpate.errors import RecordError
from palpate.files import checked_file
from palpate.locks import release_lock, take_lock

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGXCPU")
# linux/fs.h: exchange two names in one step.
_RENAME_EXCHANGE, _AT_FDCWD = 2, -100
# What a journal has at most [bytes].
_MOST_JOURNAL = 2**20


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file; afterwards it holds what it held before, or the whole new content.

    Parameters
    ----------
    path : Path
    content : bytes

    Raises
    ------
    RecordError                     it cannot be written
    InUseError                      another process is writing it
    """
    with placed([path]) as (staged,):
        staged.write_bytes(content)


@contextmanager
def placed(
    targets: Sequence[Path],
    *,
    folder: bool = False,
    aside: Callable[[Path], object] = lambda _: False,
) -> Iterator[tuple[Path, ...]]:
    """Files, or one folder, to write to; they take their places when the block ends well.

    All of them do, or none: after a kill at any step, the next process that writes there, or
    calls `settle`, sees to that. Links are followed; files keep their rights.

    Parameters
    ----------
    targets : sequence of Path      final names, in folders that are there; the last one stands
                                    for all where another process asks who is writing
    folder : bool                   the one target is a folder
    aside : callable                true for what is to be kept as NAME.old, asked in the end

    Yields
    ------
    tuple of Path                   beside the targets, empty, under other names

    Raises
    ------
    RecordError                     one cannot be written; before the block runs where the disk
                                    does not allow it
    InUseError                      another process is writing there; before the block runs
    """
    finals = [Path(os.path.realpath(target)) for target in targets]
    _check_places(finals, folder)
    staged = tuple(_beside(final, "partial") for final in finals)
    with _locked(finals[-1]):
        try:
            with _refused(finals[-1]):
                _tidy(finals)
                if len(finals) > 1:
                    _write_journal(finals, undo=False)
            for path, final in zip(staged, finals, strict=True):
                with _refused(final):
                    path.mkdir() if folder else path.touch()
            yield staged
            with _unbroken(), _refused(finals[-1]):
                for path in staged:
                    _sync_all(path)
                _put_in_place(staged, finals, aside)
        finally:
            with _unbroken(), suppress(OSError):
                _undo(_beside(finals[-1], "journal"))
                for path in (*staged, _beside(finals[-1], "draft")):
                    _remove(path)


def settle(target: Path) -> None:
    """Undo a change of several files that was interrupted, if there is one; say so on stderr.

    Parameters
    ----------
    target : Path                   the last of these files

    Raises
    ------
    RecordError                     the disk does not allow it
    InUseError                      the change is not interrupted: another process is at it
    """
    final = Path(os.path.realpath(target))
    interrupted = False
    # Whoever reads the file says what is wrong with its place.
    with suppress(OSError):
        interrupted, _ = _journal(_beside(final, "journal"))
    if interrupted:
        with _locked(final), _refused(final):
            _tidy([final])


def _check_places(finals: Sequence[Path], folder: bool) -> None:
    """Refuse what cannot be replaced, or not together."""
    for final in finals:
        if final.exists() and not (final.is_dir() if folder else final.is_file()):
            wrong = "a folder" if final.is_dir() else "no regular file"
            raise RecordError(
                f"{final}: is {'no folder' if folder else wrong}; choose another place"
            )
        if final.parent != finals[-1].parent:
            raise RecordError(
                f"{final}: a link leads out of the folder of {finals[-1]}, and both are to change"
                " together; put the file itself there"
            )


@contextmanager
def _locked(final: Path) -> Iterator[None]:
    """Hold the right to write a file or folder; a lock dies with its process, however that ends."""
    path = _beside(final, "lock")
    with _refused(final):
        handle = take_lock(path, final)
    try:
        yield
    finally:
        release_lock(path, handle)


def _tidy(finals: Sequence[Path]) -> None:
    """Undo, remove or put back what interrupted processes left of these files, and name it."""
    journal = _beside(finals[-1], "journal")
    if journal.exists():
        interrupted, _ = _journal(journal)
        done = "was undone" if interrupted else "was tidied up"
        _undo(journal)
        _say(f"{finals[-1]}: what an interrupted run had begun {done}")
    for final in finals:
        # The number of the process is what earlier versions put into these names.
        pattern = re.compile(rf"\.{re.escape(final.name)}\.(\d+\.)?(partial|draft|older)")
        for name in sorted(name for name in os.listdir(final.parent) if pattern.fullmatch(name)):
            left = final.with_name(name)
            if not name.endswith(".older"):
                _remove(left)
                _say(f"{left}: left by an interrupted run, removed")
            elif final.exists():
                _say(f"{left}: left by an interrupted run, kept as {_kept_aside(left, final)}")
            else:
                os.rename(left, final)
                _say(f"{final}: put back; an interrupted run had left it as {name}")


def _say(text: str) -> None:
    print(f"palpate: note: {text}", file=sys.stderr)


def _put_in_place(
    staged: Sequence[Path], finals: Sequence[Path], aside: Callable[[Path], object]
) -> None:
    """Give files or a folder their names."""
    for path, final in zip(staged, finals, strict=True):
        if final.is_file():
            shutil.copymode(final, path)
        if final.exists() and aside(final):
            kept = _kept_aside(final, final)
            _say(f"{final}: what was there is kept as {kept}")
    if len(finals) > 1:
        _place_together(staged, finals)
    elif not finals[0].is_dir():
        os.replace(staged[0], finals[0])
    elif not _exchanged(staged[0], finals[0]):
        older = _beside(finals[0], "older")
        os.rename(finals[0], older)
        try:
            os.rename(staged[0], finals[0])
        except OSError:
            os.rename(older, finals[0])
            raise
        with suppress(OSError):
            _remove(older)
    # What stands in its place is not taken back any more.
    with suppress(OSError):
        _sync(finals[-1].parent)


def _kept_aside(path: Path, final: Path) -> Path:
    """Give something a free name that a user sees: NAME.old, NAME.old2, and so on.

    A file keeps its own name as well, so that there is no moment without it.
    """
    kept, number = final.with_name(f"{final.name}.old"), 1
    while os.path.lexists(kept):
        number += 1
        kept = final.with_name(f"{final.name}.old{number}")
    if path != final or path.is_dir():
        os.rename(path, kept)
    else:
        _copy(path, kept)
    return kept


def _place_together(staged: Sequence[Path], finals: Sequence[Path]) -> None:
    """Give several files their names; until the journal says otherwise, that is to be undone."""
    for final in finals:
        if final.exists():
            _copy(final, _beside(final, "older"))
    _write_journal(finals, undo=True)
    for path, final in zip(staged, finals, strict=True):
        os.replace(path, final)
    _sync(finals[-1].parent)
    _write_journal(finals, undo=False)


def _write_journal(finals: Sequence[Path], *, undo: bool) -> None:
    """Write which files are being changed, which were there, and whether that is to be undone."""
    journal, draft = _beside(finals[-1], "journal"), _beside(finals[-1], "draft")
    there = {final.name: _beside(final, "older").exists() for final in finals}
    draft.write_text(json.dumps({"undo": undo, "there": there}), encoding="utf-8")
    _sync(draft)
    os.replace(draft, journal)
    if undo:
        _sync(journal.parent)


def _journal(path: Path) -> tuple[bool, dict[str, bool]]:
    """Whether a change of several files is to be undone, and which of them were there before."""
    if not path.exists():
        return False, {}
    try:
        found = json.loads(checked_file(path, most=_MOST_JOURNAL).read_text(encoding="utf-8"))
        undo, there = found["undo"], dict[str, bool](found["there"])
        if len(found) == 2 and all(Path(name).name == name for name in there):
            return bool(undo), there
    except (LookupError, ValueError, TypeError, RecursionError):
        pass
    # It may come from anywhere with a session, and must not reach beyond its folder.
    raise RecordError(f"{path}: is not what Palpate leaves of an interrupted run; remove it")


def _undo(path: Path) -> None:
    """Undo what a journal says is to be undone, again if need be; remove what belongs to it."""
    undo, there = _journal(path)
    for name, was_there in there.items():
        final = path.with_name(name)
        older = _beside(final, "older")
        if undo and older.exists():
            os.replace(older, final)
        elif undo and not was_there:
            final.unlink(missing_ok=True)
        _remove(older)
        _remove(_beside(final, "partial"))
    if there:
        _sync(path.parent)
    _remove(path)


def _exchanged(first: Path, second: Path) -> bool:
    """Exchange two names in one step; False where the system cannot, or not here."""
    if sys.platform != "linux":
        return False
    rename = getattr(ctypes.CDLL(None), "renameat2", None)
    names = (_AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second))
    return rename is not None and rename(*names, _RENAME_EXCHANGE) == 0


def _copy(path: Path, other: Path) -> None:
    """The same file under a second name; a true copy where the disk knows no links."""
    try:
        os.link(path, other)
    except OSError:
        shutil.copy2(path, other)
        _sync(other)


def _sync_all(path: Path) -> None:
    """Have the disk keep a file, or a folder with all that is in it."""
    for each in (*path.rglob("*"), path):
        _sync(each)


def _sync(path: Path) -> None:
    """Have the disk keep a file's content, or the names in a folder."""
    if path.is_dir() and os.name != "posix":
        return
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        # Some file systems cannot do that for folders.
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(handle)


def _beside(final: Path, what: str) -> Path:
    return final.with_name(f".{final.name}.{what}")


def _remove(path: Path) -> None:
    """Remove a file or a folder, if it is there, whatever the rights of what is in it."""
    if path.is_dir() and not path.is_symlink():
        with suppress(OSError):
            for folder in chain([path], path.rglob("*/")):
                if not folder.is_symlink():
                    folder.chmod(0o700)
        shutil.rmtree(path)
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
            " folder's rights and the disk's space, or choose another place"
        ) from error


@contextmanager
def _unbroken() -> Iterator[None]:
    """Have signals that arrive within the block act at its end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    numbers = [getattr(signal, name) for name in _SIGNALS if hasattr(signal, name)]
    before = {n: signal.signal(n, lambda number, _: came.append(number)) for n in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
