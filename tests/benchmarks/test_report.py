"""figures.csv, and the page and plots that are made of it."""

from benchmarks.figure import BEM, NOT_MEASURED, Figure
from benchmarks.headlines import HEADLINES
from benchmarks.machine import ROOT
from benchmarks.plots import draw_plots
from benchmarks.report import read_rows, write_page, write_part
from benchmarks.run import FIGURES, PARTS

MACHINE = {"date": "2026-12-01", "commit": "0123abcd", "processor": "a processor, 2 cores"}


def test_headlines_are_twenty_rows_that_there_are():
    headlines = [headline for rows in HEADLINES.values() for headline in rows]
    names = [headline.what for headline in headlines]
    names += [a[1] for headline in headlines for a in headline.beside if not isinstance(a, str)]
    assert len(headlines) <= 20
    assert set(names) - {row["what"] for row in read_rows(FIGURES)} == set()


def test_figures_belong_to_parts_and_have_names_of_their_own():
    rows = read_rows(FIGURES)
    assert {row["part"] for row in rows} <= set(PARTS)
    assert len({row["what"] for row in rows}) == len(rows)


def test_a_part_replaces_its_own_rows_only(tmp_path):
    file = tmp_path / "figures.csv"
    write_part(file, "model", [Figure(BEM, "old", 1.0)], MACHINE)
    write_part(file, "door", [Figure(BEM, "other, and a comma", 2.34567, "s", "how")], MACHINE)
    stopped = Figure(NOT_MEASURED, "cube", None, note="it stopped")
    write_part(file, "model", [Figure(BEM, "new", 1234.5), stopped], MACHINE)
    rows = [(row["part"], row["what"], row["figure"]) for row in read_rows(file)]
    assert rows == [
        ("door", "other, and a comma", "2.35"),
        ("model", "new", "1234"),
        ("model", "cube", ""),
    ]
    assert {row["commit"] for row in read_rows(file)} == {"0123abcd"}


def test_the_page_leaves_out_what_was_not_measured(tmp_path):
    file, page = tmp_path / "figures.csv", tmp_path / "page.md"
    fit = HEADLINES["Time and memory"][1]
    write_part(file, "model", [Figure(BEM, fit.what, 12.3, "s")], MACHINE)
    write_page(file, page)
    lines = page.read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if line.startswith("| ")][2:] == [f"| {fit.label} | 12.3 s |  |"]
    assert [line for line in lines if line.startswith("## ")] == ["## Time and memory", "## Plots"]


def test_the_page_is_that_of_the_figures(tmp_path):
    write_page(FIGURES, tmp_path / "page.md")
    assert (tmp_path / "page.md").read_bytes() == (ROOT / "BENCHMARK.md").read_bytes()


def test_plots_of_the_same_figures_are_the_same_bytes(tmp_path):
    for name in ("one", "other"):
        draw_plots(FIGURES, tmp_path / name)
    for plot in ("correlation.svg", "coverage.svg"):
        first, other = ((tmp_path / name / plot).read_bytes() for name in ("one", "other"))
        assert first == other
        assert (ROOT / "benchmarks" / "plots" / plot).exists()
