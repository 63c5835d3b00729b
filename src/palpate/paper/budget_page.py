"""What limits table 3: errors by source, as a table and as a picture."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palpate.figures import BLUE, GREY, ORANGE, STYLE
from palpate.paper.budget import ErrorSource
from palpate.paper.figures import Picture, drawn
from palpate.paper.result_table import Cell, ResultTable

# Columns of an ErrorSource's errors.
_NU, _YOUNG = 0, 2


def budget_table(sources: Sequence[ErrorSource]) -> ResultTable:
    """Mean and root mean square error of single probings, and of all together, by source.

    Parameters
    ----------
    sources : sequence of ErrorSource
    """
    rows: list[tuple[Cell, ...]] = []
    for source in sources:
        mean, single, joint = source.single.mean(axis=0), _rms(source.single), _rms(source.joint)
        rows.append(
            (
                source.name, len(source.joint),
                float(100 * mean[_YOUNG]), float(100 * single[_YOUNG]), float(mean[_NU]),
                float(single[_NU]), float(100 * joint[_YOUNG]), float(joint[_NU]),
            )
        )  # fmt: skip
    columns = (
        "source", "draws", "E mean (%)", "E rms (%)", "nu mean", "nu rms",
        "all: E rms (%)", "all: nu rms",
    )  # fmt: skip
    title = "Error of single probings, and of all together, with one source of error at a time"
    return ResultTable(title, columns, (0, 0, 2, 2, 4, 4, 2, 4), tuple(rows))


def sizes_table(sources: Sequence[ErrorSource]) -> ResultTable:
    """How much of each source there was.

    Parameters
    ----------
    sources : sequence of ErrorSource
    """
    rows = tuple((source.name, source.size) for source in sources)
    return ResultTable("Sizes of the sources", ("source", "size"), (0, 0), rows)


def budget_picture(sources: Sequence[ErrorSource]) -> Picture:
    """The same root mean squares as bars (single probings) and dots (all of them together).

    Parameters
    ----------
    sources : sequence of ErrorSource       the bench without errors first, the whole bench last
    """
    height = 1.1 + 0.27 * len(sources)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.4, height))
        panels = figure.subplots(1, 2, sharey=True)
        figure.subplots_adjust(
            left=0.15, right=0.98, wspace=0.08, top=1 - 0.42 / height, bottom=0.5 / height
        )
        for axes, column, factor, label in (
            (panels[0], _YOUNG, 100.0, "rms error of Young's modulus $E$ (%)"),
            (panels[1], _NU, 1.0, r"rms error of Poisson's ratio $\nu$"),
        ):
            _panel(axes, sources, column, factor)
            axes.set_xlabel(label)
        panels[0].set_yticks(range(len(sources)), [source.name for source in sources])
        panels[0].set_ylim(len(sources) - 0.4, -0.6)
        handles = [panels[0].containers[0], panels[0].lines[0], panels[0].lines[1]]
        labels = ["single probings", "all together", "single, without any source"]
        figure.legend(handles, labels, loc="upper center", ncols=3)
        return drawn(figure)


def _panel(axes: Axes, sources: Sequence[ErrorSource], column: int, factor: float) -> None:
    """Bars and dots of one constant."""
    rows = np.arange(len(sources))
    single = factor * np.array([_rms(source.single)[column] for source in sources])
    joint = factor * np.array([_rms(source.joint)[column] for source in sources])
    axes.barh(rows, single, height=0.62, color="#c9e2f2", edgecolor=BLUE, linewidth=0.6)
    axes.plot(joint, rows, "o", color=ORANGE, markersize=4.5, zorder=3, clip_on=False)
    axes.axvline(single[0], color=GREY, linestyle="--", linewidth=0.8, zorder=0)
    axes.axhline(len(sources) - 1.5, color=GREY, linewidth=0.5)
    axes.set_xlim(left=0.0)
    axes.tick_params(axis="y", length=0)
    axes.spines[["top", "right"]].set_visible(False)


def _rms(errors: np.ndarray) -> np.ndarray:
    """Root mean square of each column."""
    return np.sqrt((errors**2).mean(axis=0))
