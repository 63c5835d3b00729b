"""Tables of results as Markdown, CSV and on the terminal."""

import csv
import io

import numpy as np
from rich.console import Console

from palpate.paper.result_table import ResultTable, csv_text, markdown_text, terminal_table

TABLE = ResultTable(
    "Lengths [a]",
    ("source", "step", "length (mm)", "points"),
    (0, 0, 2, 0),
    (("paper [b]", 1, 2.5, None), ("joint", 12, 1.0 / 3.0, 488), ("none", 2, np.nan, 0)),
)


def test_markdown_has_a_row_each_numbers_to_the_right_and_rounded():
    assert markdown_text(TABLE).splitlines() == [
        "| source | step | length (mm) | points |",
        "|---|---:|---:|---:|",
        "| paper [b] | 1 | 2.50 | - |",
        "| joint | 12 | 0.33 | 488 |",
        "| none | 2 | - | 0 |",
    ]


def test_csv_keeps_all_digits_and_leaves_the_unknown_empty():
    rows = list(csv.reader(io.StringIO(csv_text([TABLE]))))
    assert rows[0] == list(TABLE.columns)
    assert rows[1] == ["paper [b]", "1", "2.5", ""]
    assert float(rows[2][2]) == 1.0 / 3.0
    assert rows[3] == ["none", "2", "", "0"]


def test_tables_in_one_file_are_an_empty_line_apart():
    text = csv_text([TABLE, TABLE])
    assert text.count("\n\n") == 1
    assert text.split("\n\n")[1] == csv_text([TABLE])


def test_the_terminal_shows_names_as_they_are():
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(terminal_table(TABLE))
    text = console.export_text()
    for word in ("Lengths [a]", "paper [b]", "0.33", "488"):
        assert word in text


def test_headings_are_broken_so_that_columns_are_as_narrow_as_their_numbers():
    wide = ResultTable("Wide", ("source", *(["largest error (kPa)"] * 7)), (0, *([2] * 7)),
                       (("tip misalignment", *([-1234.5] * 7)),))  # fmt: skip
    for width, whole in ((90, True), (60, False)):
        console = Console(width=width, record=True, file=io.StringIO())
        console.print(terminal_table(wide))
        text = console.export_text()
        # Seven headings of 19 characters would take 140 columns.
        assert (text.count("-1234.50") == 7) is whole
        # Nothing is left out where there is no room: it goes on in the next line.
        assert "…" not in text
