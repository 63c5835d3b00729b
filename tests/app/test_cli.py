"""The command line: exit codes, one clear message, a fast start."""

import subprocess
import sys
import time

import pytest

from palpate import __version__


def test_version(palpate):
    code, out, _ = palpate("--version")
    assert (code, out.strip()) == (0, __version__)


def test_help_names_every_command(palpate):
    code, out, _ = palpate("--help")
    assert code == 0
    assert all(name in out for name in ("fit", "check", "compression"))


def test_help_loads_no_numerics():
    """A start within 0.3 s is possible only while nothing heavy is imported."""
    script = (
        "import sys; from palpate.app.cli import main; main(['--help']);"
        "heavy = {'numpy', 'scipy', 'numba', 'trimesh', 'meshio', 'matplotlib', 'jaxtyping'};"
        "sys.exit(', '.join(sorted(heavy & set(sys.modules))) or 0)"
    )
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    elapsed = time.perf_counter() - start
    assert done.returncode == 0, done.stderr
    # 0.12 s on an idle core; the limit leaves room for a busy one.
    assert elapsed < 2.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["check"], "requires an argument"),
        (["check", "nowhere"], "nowhere: no such file or folder"),
        (["check", "--speed", "3", "nowhere"], "--speed"),
    ],
)
def test_bad_input_ends_with_two_and_one_message(palpate, arguments, message):
    code, out, err = palpate(*arguments)
    assert code == 2
    assert out == ""
    assert message in err
    assert "Traceback" not in err
