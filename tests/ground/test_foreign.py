"""Whatever a library does to its child process, the caller gets a result or one error."""

import os
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import pytest

from palpate import foreign
from palpate.errors import RecordError
from palpate.foreign import result_in_child, results_in_child

# What libraries do: the child loads this module by its name.
_LIBRARY = """
import ctypes, os, time
from palpate.errors import RecordError

def halves(number):
    while number:
        print("a library speaks", flush=True)
        os.write(1, b"and at length" * 1000)
        yield number
        number //= 2

def crash(): ctypes.string_at(0)
def end(): os._exit(0)
def exit(): raise SystemExit("no more")
def hang(): time.sleep(60)
def spin(file):
    open(file, "w").write(str(os.getpid()))
    while True: pass
def take(size): return len(bytearray(size))
def refuse(): raise RecordError("part.stp: is no drawing")
def fail(): return {}["word"]
def odd(): return lambda: None
"""


@pytest.fixture
def library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "some_library.py").write_text(_LIBRARY)
    monkeypatch.syspath_prepend(tmp_path)
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    yield import_module("some_library")
    del sys.modules["some_library"]


def test_results_come_one_by_one_whatever_a_library_prints(library):
    assert list(results_in_child(library.halves, 9)) == [9, 4, 2, 1]
    assert result_in_child(library.take, 2**20) == 2**20


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("crash", "^a crash, or it takes more than 4 GB of memory$"),
        ("end", "^a crash, or"),
        ("exit", "^SystemExit no more$"),
        ("fail", "^KeyError 'word'$"),
        ("odd", "pickle"),
    ],
)
def test_what_goes_wrong_is_one_error(library, name: str, says: str):
    with pytest.raises(RuntimeError, match=says):
        result_in_child(getattr(library, name))


def test_refusals_are_passed_on(library):
    with pytest.raises(RecordError, match=r"^part\.stp: is no drawing$"):
        result_in_child(library.refuse)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="only Linux limits address space")
def test_memory_is_limited(library):
    with pytest.raises(RuntimeError, match=r"^it takes more than 4 GB of memory$"):
        result_in_child(library.take, foreign._MOST_BYTES)


def test_time_is_limited_for_each_result(library):
    start = time.perf_counter()
    with pytest.raises(RuntimeError, match=r"^it takes more than 0\.5 s$"):
        result_in_child(library.hang, seconds=0.5)
    # Of the 60 s that it would sleep.
    assert time.perf_counter() - start < 10.0


def test_no_process_is_left_where_the_results_are_not_wanted(library):
    results = results_in_child(library.halves, 2**200)
    next(results)
    results.close()
    # Of this process's children, the library's would still write.
    with pytest.raises(ChildProcessError):
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="looks for the process in /proc")
def test_the_work_ends_in_time_where_the_command_was_killed(library, tmp_path: Path):
    message = tmp_path / "child"
    code = (
        "from palpate.foreign import result_in_child; import some_library;"
        f" result_in_child(some_library.spin, {str(message)!r}, seconds=1.0)"
    )
    command = subprocess.Popen([sys.executable, "-c", code])
    child = _soon(lambda: message.exists() and message.read_text())
    command.send_signal(signal.SIGKILL)
    command.wait()
    assert _soon(lambda: not _runs(int(child)))


def _soon(ask):
    """What a function gives as soon as it is something, within 20 s."""
    for _ in range(200):
        if result := ask():
            return result
        time.sleep(0.1)
    raise AssertionError


def _runs(number: int) -> bool:
    """Whether a process is there, and not only waits to be collected."""
    try:
        return "Z" not in Path(f"/proc/{number}/stat").read_text().rpartition(")")[2][:3]
    except FileNotFoundError:
        return False
