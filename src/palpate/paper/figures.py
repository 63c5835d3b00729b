"""Figures of the paper's experiments: figures 2 and 3, and tables 1 and 2 as curves."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from palpate.errors import InputError
from palpate.figures import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    Picture,
    figure_pixels,
    flow_figure,
    make_flow_view,
    open_frame,
    styled,
)
from palpate.paper.motion import PAPER, Tests, length_bias
from palpate.paper.published import MotionRow
from palpate.paper.sessions import Method, PaperSession
from palpate.vision import surface_map

_COLOURS = {PAPER: GREY, "lang-pai": ORANGE, "joint": BLUE}
_MARKS = {PAPER: "s", "lang-pai": "^", "joint": "o"}
_Line = Literal["-", "--", ":"]
_LINES: tuple[_Line, ...] = ("-", "--", ":")
# Least bias shown [mm]: one that happens to be near zero would stretch the logarithmic scale.
_MIN_BIAS = 5e-4


def flow_picture(measured: PaperSession, method: Method, name: str, title: str) -> Picture:
    """Optical flow, range flow and displacement of the vertices at one instant, side by side.

    Parameters
    ----------
    measured : PaperSession
    method : Method                 a method whose motion was measured
    name : str                      of the motion: a step or an instant of a probing
    title : str

    Returns
    -------
    Picture                         as drawn by `flow_figure`

    Raises
    ------
    InputError                      no such motion, or one that could not be measured
    """
    found, mesh = measured.found[method], measured.session.mesh
    motion = measured.motion(method, name)
    if motion.flow is None:
        raise InputError(f"motion '{name}' cannot be drawn: {motion.failure}")
    camera = found.rig.cameras[found.rig.reference]
    rows, columns = motion.first.shape
    surface = surface_map(camera, (rows, columns), mesh.vertices, mesh.triangles)
    view = make_flow_view(motion.first, camera, surface, mesh)
    return figure_pixels(flow_figure(title, motion.flow, motion.vertices, view))


@styled
def flow_curves(tests: Tests) -> Picture:
    """Table 1 over the steps: bias and standard deviation of the length, and that of the angle.

    Parameters
    ----------
    tests : mapping                 motion -> source -> rows

    Returns
    -------
    Picture                         three panels, 8.4 by 3.1 inches
    """
    lines = dict(zip(tests, _LINES, strict=False))
    values: dict[str, Callable[[MotionRow], float]] = {
        "bias of the length, without sign (mm)": _shown_bias,
        "sigma of the length (mm)": lambda row: 1e3 * row.length.std if row.length else np.nan,
        "sigma of the angle (deg)": lambda row: float(np.degrees(row.angle.std)),
    }
    figure, panels = _three_plots(list(values))
    for axes, value in zip(panels, values.values(), strict=True):
        for motion, line in lines.items():
            for source, rows in tests[motion].items():
                _curve(axes, source, rows, value, line)
    panels[0].set_ylim(bottom=max(_MIN_BIAS, panels[0].get_ylim()[0]))
    _add_legend(figure, tests, lines)
    return figure_pixels(figure)


def _shown_bias(row: MotionRow) -> float:
    """Absolute bias of the length [mm], at least `_MIN_BIAS`."""
    return max(1e3 * abs(length_bias(row)), _MIN_BIAS)


@styled
def vertex_curves(tests: Tests) -> Picture:
    """Table 2 over the steps: mean angle error of the vertices' displacements, for three motions.

    Parameters
    ----------
    tests : mapping                 motion -> source -> rows

    Returns
    -------
    Picture                         three panels, 8.4 by 3.1 inches
    """
    figure, panels = _three_plots([f"{motion}: mean angle error (deg)" for motion in tests])
    for axes, sources in zip(panels, tests.values(), strict=True):
        for source, rows in sources.items():
            _curve(axes, source, rows, lambda row: float(np.degrees(row.angle.mean)), "-")
    limits = np.array([axes.get_ylim() for axes in panels])
    for axes in panels:
        axes.set_ylim(limits[:, 0].min(), limits[:, 1].max())
    _add_legend(figure, tests, {})
    return figure_pixels(figure)


def _three_plots(titles: Sequence[str]) -> tuple[Figure, list[Axes]]:
    """Three empty plots over the steps, with logarithmic ordinates."""
    figure = Figure(figsize=(8.4, 3.1))
    grid = figure.add_gridspec(1, 3, left=0.07, right=0.99, top=0.81, bottom=0.14, wspace=0.28)
    panels = [figure.add_subplot(grid[0, column]) for column in range(3)]
    for axes, title in zip(panels, titles, strict=True):
        axes.set(title=textwrap.fill(title, 24), xlabel="step", yscale="log")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.grid(axis="y", linewidth=0.3, color=GREY, alpha=0.5)
        open_frame(axes)
    return figure, panels


def _curve(
    axes: Axes,
    source: str,
    rows: Sequence[MotionRow],
    value: Callable[[MotionRow], float],
    line: _Line,
) -> None:
    """A source's value over the steps."""
    axes.plot(
        [row.step for row in rows], [value(row) for row in rows], line, color=_COLOURS[source],
        marker=_MARKS[source], markersize=3.5, linewidth=1.0,
    )  # fmt: skip


def _add_legend(figure: Figure, tests: Tests, lines: Mapping[str, _Line]) -> None:
    """A legend for all panels, above them: colours are sources, lines are motions."""
    sources = dict.fromkeys(source for each in tests.values() for source in each)
    handles = [
        Line2D([], [], color=_COLOURS[source], marker=_MARKS[source], markersize=3.5, label=source)
        for source in sources
    ]
    handles += [
        Line2D([], [], color=INK, linestyle=line, linewidth=1.0, label=motion)
        for motion, line in lines.items()
    ]
    figure.legend(handles=handles, loc="upper center", ncols=len(handles), columnspacing=1.8)
