"""Atomic writing: files and folders appear completely or not at all, even if the process is killed.

While NAME is being written, these lie next to it: `.NAME.lock`, which process writes it, and which
ends with that process; `.NAME.partial`, the new content; `.NAME.older`, the old content of a folder
where the system cannot exchange two names. If a process is killed, the next one that writes there
cleans up what it left. Several files change together where one of them names the others: these get
names that are free (`new_files`), and it is replaced last.
"""

import ctypes
import errno
import os
import re
import shutil
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path

from palpate.errors import InUseError, RecordError, print_message

try:
    import fcntl
except ImportError:  # not on Windows: two commands at once are then not noticed
    fcntl = None  # type: ignore[assignment]

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGXCPU")
# linux/fs.h: exchange two names in one step.
_RENAME_EXCHANGE, _AT_FDCWD = 2, -100
# First word of a lock file's text, and the flag that refuses symbolic links to other files.
_HOLDER_PREFIX, _NO_FOLLOW = "process ", getattr(os, "O_NOFOLLOW", 0)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file atomically: it then holds either its old content or all of the new.

    Parameters
    ----------
    path : Path
    content : bytes

    Raises
    ------
    RecordError                     the file cannot be written
    InUseError                      another process is writing it
    """
    with atomic_replacement(path) as staged, write_errors(path):
        staged.write_bytes(content)


def free_name(path: Path, content: bytes) -> Path:
    """The first of NAME, NAME_2, NAME_3 and so on where nothing is, or a file with this content.

    Parameters
    ----------
    path : Path                     the name that is wanted
    content : bytes                 what is to be written there

    Returns
    -------
    Path
    """
    final, number = path, 1
    while os.path.lexists(final) and not _holds(final, content):
        number += 1
        final = path.with_stem(f"{path.stem}_{number}")
    return final


def _holds(path: Path, content: bytes) -> bool:
    """Whether a path is a regular file with this content; False where that cannot be seen."""
    with suppress(OSError):
        same_size = path.is_file() and path.stat().st_size == len(content)
        return same_size and path.read_bytes() == content
    return False


@contextmanager
def new_files(named_by: Path) -> Iterator[Callable[[Path, bytes], Path]]:
    """A function that writes files which replace none; they are removed again if the block fails
    before the file that names them has been replaced.

    Around `atomic_replacement` of that file: all change together, since nothing names the new files
    before it is in place.

    Parameters
    ----------
    named_by : Path                 the file that is going to name them

    Yields
    ------
    callable                        takes a path and a content; gives the `free_name` where it is

    Raises
    ------
    RecordError                     by the function: a file cannot be written
    InUseError                      by the function: another process is writing it
    """
    created: list[Path] = []
    before = _inode(named_by)

    def write(path: Path, content: bytes) -> Path:
        final = free_name(path, content)
        if not final.exists():
            created.append(final)
        # One that is there has this content, perhaps of a killed run that left its lock.
        write_bytes(final, content)
        return final

    try:
        yield write
    except BaseException:
        # A signal may come after the replacement.
        for path in created if _inode(named_by) == before else ():
            with suppress(OSError):
                path.unlink()
        raise


def _inode(path: Path) -> int | None:
    """Which file has this name; None: there is none. It changes with each replacement."""
    with suppress(OSError):
        return os.stat(path).st_ino
    return None


@contextmanager
def atomic_replacement(
    target: Path,
    *,
    folder: bool = False,
    keep_old: Callable[[Path], object] = lambda _: False,
) -> Iterator[Path]:
    """A temporary file or folder to write to; renamed to the target when the block succeeds.

    The target is replaced whole or not at all: after a kill at any step, the next process that
    writes there or calls `put_back_interrupted` finds or restores a whole one. Symbolic links are
    followed; permissions of an existing file are kept.

    Parameters
    ----------
    target : Path                   final name, in an existing folder
    folder : bool                   the target is a folder
    keep_old : callable             called with an existing target before it is replaced; True: keep
                                    the old one as NAME.old

    Yields
    ------
    Path                            empty temporary file or folder, next to the target

    Raises
    ------
    RecordError                     the target cannot be written; raised before the block runs if
                                    the file system does not allow it
    InUseError                      another process is writing there; raised before the block runs
    """
    final = Path(os.path.realpath(target))
    if final.exists() and not (final.is_dir() if folder else final.is_file()):
        wrong = "a folder" if final.is_dir() else "no regular file"
        raise RecordError(f"{final}: is {'no folder' if folder else wrong}; choose another place")
    staged = _hidden_path(final, "partial")
    with _hold_lock(final):
        try:
            with write_errors(final):
                _clean_up(final)
                staged.mkdir() if folder else staged.touch()
            yield staged
            with _deferred_signals(), write_errors(final):
                _sync_all(staged)
                _put_in_place(staged, final, keep_old)
        finally:
            with _deferred_signals(), suppress(OSError):
                _remove(staged)


@contextmanager
def created_folder(folder: Path) -> Iterator[None]:
    """Create a folder, if missing, for the block; if the block fails, folders that were created and
    are still empty are removed.

    Parameters
    ----------
    folder : Path                   missing parents are created too

    Raises
    ------
    RecordError                     a file has its name; the folder cannot be created
    """
    if folder.exists() and not folder.is_dir():
        raise RecordError(f"{folder}: is not a folder; choose another name")
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        with write_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for path in missing:
            with suppress(OSError):
                path.rmdir()
        raise


@contextmanager
def write_errors(final: Path) -> Iterator[None]:
    """Turn an OSError within the block into a RecordError that names the file or folder.

    Parameters
    ----------
    final : Path                    what is being written, for the message

    Raises
    ------
    RecordError                     in place of an OSError
    """
    try:
        yield
    except OSError as error:
        raise RecordError(
            f"{final}: cannot be written ({error.strerror or error}); nothing was changed: check"
            " the folder's rights and the disk's space, or choose another place"
        ) from error


def put_back_interrupted(target: Path) -> None:
    """Put back a folder whose replacement was interrupted, if there is one, and say so.

    Parameters
    ----------
    target : Path                   the folder

    Raises
    ------
    RecordError                     the file system does not allow it
    InUseError                      the change is still in progress in another process
    """
    final = Path(os.path.realpath(target))
    interrupted = False
    # An unreadable location is reported by whoever reads the folder itself.
    with suppress(OSError):
        # Where two names cannot be exchanged, a folder is gone for a moment.
        interrupted = _hidden_path(final, "older").is_dir() and not final.exists()
    if interrupted:
        with _hold_lock(final), write_errors(final):
            _clean_up(final)


@contextmanager
def _hold_lock(final: Path) -> Iterator[None]:
    """Hold the lock on a file or folder; it is released however the process ends."""
    path, handle = _hidden_path(final, "lock"), None
    try:
        with write_errors(final), _deferred_signals():
            handle = _take_lock(path, final)
        yield
    finally:
        if handle is not None:
            with _deferred_signals():
                _release_lock(path, handle)


def _clean_up(final: Path) -> None:
    """Remove or restore what interrupted processes left, and report each on stderr."""
    # Earlier versions put the process id into these names.
    pattern = re.compile(rf"\.{re.escape(final.name)}\.(\d+\.)?(partial|older)")
    for name in sorted(name for name in os.listdir(final.parent) if pattern.fullmatch(name)):
        leftover = final.with_name(name)
        if name.endswith(".partial"):
            _remove(leftover)
            print_message(f"note: {leftover}: left by an interrupted run, removed")
        elif final.exists():
            old_name = _keep_under_old_name(leftover, final)
            print_message(f"note: {leftover}: left by an interrupted run, kept as {old_name}")
        else:
            os.rename(leftover, final)
            print_message(f"note: {final}: put back; an interrupted run had left it as {name}")


def _put_in_place(staged: Path, final: Path, keep_old: Callable[[Path], object]) -> None:
    """Rename the temporary file or folder to its final name."""
    if final.is_file():
        shutil.copymode(final, staged)
    if final.exists() and keep_old(final):
        old_name = _keep_under_old_name(final, final)
        print_message(f"note: {final}: what was there is kept as {old_name}")
    if not final.is_dir():
        os.replace(staged, final)
    elif not _exchange(staged, final):
        older = _hidden_path(final, "older")
        os.rename(final, older)
        try:
            os.rename(staged, final)
        except OSError:
            os.rename(older, final)
            raise
        with suppress(OSError):
            _remove(older)
    # The new content is in place: a failed flush is no reason to fail.
    with suppress(OSError):
        _sync(final.parent)


def _keep_under_old_name(path: Path, final: Path) -> Path:
    """Keep something under the first free name of NAME.old, NAME.old2, and so on.

    A file also keeps its own name, so that it exists at every moment.
    """
    old_name, number = final.with_name(f"{final.name}.old"), 1
    while os.path.lexists(old_name):
        number += 1
        old_name = final.with_name(f"{final.name}.old{number}")
    if path != final or path.is_dir():
        os.rename(path, old_name)
    else:
        _link_or_copy(path, old_name)
    return old_name


def _exchange(first: Path, second: Path) -> bool:
    """Exchange two names atomically; False where the system or file system cannot."""
    if sys.platform != "linux":
        return False
    rename = getattr(ctypes.CDLL(None), "renameat2", None)
    names = (_AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second))
    return rename is not None and rename(*names, _RENAME_EXCHANGE) == 0


def _link_or_copy(path: Path, other: Path) -> None:
    """Hard link to a file; a real copy where the file system has no hard links."""
    try:
        os.link(path, other)
    except OSError:
        shutil.copy2(path, other)
        _sync(other)


def _sync_all(path: Path) -> None:
    """Flush a file, or a folder and everything in it, to disk."""
    for entry in (*path.rglob("*"), path):
        _sync(entry)


def _sync(path: Path) -> None:
    """Flush a file's content, or a folder's entries, to disk."""
    if path.is_dir() and os.name != "posix":
        return
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        # Some file systems cannot flush folders.
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(handle)


def _hidden_path(final: Path, what: str) -> Path:
    return final.with_name(f".{final.name}.{what}")


def _remove(path: Path) -> None:
    """Remove a file or folder if it exists, whatever the permissions of its content."""
    if path.is_dir() and not path.is_symlink():
        with suppress(OSError):
            for folder in chain([path], path.rglob("*/")):
                if not folder.is_symlink():
                    folder.chmod(0o700)
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def _deferred_signals() -> Iterator[None]:
    """Defer signals that arrive within the block until its end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    numbers = [getattr(signal, name) for name in _SIGNALS if hasattr(signal, name)]
    before = {n: signal.signal(n, lambda number, _: received.append(number)) for n in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if received:
            signal.raise_signal(received[0])


def _take_lock(path: Path, final: Path) -> int:
    """Create or open a lock file, lock it, and write this process and host into it.

    Parameters
    ----------
    path : Path                     the lock file
    final : Path                    file or folder that is to be written, for messages

    Returns
    -------
    int                             descriptor of the open lock file

    Raises
    ------
    InUseError                      another process holds the lock
    RecordError                     a file that is not one of our locks lies there; it is left alone
    OSError                         the lock file cannot be created or written; none is left behind
    """
    handle = _open_and_lock(path, final)
    try:
        os.ftruncate(handle, 0)
        os.write(handle, f"{_HOLDER_PREFIX}{os.getpid()} on {socket.gethostname()}".encode())
    except OSError:
        _release_lock(path, handle)
        raise
    return handle


def _release_lock(path: Path, handle: int) -> None:
    """Remove and close a lock file.

    Parameters
    ----------
    path : Path                     the lock file
    handle : int                    descriptor, from `_take_lock`
    """
    with suppress(OSError):
        path.unlink()
    os.close(handle)


def _open_and_lock(path: Path, final: Path) -> int:
    """Open and lock a lock file, and make sure that it is still the one under that name."""
    while True:
        handle, holder = _open_lock_file(path)
        try:
            if fcntl is not None:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise InUseError(
                f"{final}: is being written by {holder or 'another process'}; wait until that has"
                " ended, or choose another place"
            ) from None
        except OSError:
            pass  # A file system without locks.
        with suppress(FileNotFoundError):
            if os.path.samestat(os.stat(path), os.fstat(handle)):
                return handle
        # Its previous holder has ended and removed the file in the meantime: try again.
        os.close(handle)


def _open_lock_file(path: Path) -> tuple[int, str]:
    """Open or create a lock file; also gives the process named in it. Refuses any other file."""
    if not os.path.lexists(path) or (path.is_file() and not path.is_symlink()):
        handle = os.open(path, os.O_RDWR | os.O_CREAT | _NO_FOLLOW, 0o644)
        holder = os.pread(handle, 200, 0).decode(errors="replace")
        if not holder or holder.startswith(_HOLDER_PREFIX):
            return handle, holder
        os.close(handle)
    raise RecordError(f"{path}: is not a lock of Palpate's; move it to another place")
