"""figures.csv from figures, and from it BENCHMARK.md: the twenty that a sceptic asks for first."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.figure import Figure
from benchmarks.headlines import HEADLINES, Headline

COLUMNS = ("part", "date", "commit", "processor", "section", "what", "unit", "figure", "how")
Row = dict[str, str]
_UNITS = {"": "", "x": "x", "1/s": " a second", "k": " thousand"}


def write_part(
    path: Path, part: str, figures: Sequence[Figure], machine: Mapping[str, str]
) -> None:
    """Replace the rows of one part; the other parts stay as they were measured.

    Parameters
    ----------
    path : Path                     of figures.csv, made where it is not there
    part : str                      its name; parts stand in alphabetical order
    figures : sequence of Figure
    machine : str -> str            from `machine.described`
    """
    others = [row for row in read_rows(path) if row["part"] != part] if path.exists() else []
    rows = [_row(part, figure, machine) for figure in figures]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted([*others, *rows], key=lambda row: row["part"]))


def read_rows(path: Path) -> list[Row]:
    """All rows of figures.csv, each by column."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def write_page(path: Path, page: Path) -> None:
    """Write BENCHMARK.md: headlines beside their anchors, and the plots.

    Parameters
    ----------
    path : Path                     of figures.csv; what it lacks is left out of the page
    page : Path                     replaced
    """
    rows = {row["what"]: row for row in read_rows(path) if row["figure"]}
    lines = ["# Benchmark", "", _introduction(list(rows.values()))]
    for subject, headlines in HEADLINES.items():
        cells = [_cells(headline, rows) for headline in headlines if headline.what in rows]
        if cells:
            lines += [
                "",
                f"## {subject}",
                "",
                "| what | figure | beside it |",
                "| --- | ---: | --- |",
            ]
            lines += [f"| {' | '.join(row)} |" for row in cells]
    lines += [
        "",
        "## Plots",
        "",
        "![rms error against points per CPU second, by program](benchmarks/plots/correlation.svg)",
        "",
        "![share of 95 % intervals that hold the truth](benchmarks/plots/coverage.svg)",
    ]
    page.write_text("\n".join(lines) + "\n", encoding="utf-8")


def as_text(figures: Sequence[Figure]) -> str:
    """A short table for the screen."""
    return "\n".join(
        f"{number(figure.reached):>9} {figure.unit:<7}  {figure.name}" for figure in figures
    )


def with_notes(figures: Sequence[Figure]) -> str:
    """The same, how each was measured below it."""
    return "\n".join(
        as_text([figure]) + (f"\n{'':19}{figure.note}" if figure.note else "") for figure in figures
    )


def number(value: float | None) -> str:
    """Three significant digits, powers of ten only where they are short."""
    if value is None:
        return "-"
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"
    return f"{value:.1e}"


def _row(part: str, figure: Figure, machine: Mapping[str, str]) -> Row:
    return {
        **{name: machine[name] for name in ("date", "commit", "processor")},
        "part": part,
        "section": figure.section,
        "what": figure.name,
        "unit": figure.unit,
        "figure": "" if figure.reached is None else number(figure.reached),
        "how": figure.note,
    }


def _introduction(rows: Sequence[Row]) -> str:
    """How to measure again, and where and when it was."""
    dates, machines = (sorted({row[name] for row in rows}) for name in ("date", "processor"))
    when = " to ".join(dict.fromkeys([dates[0], dates[-1]]))
    return (
        "`make benchmark` measures everything again and writes this page, `python -m benchmarks.run"
        " --part NAME` one part of it. All figures, with how each was measured, its machine, date"
        " and commit, are in [benchmarks/figures.csv](benchmarks/figures.csv). Those below:"
        f" {'; '.join(machines)}; {when}."
    )


def _cells(headline: Headline, rows: Mapping[str, Row]) -> tuple[str, str, str]:
    """Label, figure and anchors; anchors that were not measured are left out."""
    beside = [
        anchor if isinstance(anchor, str) else f"{anchor[0]}: {_shown(rows[anchor[1]])}"
        for anchor in headline.beside
        if isinstance(anchor, str) or anchor[1] in rows
    ]
    return headline.label, _shown(rows[headline.what]), "; ".join(beside)


def _shown(row: Row) -> str:
    """A figure with its unit, without powers of ten."""
    figure = np.format_float_positional(float(row["figure"]), trim="-")
    return f"{figure}{_UNITS.get(row['unit'], ' ' + row['unit'])}"
