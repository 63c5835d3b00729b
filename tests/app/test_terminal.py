"""Output as JSON, stages told one by one, completion for shells."""

import json
from types import SimpleNamespace

import numba
import pytest

from palpate.app import terminal
from palpate.app.process import Output, output_as
from palpate.app.terminal import progress_bar, table_content
from palpate.errors import InputError

POKE = (
    "--at", "20mm", "2 cm", "0.04", "--force", "0", "0", "-500mN", "--young-modulus", "50 kPa",
    "--poisson-ratio", "0.3",
)  # fmt: skip


@pytest.mark.parametrize("position", ["before", "behind"])
def test_tables_and_sentences_become_one_document(palpate, cube_session, position):
    words = ("check", cube_session)
    code, out, _ = palpate(*(("--json", *words) if position == "before" else (*words, "--json")))
    document = json.loads(out)
    assert (code, document["format"]) == (0, "palpate-output/1")
    surface, probings = document["tables"]
    assert surface["rows"][0] == {"figure": "vertices, triangles", "value": [218, 432]}
    # Numbers are numbers.
    assert probings["rows"][0]["probing"] == "n01"
    assert probings["rows"][0]["observed"] == 168
    assert document["sentences"]


def test_cells_are_read_as_a_person_reads_them():
    columns = ("name", "count", "value", "interval", "lost", "words", "minus", "place")
    row = (
        "12",
        "12",
        "0.30 ± 0.01",
        "20.7 to 21.3",
        "not determined",
        "5 mm",
        "-3e-05",
        "1.9, -9.7, 28",
    )
    (cells,) = table_content("t", columns, [row], "c")["rows"]
    assert cells == {
        "name": "12", "count": 12, "value": {"value": 0.30, "std": 0.01},
        "interval": [20.7, 21.3], "lost": None, "words": "5 mm", "minus": -3e-05,
        "place": [1.9, -9.7, 28],
    }  # fmt: skip


def test_an_error_leaves_no_half_document(palpate):
    code, out, err = palpate("check", "nowhere", "--json")
    assert (code, out) == (2, "")
    assert "nowhere" in err


def test_stages_are_told_with_their_times(palpate, cube_session):
    _, _, quiet = palpate("poke", cube_session, *POKE)
    _, out, err = palpate("poke", cube_session, *POKE, "-v")
    lines = [line for line in err.splitlines() if line not in quiet.splitlines()]
    assert [line.split("%  ")[1] for line in lines] == [
        "integrals over the surface", "factorisation", "interior points",
    ]  # fmt: skip
    assert all(line.startswith("palpate: ") and " s  " in line for line in lines)
    assert "Displacement" in out


def test_units_of_options_are_understood(palpate, cube_session):
    plain = ("--at", "0.02", "0.02", "0.04", "--force", "0", "0", "-0.5",
             "--young-modulus", "50000", "--poisson-ratio", "0.3")  # fmt: skip
    assert palpate("poke", cube_session, *POKE)[1] == palpate("poke", cube_session, *plain)[1]
    code, _, err = palpate("poke", cube_session, *POKE[:9], "50 furlong", *POKE[10:])
    assert code == 2
    assert "'50 furlong'" in err
    assert "kPa" in err


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_learn_the_commands(palpate, shell):
    code, out, _ = palpate("completion", shell)
    assert code == 0
    assert all(word in out for word in ("compression", "reproduce", "poisson-range"))


@pytest.mark.parametrize("words", [("fit",), ("lab", "make"), ("calibrate", "rig"), ("mesh",)])
def test_help_has_no_noise_and_even_line_ends(palpate, words):
    code, out, _ = palpate(*words, "--help")
    assert code == 0
    assert "--empty" not in out
    assert "--no-force" not in out
    assert "default: False" not in out
    assert "--json" in out
    boxed = [line.rstrip() for line in out.splitlines() if line.startswith("│")]
    assert len({len(line) for line in boxed}) == 1


def test_the_lists_of_the_facility_can_be_found(palpate):
    assert "palpate lab --list" in palpate("lab", "--help")[1]


def test_nothing_is_shown_where_stderr_is_no_terminal(capsys):
    with progress_bar() as report:
        report("factorisation", 0.5)
        report("fit", 1.0)
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")


def _announced(capsys, monkeypatch, fractions, *arguments, every=4, **options):
    """What is said of work whose fractions come every few seconds."""
    clock = iter(range(1, 1 + every * len(fractions), every))
    monkeypatch.setattr(terminal, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    with progress_bar(*arguments, **options) as report:
        for fraction in fractions:
            report("pictures", fraction)
    return [
        line.removeprefix("palpate: note: ").removesuffix("; Ctrl-C stops it")
        for line in capsys.readouterr().err.splitlines()
    ]


@pytest.mark.parametrize(
    ("fractions", "says"),
    [
        # One more per cent every 4 s: 400 s in all.
        ((0.0, 0.01, 0.02, 0.03, 0.04), ["some 6 minutes to go, by the pace of the last 8 s"]),
        # What is there already when it begins took no time: a resumed run.
        ((0.9, 0.92, 0.94, 0.96), []),
        # Hardly begun: the pace is known after half a minute.
        (tuple(2e-4 * k for k in range(18)), ["some 6 hours to go, by the pace of the last 32 s"]),
        # Seconds only.
        ((0.0, 0.2, 0.4, 0.6, 0.8), []),
        # Half is done at once; then 4 per mille every 4 s, 500 s of it.
        (
            (0.0, 0.25, 0.5, *(0.5 + 0.004 * k for k in range(1, 16))),
            ["some 8 minutes to go, by the pace of the last 12 s"],
        ),
    ],
)  # fmt: skip
def test_what_takes_minutes_is_announced(capsys, monkeypatch, fractions, says):
    assert _announced(capsys, monkeypatch, fractions) == says


def test_the_cure_of_long_work_is_said(capsys, monkeypatch):
    fractions = (0.0, 0.01, 0.02, 0.03, 0.04)
    (said,) = _announced(capsys, monkeypatch, fractions, "a larger --step", resumes=True)
    assert said.endswith(
        "; Ctrl-C stops it, and the same command goes on from there; shorter: a larger --step"
    )


def test_more_than_a_day_is_refused_where_it_would_be_lost(capsys, monkeypatch):
    fractions = tuple(2e-6 * k for k in range(9))
    with pytest.raises(InputError, match=r"there would be some \d\d days to go, .*; shorter: less"):
        _announced(capsys, monkeypatch, fractions, "less", every=8)
    (said,) = _announced(capsys, monkeypatch, fractions, "less", every=8, resumes=True)
    assert "days to go" in said


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
