"""The command line: exit codes, one clear message, a fast start."""

import re
import signal
import subprocess
import sys
import time

import pytest

from palpate import __version__
from palpate.app.commands import fit as fit_command
from palpate.errors import InputError


def test_version(palpate):
    code, out, _ = palpate("--version")
    lines = out.splitlines()
    assert (code, lines[0]) == (0, f"palpate {__version__}")
    # What the numbers of an estimate depend on, too.
    assert {line.split()[0] for line in lines[1:]} >= {"Python", "numpy", "scipy", "numba"}


def test_help_names_every_command(palpate):
    code, out, _ = palpate("--help")
    assert code == 0
    assert all(name in out for name in ("fit", "check", "compression"))


def test_help_goes_from_the_measurement_to_what_few_need(palpate):
    _, out, _ = palpate("--help")
    words = ("Measure", "init", "check", "Estimate", "fit", "Use", "Laboratory", "--help")
    # As headings, and as commands with their text: either follows the frame.
    places = [re.search(rf"[│─] {word} ", out).start() for word in words]
    assert places == sorted(places)
    assert "Commands ─" not in out


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
        (["check"], "SESSION is missing; see palpate check --help"),
        (["poke", "ball", "--at", "0", "0"], "--at takes 3 values, not 2; see palpate poke"),
        (
            ["poke", "ball", "--at", "0", "0", "1", "--push", "2mm"],
            "give --force with 3 values (--push: no such option); see palpate poke --help",
        ),
        (["measure", "virtual", "--out", __file__], "test_cli.py: is not a folder; choose another"),
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


_SCRIPT = "import sys; from palpate.app.cli import main; sys.exit(main(['--help']))"


@pytest.mark.parametrize(
    ("redirection", "code", "message"),
    [
        ("| true; exit ${PIPESTATUS[0]}", 141, ""),
        ("> /dev/full", 2, "palpate: output: No space left on device; all files are whole\n"),
        (">&-", 0, "palpate: note: standard output is closed: nothing is shown\n"),
        ("<&- >&- 2>&-", 0, ""),
    ],
)
def test_output_that_goes_nowhere(redirection, code, message):
    command = ["bash", "-c", f'"$0" -c "$1" {redirection}', sys.executable, _SCRIPT]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (code, message)


@pytest.mark.usefixtures("heeded_signals")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_signal_ends_with_one_line_and_leaves_nothing(
    palpate, cube_session, tmp_path, monkeypatch, number, code
):
    before = signal.getsignal(number)
    monkeypatch.setattr(fit_command, "fit_session", lambda *_, **__: signal.raise_signal(number))
    actual, out, err = palpate("fit", cube_session)
    assert (actual, out) == (code, "")
    assert err == f"palpate: stopped by {number.name}; nothing half done is left\n"
    assert [path.name for path in tmp_path.iterdir()] == ["cube"]
    assert signal.getsignal(number) is before


def test_a_signal_that_is_turned_into_another_error_is_one_still(
    palpate, cube_session, monkeypatch
):
    def fit_session(*_, **__):
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt as error:
            raise RuntimeError("as the interpreter does while it makes a class") from error

    monkeypatch.setattr(fit_command, "fit_session", fit_session)
    assert palpate("fit", cube_session)[0] == 143


def test_a_signal_that_is_ignored_stays_ignored(palpate, cube_session, monkeypatch):
    def fit_session(*_, **__):
        signal.raise_signal(signal.SIGHUP)
        raise InputError("went on")

    monkeypatch.setattr(fit_command, "fit_session", fit_session)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert palpate("fit", cube_session) == (2, "", "palpate: went on\n")
    finally:
        signal.signal(signal.SIGHUP, before)
