"""A process that dies, or a disk that fails, at a step of one's choice: in a fork of the test."""

import errno
import io
import os
import sys
from collections.abc import Callable
from pathlib import Path

from palpate import disk
from palpate.errors import RecordError

OUTCOMES = ["done", "died", "refused", "done all the same", "another error"]
# Events of the interpreter by which something on the disk is changed.
_EVENTS = {
    "open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.link", "os.chmod", "os.truncate"
}  # fmt: skip
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


def in_child(work: Callable[[], object], folder: Path, *, step: int, dies: bool) -> str:
    """Run something in a fork that fails at one of its steps.

    Parameters
    ----------
    work : callable
    folder : Path                   what is done in it counts
    step : int                      from 1
    dies : bool                     the process ends without any cleaning up, else the disk is full

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
        if count == step and dies:
            os._exit(OUTCOMES.index("died"))
        if count == step:
            raise OSError(errno.ENOSPC, "No space left on device")

    def seen(event: str, given: tuple) -> None:
        if event not in _EVENTS or (event == "open" and not given[2] & _WRITING):
            return
        if str(given[0]).startswith(str(folder)):
            happens()

    fsync, exchanged = os.fsync, disk._exchanged
    os.fsync = lambda handle: (happens(), fsync(handle))[1]
    disk._exchanged = lambda *names: (happens(), exchanged(*names))[1]
    sys.stdout = sys.stderr = io.StringIO()
    sys.addaudithook(seen)
    outcome = "another error"
    try:
        refused = work()
        outcome = "done" if count < step else "refused" if refused else "done all the same"
    except RecordError:
        outcome = "refused"
    finally:
        os._exit(OUTCOMES.index(outcome))
