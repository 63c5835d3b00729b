"""Names that command a terminal: they are printed, escaped, and the terminal stays as it is."""

import ast
import json
import shutil
from pathlib import Path

import pytest
from estimate_samples import sample_result

import palpate
from palpate.api import Result
from palpate.app.cli import main
from palpate.app.process import Output, output_as
from palpate.app.tables import terminal_table
from palpate.app.terminal import print_tables, print_text, progress_bar
from palpate.errors import PalpateError, print_message
from palpate.records import read_session

# Clear the screen; the same with a C1 character; a title; from right to left; a line of its own.
COMMANDS = "\x1b[2J", "\x9b2J", "\x1b]0;title\x07", "\u202etxt.", "\rE = 1 Pa", "\u2066"
NAME = "a".join(COMMANDS)
SHOWN = "a".join(
    (r"\x1b[2J", r"\x9b2J", r"\x1b]0;title\x07", r"\u202etxt.", r"\rE = 1 Pa", r"\u2066")
)


def flat(text):
    """A text without the line breaks of the terminal's width; none of its letters is a command."""
    assert all(letter.isprintable() or letter == "\n" for letter in text), repr(text)
    return text.replace("\n", "").replace(" ", "")


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")


def test_tables_show_what_would_be_a_command(capsys):
    print_tables(terminal_table(NAME, ("name", NAME), [(NAME, NAME)], caption=NAME))
    assert flat(capsys.readouterr().out).count(flat(SHOWN)) == 5


def test_sentences_and_messages_show_it(capsys):
    print_text(f"first\n{NAME}")
    print_message(NAME)
    print_message(str(PalpateError(NAME)))
    captured = capsys.readouterr()
    assert captured.out.startswith("first\n")
    assert flat(captured.out) == flat(f"first{SHOWN}")
    assert flat(captured.err) == flat(f"palpate: {SHOWN}" * 2)


def test_stages_show_it(capsys, monkeypatch):
    with output_as(Output(verbose=True), ["fit"]), progress_bar() as report:
        report(NAME, 0.5)
    assert flat(SHOWN) in flat(capsys.readouterr().err)
    # The bar of a terminal has commands of its own.
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar() as report:
        report(f"[bold]{NAME}", 0.5)
    bar = capsys.readouterr().err
    assert f"[bold]{SHOWN}" in bar
    assert not any(command in bar for command in COMMANDS)


def test_a_document_shows_it(capsys):
    with output_as(Output(json=True), ["check", NAME]):
        print_tables(terminal_table("t", ("name", "value"), [(NAME, NAME)]))
        print_text(NAME)
    out = capsys.readouterr().out
    flat(out)
    document = json.loads(out)
    assert document["command"] == ["check", SHOWN]
    assert document["tables"][0]["rows"] == [{"name": SHOWN, "value": SHOWN}]
    assert document["sentences"] == [SHOWN]


def test_the_command_line_shows_it(cube_session, tmp_path, monkeypatch, capsys):
    """A result whose folder's name is a command, then one that is not there."""
    monkeypatch.chdir(tmp_path)
    session = read_session(cube_session)
    folder = Result(session, sample_result(session)).save(tmp_path / "saved")
    name = NAME.replace("/", "")
    shutil.move(folder, tmp_path / name)
    assert main(["report", name]) == 0
    assert main(["report", "no" + name]) == 2
    captured = capsys.readouterr()
    assert flat(SHOWN) in flat(captured.out)
    assert flat(f"no{SHOWN}") in flat(captured.err)


def test_nothing_is_printed_by_other_ways():
    """One function prints lines on stderr, one sentences, one tables; each makes texts visible."""
    allowed = {
        "print": {"errors.py"},
        "Console": {"app/terminal.py", "app/arguments.py"},
    }
    root = Path(palpate.__file__).parent
    for file in root.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            name = getattr(getattr(node, "func", None), "id", "")
            source = file.relative_to(root).as_posix()
            assert source in allowed.get(name, {source}), f"{source}: line {node.lineno}: {name}"
