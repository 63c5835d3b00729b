"""Who is writing a file or folder: lock files, which end with their process."""

import os
import socket
from contextlib import suppress
from pathlib import Path

from palpate.errors import InUseError, RecordError

try:
    import fcntl
except ImportError:  # not on Windows: two commands at once are then not noticed
    fcntl = None  # type: ignore[assignment]

# How the text of a lock begins, and that it is no link to what is another's.
_HOLDER, _NO_LINK = "process ", getattr(os, "O_NOFOLLOW", 0)


def take_lock(path: Path, final: Path) -> int:
    """A lock file, open, locked, and with this process in it.

    Parameters
    ----------
    path : Path                     of the lock file
    final : Path                    what is going to be written, for messages

    Returns
    -------
    int                             handle of the open file

    Raises
    ------
    InUseError                      another process holds it
    RecordError                     something else lies there; it stays as it is
    OSError                         the disk does not allow it; nothing is left
    """
    handle = _opened_lock(path, final)
    try:
        os.ftruncate(handle, 0)
        os.write(handle, f"{_HOLDER}{os.getpid()} on {socket.gethostname()}".encode())
    except OSError:
        release_lock(path, handle)
        raise
    return handle


def release_lock(path: Path, handle: int) -> None:
    """Remove and close a lock file.

    Parameters
    ----------
    path : Path
    handle : int                    of `take_lock`
    """
    with suppress(OSError):
        path.unlink()
    os.close(handle)


def _opened_lock(path: Path, final: Path) -> int:
    """An open lock file that is locked and has its name still."""
    while True:
        handle, holder = _lock_file(path)
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
        # The one before has ended and taken the file with it in between.
        os.close(handle)


def _lock_file(path: Path) -> tuple[int, str]:
    """A lock file, opened or made, and the process that it names; what is another's stays so."""
    if not os.path.lexists(path) or (path.is_file() and not path.is_symlink()):
        handle = os.open(path, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o644)
        holder = os.pread(handle, 200, 0).decode(errors="replace")
        if not holder or holder.startswith(_HOLDER):
            return handle, holder
        os.close(handle)
    raise RecordError(f"{path}: is not a lock of Palpate's; move it to another place")
