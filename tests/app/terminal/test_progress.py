"""The progress bar: silent where nobody watches, gone when it is done."""

import numba

from palpate.app.output import Output, output_as
from palpate.app.terminal.progress import progress_bar


def test_nothing_is_shown_where_stderr_is_no_terminal(capsys):
    with progress_bar() as report:
        report("factorisation", 0.5)
        report("fit", 1.0)
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")


def test_stages_are_shown_on_a_terminal(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar() as report:
        report("factorisation", 0.5)
    shown = capsys.readouterr().err
    assert "factorisation" in shown
    assert "50%" in shown


def test_a_stage_that_waits_for_the_compiler_says_so(capsys):
    @numba.njit
    def inner(x):
        return x + 1

    @numba.njit
    def outer(x):
        return inner(x) * 2

    with output_as(Output(verbose=True), ["fit"]), progress_bar() as report:
        report("matching", 0.25)
        assert outer(3) == 8
        assert outer(4) == 10
        report("fit", 0.5)
    stages = [line.split("%")[1].strip() for line in capsys.readouterr().err.splitlines()]
    assert stages == ["matching", "matching (compiling, once)", "matching", "fit"]
    fresh = numba.njit(outer.py_func)
    assert fresh(3) == 8
    # Nobody listens any longer.
    assert capsys.readouterr().err == ""
