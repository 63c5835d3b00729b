"""The two plots of BENCHMARK.md, drawn from figures.csv."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, MultipleLocator

from benchmarks.report import Row, read_rows
from palpate.figures import BLUE, GREY, INK, ORANGE, styled

_NOMINAL = 95.0
# By how much the axis is longer than its points need: room for their labels.
_ROOM = 5.0
# Of labels [characters].
_WIDTH = 32
# From the last row of a group to the next group [rows].
_GAP = 1.5
_ERROR, _RATE = "rms per component, worst case", "points per CPU second, slowest case"
_PEER = re.compile(rf"beside it: (.+) \((.+)\), speckle, window 21 px: {_ERROR}")
_OWN_ERROR = f"analytic speckle, noise 1.5, window 21 px: {_ERROR}"
_OWN_RATE = "refined points per CPU second, window 21 px, one pair"
_REPEATS = re.compile(r"95 % interval of (\w+) covers the truth, (\d+) repeats of .*?, (.+)")
_TABLE = re.compile(r"table 3, (.+): 95 % intervals that hold the truth")


@dataclass(frozen=True, slots=True)
class _Held:
    """How often intervals hold the truth, and one standard error of that by chance [%]."""

    group: str
    label: str
    share: float
    chance: float


def draw_plots(path: Path, folder: Path) -> None:
    """Draw both plots as SVG: the same figures give the same bytes.

    Parameters
    ----------
    path : Path                     of figures.csv
    folder : Path                   made where it is not there; files there are replaced
    """
    folder.mkdir(exist_ok=True)
    rows = [row for row in read_rows(path) if row["figure"]]
    for name, figure in (
        ("correlation", correlation_figure(rows)),
        ("coverage", coverage_figure(rows)),
    ):
        _save(figure, folder / f"{name}.svg")


@styled
def correlation_figure(rows: Sequence[Row]) -> Figure:
    """Error of image correlation against its speed, each program a labelled point.

    Parameters
    ----------
    rows : sequence of Row          of figures.csv, measured ones only

    Returns
    -------
    Figure
    """
    value = {row["what"]: float(row["figure"]) for row in rows}
    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    axes = figure.add_subplot()
    axes.set(xscale="log", yscale="log")
    if _OWN_ERROR in value and _OWN_RATE in value:
        start = "from starts that are off by up to 0.7 px"
        _point(axes, 1e3 * value[_OWN_RATE], value[_OWN_ERROR], f"Palpate\n{start}", BLUE)
    for name in value:
        peer = _PEER.fullmatch(name)
        rate = value.get(name.replace(_ERROR, _RATE))
        if peer and rate:
            label = f"OpenCV\n{peer[2]}" if "opencv" in peer[1] else peer[1]
            _point(axes, 1e3 * rate, value[name], label, GREY)
    _scale(axes)
    return figure


def _scale(axes: Axes) -> None:
    """Limits, ticks and words around the points."""
    axes.margins(0.12)
    left, right = axes.get_xlim()
    axes.set_xlim(left, _ROOM * right)
    axes.xaxis.set_major_formatter(EngFormatter(sep=" "))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
    axes.minorticks_off()
    axes.grid(color=GREY, alpha=0.25, linewidth=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set(
        title="Image correlation: speckle of known motion, windows of 21 px"
        " (lower right is better)",
        xlabel="points per CPU second (others: search included; OpenCV: pixels of a dense field)",
        ylabel="rms error of a displacement [px]",
    )


def _point(axes: Axes, x: float, y: float, label: str, colour: str) -> None:
    axes.plot(x, y, "o", color=colour, markersize=6)
    axes.annotate(
        label, (x, y), (7, 0), textcoords="offset points", va="center",
        color=BLUE if colour == BLUE else INK,
    )  # fmt: skip


@styled
def coverage_figure(rows: Sequence[Row]) -> Figure:
    """Shares of 95 % intervals that hold the truth, beside the nominal line.

    Parameters
    ----------
    rows : sequence of Row          of figures.csv, measured ones only

    Returns
    -------
    Figure
    """
    shares = [held for row in rows if (held := _held(row))]
    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    axes = figure.add_subplot()
    axes.axvline(_NOMINAL, color=ORANGE, linewidth=1.0)
    axes.annotate("nominal", (_NOMINAL, 1.01), xycoords=("data", "axes fraction"), ha="center",
                  color=ORANGE)  # fmt: skip
    _draw_groups(axes, shares)
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(right=100.8)
    axes.xaxis.set_major_locator(MultipleLocator(5.0))
    axes.grid(axis="x", color=GREY, alpha=0.25, linewidth=0.5)
    axes.spines[["top", "right", "left"]].set_visible(False)
    what = "95 % intervals that hold the truth [%]; bars: one standard error by chance"
    figure.supxlabel(what, fontsize="medium")
    return figure


def _draw_groups(axes: Axes, shares: Sequence[_Held]) -> None:
    """A dot and its bar in every row, rows of a group below its name."""
    groups = dict.fromkeys(held.group for held in shares)
    ticks: dict[float, str] = {}
    height = 0.0
    for group in groups:
        height += _GAP
        ticks[height] = group
        for held in shares:
            if held.group == group:
                height += 1.0
                ticks[height] = held.label
                axes.errorbar(held.share, height, xerr=held.chance, fmt="o", color=BLUE,
                              markersize=5, elinewidth=1.0)  # fmt: skip
    axes.set_yticks(list(ticks), [fill(label, _WIDTH) for label in ticks.values()])
    for label, text in zip(ticks.values(), axes.get_yticklabels(), strict=True):
        if label in groups:
            text.set_fontweight("bold")
    axes.set_ylim(height + 0.6, _GAP - 0.6)


def _held(row: Row) -> _Held | None:
    """What one row says, None where it is about something else."""
    chance = re.search(r"\+- ([\d.]+) % by chance", row["how"])
    if repeats := _REPEATS.fullmatch(row["what"]):
        group, label = f"{repeats[2]} repeats, {repeats[3]}", repeats[1]
    elif table := _TABLE.fullmatch(row["what"]):
        seeds = re.search(r"(\d+) seeds", row["how"])
        group = f"Table 3 of the paper, {seeds[1] if seeds else 'some'} repeats"
        label = table[1]
    else:
        return None
    return _Held(group, label, float(row["figure"]), float(chance[1]) if chance else 0.0)


@styled
def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, metadata={"Date": None, "Creator": None})
