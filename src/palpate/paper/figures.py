"""Pictures of the paper's experiments: figures 2 and 3, and tables 1 and 2 as curves."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import matplotlib as mpl
import numpy as np
from jaxtyping import UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from palpate.errors import InputError
from palpate.figures import BLUE, GREY, INK, ORANGE, STYLE, flow_figure, make_flow_view
from palpate.paper.motion import Method, PaperSession
from palpate.paper.published import FlowRow, VertexRow
from palpate.paper.tables import PAPER, Row
from palpate.vision import surface_map

Picture = UInt8[np.ndarray, "_ _ 4"]

_COLOURS = {PAPER: GREY, "lang-pai": ORANGE, "joint": BLUE}
_MARKS = {PAPER: "s", "lang-pai": "^", "joint": "o"}
_Line = Literal["-", "--", ":"]
_LINES: tuple[_Line, ...] = ("-", "--", ":")
# A bias that happens to be nought would squeeze all others on a logarithmic scale [mm].
_LEAST_BIAS = 5e-4
# What is told of a row, as drawn.
_Value = Callable[[Row], float]


def flow_picture(measured: PaperSession, method: Method, name: str, title: str) -> Picture:
    """Optical flow, range flow and displacement of the vertices at one instant, side by side.

    Parameters
    ----------
    measured : PaperSession
    method : Method                 one that was measured
    name : str                      of the motion: a step or an instant of a probing
    title : str

    Raises
    ------
    InputError                      no such motion, or one that could not be measured
    """
    found, mesh = measured.found[method], measured.session.mesh
    motions = {motion.name: motion for motion in found.motions}
    if name not in motions:
        raise InputError(f"there is no motion '{name}' to draw; there are {', '.join(motions)}")
    motion = motions[name]
    if motion.flow is None:
        raise InputError(f"motion '{name}' cannot be drawn: {motion.failure}")
    camera = found.rig.cameras[found.rig.reference]
    rows, columns = motion.first.shape
    surface = surface_map(camera, (rows, columns), mesh.vertices, mesh.triangles)
    view = make_flow_view(motion.first, camera, surface, mesh)
    with mpl.rc_context(STYLE):
        return drawn(flow_figure(title, motion.flow, motion.vertices, view))


def stacked(pictures: Sequence[Picture]) -> Picture:
    """Pictures of one width below each other.

    Parameters
    ----------
    pictures : sequence of Picture
    """
    return np.concatenate(pictures, axis=0)


def flow_curves(tests: Mapping[str, Mapping[str, Sequence[FlowRow]]]) -> Picture:
    """Table 1 over the way: bias of the length, spread of the length, spread of the angle.

    Parameters
    ----------
    tests : mapping of motion to mapping of source to rows
    """
    panels: list[tuple[str, _Value[FlowRow], float]] = [
        ("bias of the length, without sign (mm)", _length_bias, _LEAST_BIAS),
        ("sigma of the length (mm)", lambda row: 1e3 * row.length.std, 0.0),
        ("sigma of the angle (deg)", lambda row: float(np.degrees(row.angle.std)), 0.0),
    ]
    with mpl.rc_context(STYLE):
        figure, all_axes = _three_panels()
        for axes, (label, value, least) in zip(all_axes, panels, strict=True):
            for style, sources in zip(_LINES, tests.values(), strict=False):
                for source, rows in sources.items():
                    _curve(axes, source, rows, value, style)
            _finish(axes, label)
            axes.set_ylim(bottom=max(least, axes.get_ylim()[0]))
        _legend(figure, tests, dict(zip(tests, _LINES, strict=False)))
        return drawn(figure)


def vertex_curves(tests: Mapping[str, Mapping[str, Sequence[VertexRow]]]) -> Picture:
    """Table 2: error of the direction of the vertices' motion, a panel for each of three motions.

    Parameters
    ----------
    tests : mapping of motion to mapping of source to rows
    """
    with mpl.rc_context(STYLE):
        figure, all_axes = _three_panels()
        for axes, (motion, sources) in zip(all_axes, tests.items(), strict=True):
            for source, rows in sources.items():
                _curve(axes, source, rows, _angle_error, "-")
            _finish(axes, f"{motion}: mean angle error (deg)")
        limits = np.array([axes.get_ylim() for axes in all_axes])
        for axes in all_axes:
            axes.set_ylim(limits[:, 0].min(), limits[:, 1].max())
        _legend(figure, tests, {})
        return drawn(figure)


def write_picture(path: Path, picture: Picture) -> None:
    """Write a picture as PNG.

    Raises
    ------
    OSError                         the file cannot be written
    """
    # The usual level of compression, 6, takes as long as drawing.
    imsave(path, picture, dpi=STYLE["savefig.dpi"], pil_kwargs={"compress_level": 2})


def _length_bias(row: FlowRow) -> float:
    """Mean length against the true one: the encoder's where the stage did not obey [mm]."""
    true = row.encoder if row.points is None else row.command
    return 1e3 * abs(row.length.mean - true)


def _angle_error(row: VertexRow) -> float:
    return float(np.degrees(row.angle_error.mean))


def _three_panels() -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(8.4, 2.9))
    grid = figure.add_gridspec(1, 3, left=0.07, right=0.99, top=0.85, bottom=0.14, wspace=0.28)
    return figure, [figure.add_subplot(grid[0, column]) for column in range(3)]


def _curve(
    axes: Axes, source: str, rows: Sequence[Row], value: "_Value[Row]", style: _Line
) -> None:
    """One source's value over the steps, on a logarithmic scale."""
    axes.semilogy(
        [row.step for row in rows], [value(row) for row in rows], style, color=_COLOURS[source],
        marker=_MARKS[source], markersize=3.5, linewidth=1.0,
    )  # fmt: skip


def _finish(axes: Axes, label: str) -> None:
    axes.set_title(label)
    axes.set_xlabel("step")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.grid(axis="y", linewidth=0.3, color=GREY, alpha=0.5)
    axes.spines[["top", "right"]].set_visible(False)


def _legend(
    figure: Figure, tests: Mapping[str, Mapping[str, object]], styles: Mapping[str, _Line]
) -> None:
    """One legend for all panels, above them: colours are sources, lines are motions."""
    sources = dict.fromkeys(source for each in tests.values() for source in each)
    handles = [
        Line2D([], [], color=_COLOURS[source], marker=_MARKS[source], markersize=3.5, label=source)
        for source in sources
    ]
    handles += [
        Line2D([], [], color=INK, linestyle=style, linewidth=1.0, label=motion)
        for motion, style in styles.items()
    ]
    figure.legend(handles=handles, loc="upper center", ncols=len(handles), columnspacing=1.8)


def drawn(figure: Figure) -> Picture:
    """Pixels of a figure at the density of saved ones."""
    figure.set_dpi(STYLE["savefig.dpi"])
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba()).copy()
