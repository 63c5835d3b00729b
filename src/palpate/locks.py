"""Lock files: which process is writing a file or folder. A lock ends with its process."""

import os
import socket
from contextlib import suppress
from pathlib import Path

from palpate.errors import InUseError, RecordError

try:
    import fcntl
except ImportError:  # not on Windows: two commands at once are then not noticed
    fcntl = None  # type: ignore[assignment]

# First word of a lock file's text, and the flag that refuses symbolic links to other files.
_HOLDER_PREFIX, _NO_FOLLOW = "process ", getattr(os, "O_NOFOLLOW", 0)


def take_lock(path: Path, final: Path) -> int:
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
        release_lock(path, handle)
        raise
    return handle


def release_lock(path: Path, handle: int) -> None:
    """Remove and close a lock file.

    Parameters
    ----------
    path : Path                     the lock file
    handle : int                    descriptor, from `take_lock`
    """
    with suppress(OSError):
        path.unlink()
    os.close(handle)


def is_abandoned(path: Path) -> bool:
    """Whether a lock file is there whose process has ended without removing it.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool                            False also where the system or the file system knows no locks
    """
    if fcntl is None:
        return False
    try:
        handle = os.open(path, os.O_RDWR | _NO_FOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    finally:
        os.close(handle)
    return True


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
