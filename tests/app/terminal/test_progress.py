"""The progress bar: silent where nobody watches, gone when it is done."""

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
