"""Tables that a spreadsheet opens: a text from a file is a text there, and a number a number."""

import csv
import io
from pathlib import Path

import pytest

import palpate
from palpate.calibration import Calibration, quality
from palpate.calibration.quality import PictureError
from palpate.campaign.rows import Row, table_text
from palpate.paper.result import ResultTable, csv_text
from palpate.records import spreadsheet_text

FORMULAS = "=HYPERLINK(A1)", "+1+1", "-1+1|' /C calc'!A0", "@SUM(1)", "-", "--1"
HARMLESS = "-1.5", "+3", "-1e-05", "-inf", "", "a=1", "n01", "'a", "a,b", 'a"b'


def cells_of(text):
    return list(csv.reader(io.StringIO(text, newline="")))


@pytest.mark.parametrize("formula", FORMULAS)
def test_what_begins_like_a_formula_is_a_text(formula):
    assert cells_of(spreadsheet_text([("a", formula)])) == [["a", f"'{formula}"]]


@pytest.mark.parametrize("cell", HARMLESS)
def test_numbers_and_other_texts_stay(cell):
    assert cells_of(spreadsheet_text([("a", cell)])) == [["a", cell]]


@pytest.mark.parametrize("mark", ["\t", "\r", "\n", "\r\n", "\x1b"])
def test_no_character_begins_another_cell(mark):
    text = spreadsheet_text([("a", f"{mark}=1"), (f"b{mark}=1", "c")])
    shown = repr(mark)[1:-1]
    assert text == f"a,{shown}=1\nb{shown}=1,c\n"


def test_numbers_and_what_is_unknown_stay():
    assert spreadsheet_text([(-1.5, None, -2, 0.1)]) == "-1.5,,-2,0.1\n"


@pytest.mark.parametrize("formula", FORMULAS)
def test_tables_of_results_are_written_so(formula):
    row = Row(formula, formula, poisson_ratio=-0.25, message=formula)
    _, (session, group, *others) = cells_of(table_text([row]))
    assert {session, group} == {f"'{formula}"}
    assert f"'{formula}" in others
    assert "-0.25" in others
    table = ResultTable("t", ("name", "value"), (0, 2), ((formula, -1.5),))
    assert cells_of(csv_text([table]))[1] == [f"'{formula}", "-1.5"]


def test_the_table_of_a_calibration_is_written_so(tmp_path, monkeypatch):
    error = PictureError("=1+1", "@view", 48, 0, 0.1)
    monkeypatch.setattr(quality, "picture_errors", lambda _: [error])
    quality._write_pictures(tmp_path / "views.csv", object.__new__(Calibration))
    written = (tmp_path / "views.csv").read_text(encoding="utf-8")
    assert cells_of(written)[1] == ["'=1+1", "'@view", "48", "0", "0.1000"]


def test_no_other_file_writes_csv():
    root = Path(palpate.__file__).parent
    texts = {file: file.read_text(encoding="utf-8") for file in root.rglob("*.py")}
    written = [file.name for file, text in texts.items() if "csv.writer(" in text]
    assert written == ["csv_table.py"]
    assert "spreadsheet_text(rows)" in texts[root / "recording" / "record.py"]
