"""A process that dies, or a disk that fails, at a step of one's choice: in a fork of the test."""

import ctypes
import errno
import io
import os
import resource
import shutil
import signal
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from palpate import disk
from palpate.errors import RecordError

OUTCOMES = ["done", "died", "refused", "done all the same", "another error"]
# Events of the interpreter by which something on the disk is changed.
_EVENTS = {
    "open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.link", "os.chmod", "os.truncate"
}  # fmt: skip
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


def in_child(work: Callable[[], object], folder: Path, *, step: int, fault: str = "dies") -> str:
    """Run something in a fork that fails at one of its steps.

    Parameters
    ----------
    work : callable
    folder : Path                   what is done in it counts
    step : int                      from 1
    fault : str                     "dies": the process ends without cleaning up; "SIGTERM": it is
                                    asked to; or the error of the step, such as "ENOSPC"

    Returns
    -------
    str                             one of `OUTCOMES`; "done" where there are not so many steps
    """
    child = os.fork()
    if child:
        return OUTCOMES[os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])]
    count = 0

    def happens(*_: object) -> None:
        nonlocal count
        count += 1
        if count != step:
            return
        if fault == "dies":
            os._exit(OUTCOMES.index("died"))
        if fault == "SIGTERM":
            signal.raise_signal(signal.SIGTERM)
        else:
            number = getattr(errno, fault)
            raise OSError(number, os.strerror(number))

    _have_told(happens, folder)
    sys.stdout = sys.stderr = io.StringIO()
    outcome = "another error"
    try:
        refused = work()
        outcome = "done" if count < step else "refused" if refused else "done all the same"
    except RecordError:
        outcome = "refused"
    finally:
        os._exit(OUTCOMES.index(outcome))


def all_states(work: Callable[[], object], folder: Path, copies: Path) -> bool:
    """Run something in a fork, and keep what a kill would leave at each of its steps.

    Parameters
    ----------
    work : callable                 gives 0 where all went well
    folder : Path                   what is done in it counts
    copies : Path                   made; gets a copy of the folder for each step, named from 0001,
                                    and `opened.txt`, the files that were opened to be written

    Returns
    -------
    bool                            whether all went well
    """
    copies.mkdir()
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    count, busy, opened = 0, False, []

    def happens(event: str = "", name: object = "") -> None:
        nonlocal count, busy
        if busy:
            return
        busy = True
        count += 1
        shutil.copytree(folder, copies / f"{count:04d}")
        opened.extend([str(Path(str(name)).relative_to(folder))] if event == "open" else [])
        busy = False

    _have_told(happens, folder)
    sys.stdout = sys.stderr = io.StringIO()
    failed = True
    try:
        failed = bool(work())
        (copies / "opened.txt").write_text("\n".join(opened))
    finally:
        os._exit(int(failed))


def _have_told(happens: Callable[..., object], folder: Path) -> None:
    """Have a function called before every step that changes something in a folder."""

    def seen(event: str, given: tuple) -> None:
        if event not in _EVENTS or (event == "open" and not given[2] & _WRITING):
            return
        # A number is a handle, of a file that was opened before.
        if isinstance(given[0], int):
            return
        if os.path.abspath(str(given[0])).startswith(str(folder)):
            happens(event, os.path.abspath(str(given[0])))

    fsync, write, truncate, exchange = os.fsync, os.write, os.ftruncate, disk._exchange
    os.fsync = lambda handle: (happens(), fsync(handle))[1]
    os.write = lambda handle, content: (happens(), write(handle, content))[1]
    os.ftruncate = lambda handle, size: (happens(), truncate(handle, size))[1]
    disk._exchange = lambda *names: (happens(), exchange(*names))[1]
    sys.addaudithook(seen)


def without_rights(work: Callable[[], int]) -> tuple[int, str]:
    """Run something in a fork as a user for whom the rights of files hold: root gives up its own.

    Parameters
    ----------
    work : callable                 gives an exit code

    Returns
    -------
    int                             the exit code
    str                             what was said on standard error
    """
    reading, writing = os.pipe()
    child = os.fork()
    if child:
        os.close(writing)
        with os.fdopen(reading) as said:
            text = said.read()
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), text
    code = 70
    try:
        if os.geteuid() == 0:
            # Version 3 of the header, this process; no capability of any kind.
            header, none = struct.pack("Ii", 0x20080522, 0), bytes(24)
            assert ctypes.CDLL(None).capset(header, none) == 0
        sys.stdout, sys.stderr = io.StringIO(), os.fdopen(writing, "w")
        code = work()
        sys.stderr.flush()
    finally:
        os._exit(code)


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """No file of this process grows beyond some bytes: a write fails there, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
