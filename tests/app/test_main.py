"""The process of the command, before the command line is there."""

import signal
import subprocess
import sys

import pytest

# A module that interrupts the process as soon as it is looked for.
_INTERRUPTED = """
import runpy, signal, sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "palpate.app.process":
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Finder())
runpy.run_module("palpate", run_name="__main__")
"""


def _run(*words: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)


def test_the_module_is_the_command():
    done = _run("-m", "palpate", "--version")
    assert done.returncode == 0
    assert done.stdout.startswith("palpate ")


@pytest.mark.usefixtures("heeded_signals")
def test_an_early_interruption_ends_without_a_traceback():
    done = _run("-c", _INTERRUPTED)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")
