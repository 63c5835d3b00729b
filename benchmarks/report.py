"""BENCHMARK.md from figures."""

from collections.abc import Sequence
from pathlib import Path

from benchmarks.figure import (
    BEM,
    CAMPAIGN,
    DOOR,
    ESTIMATION,
    FACILITY,
    FLOW,
    SIMULATION,
    Figure,
    Limit,
)

HEAD = "| what | unit | must | reach for | reached | kept | how |"
KEPT = (
    '"kept" says which demand is met: "reach", "must", or "missed"; "not reached" where only "reach'
    ' for" is asked. Rows without a demand stand beside the others for comparison. x = times.'
)
MARK = "<!-- part: "
_SECTIONS = (BEM, ESTIMATION, FLOW, FACILITY, SIMULATION, CAMPAIGN, DOOR)
RULE = "| --- | --- | --- | --- | --- | --- | --- |"


def as_markdown(
    figures: Sequence[Figure], machine: Sequence[tuple[str, str]], failures: dict[str, str]
) -> str:
    """One part of the report.

    Parameters
    ----------
    figures : sequence of Figure
    machine : pairs of str          from `machine.described`
    failures : subject -> message   subjects that stopped before their figures
    """
    lines = [f"- {heading}: {text}" for heading, text in machine]
    for section in _SECTIONS:
        rows = [_row(figure) for figure in figures if figure.section == section]
        if rows:
            lines += ["", f"## {section}", "", HEAD, RULE, *rows]
    if failures:
        lines += ["", "## Not measured", ""]
        lines += [f"- `{name}`: {message}" for name, message in failures.items()]
    return "\n".join(lines) + "\n"


def write_part(path: Path, part: str, text: str) -> None:
    """Put one part into the report; the other parts stay as they were measured.

    Parameters
    ----------
    path : Path                     made where it is not there
    part : str                      its name; parts stand in alphabetical order
    text : str                      of `as_markdown`
    """
    parts: dict[str, str] = {}
    if path.exists():
        pieces = path.read_text(encoding="utf-8").split(MARK)
        for piece in pieces[1:]:
            name, _, body = piece.partition(" -->\n")
            parts[name] = body
    parts[part] = "\n" + text + "\n"
    head = "\n".join(
        ["# Benchmark", "", "Written by `python -m benchmarks.run`; do not edit by hand."]
    )
    body = "".join(f"{MARK}{name} -->\n{parts[name]}" for name in sorted(parts))
    path.write_text(f"{head}\n\n{KEPT}\n\n{body}".rstrip() + "\n", encoding="utf-8")


def as_text(figures: Sequence[Figure]) -> str:
    """A short table for the screen."""
    return "\n".join(
        f"{figure.verdict or '-':>12}  {number(figure.reached):>9} {figure.unit:<2}"
        f"  (must {_limit(figure.must, figure.higher) or '-'},"
        f" reach {_limit(figure.reach, figure.higher) or '-'})  {figure.name}"
        for figure in figures
    )


def with_notes(figures: Sequence[Figure]) -> str:
    """The same, how each was measured below it."""
    return "\n".join(
        as_text([figure]) + (f"\n{'':16}{figure.note}" if figure.note else "") for figure in figures
    )


def number(value: float | None) -> str:
    """Three significant digits, powers of ten only where they are short."""
    if value is None:
        return "-"
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"
    return f"{value:.1e}"


def _row(figure: Figure) -> str:
    limits = (_limit(figure.must, figure.higher), _limit(figure.reach, figure.higher))
    cells = (
        figure.name,
        figure.unit,
        *limits,
        number(figure.reached),
        figure.verdict,
        figure.note.replace("|", "\\|"),
    )
    return "| " + " | ".join(cells) + " |"


def _limit(limit: Limit, higher: bool) -> str:
    if limit is None:
        return ""
    if isinstance(limit, tuple):
        return f"{number(limit[0])} to {number(limit[1])}"
    return f"{'>=' if higher else '<='} {number(limit)}"
