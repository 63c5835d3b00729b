"""The command `palpate`: turns errors and signals into one line and an exit code.

Nothing heavy is imported here: a signal may come before the command line is read.
"""

import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from types import FrameType
from typing import NoReturn

from palpate.app.process import BAD_INPUT, BY_SIGNAL, NOT_OK, guarded
from palpate.errors import NotConvergedError, PalpateError, print_message

_BROKEN_PIPE = BY_SIGNAL + 13
_STOP_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGXCPU")


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str or None     None: those of the process

    Returns
    -------
    int                             0; 2 bad input, or a disk that does not take the result, said in
                                    one message; 3 an estimate that is not ok, or a result that
                                    changed; 70 memory ran out, or an error of the program, reported
                                    in a file; 128 and the signal's number where one stopped it: 130
                                    interrupted, 143 terminated, 141 nobody reads what is printed
    """
    try:
        with _stopped_by_signals():
            _open_streams()
            words = list(sys.argv[1:] if arguments is None else arguments)
            code: int = import_module("palpate.app.arguments").run(words)
            sys.stdout.flush()
        return code
    except PalpateError as error:
        _print_message(str(error))
        return NOT_OK if isinstance(error, NotConvergedError) else BAD_INPUT
    except KeyboardInterrupt as error:
        number = signal.Signals(error.args[0] if error.args else signal.SIGINT)
        _print_message(f"stopped by {number.name}; nothing half done is left")
        return BY_SIGNAL + number
    except OSError as error:
        # What could not be printed must not come up again at the end of the process.
        _discard_output()
        if isinstance(error, BrokenPipeError):
            return _BROKEN_PIPE
        if _folder_is_gone():
            _print_message("the current folder no longer exists; change to another one")
            return BAD_INPUT
        what = f"{error.filename or 'output'}: {error.strerror or error}"
        if error.filename is None:
            # Files take their place whole or not at all, and complain themselves.
            what += "; all files are whole"
        # As messages of our own: no longer than a terminal shows.
        _print_message(str(PalpateError(what)))
        return BAD_INPUT


def _folder_is_gone() -> bool:
    """Whether the folder that the command was called in was removed since."""
    try:
        os.getcwd()
    except OSError:
        return True
    return False


def _print_message(text: str) -> None:
    with suppress(OSError):
        print_message(text)


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """Make the signals that ask a process to end raise `KeyboardInterrupt` with their number."""

    received: list[int] = []

    def stop(number: int, _: FrameType | None) -> NoReturn:
        received.append(number)
        raise KeyboardInterrupt(number)

    numbers = [getattr(signal, name) for name in _STOP_SIGNALS if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        numbers = []
    # What whoever started the process has it ignore stays ignored.
    handlers = {n: signal.getsignal(n) for n in numbers}
    replaced = {
        n: handler for n, handler in handlers.items() if handler not in (signal.SIG_IGN, None)
    }
    for number in replaced:
        signal.signal(number, stop)
    try:
        yield
    except BaseException:
        if received:
            # Whatever it was turned into on its way up.
            raise KeyboardInterrupt(received[0]) from None
        raise
    finally:
        for number, handler in replaced.items():
            signal.signal(number, handler)


def _open_streams() -> None:
    """Point closed standard streams at nothing: the next file opened would be taken for one."""
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(handle)
    if sys.stdin is None:
        sys.stdin = os.fdopen(0, closefd=False)
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w", closefd=False)
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w", closefd=False)
        _print_message("note: standard output is closed: nothing is shown")


def _discard_output() -> None:
    """Discard what is still to be printed."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
