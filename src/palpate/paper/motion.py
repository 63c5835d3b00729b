"""Tables 1 and 2 of the paper, and its figures 2 and 3: rigid motion, compared with both methods.

Every instant of a measured session becomes a row of the same type as the paper's rows; the tables
are also drawn as curves.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), section 4.
"""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float
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
from palpate.paper.result import ResultTable
from palpate.paper.sessions import (
    Method,
    MotionRow,
    PaperSession,
    Spread,
    rigid_displacement,
    rigid_steps,
)
from palpate.pipeline import MeasuredMotion
from palpate.shapes import Points, PointScalars, Vector3, Vertices
from palpate.vision import RangeFlow, VertexDisplacement, is_valid, surface_map

# Name of the paper's own numbers, used like the name of a method.
PAPER = "paper"
_MM = 1e3
# Rows of one motion by source; the same for several motions, by motion.
Rows = Mapping[str, Sequence[MotionRow]]
Tests = Mapping[str, Rows]
_COLOURS = {PAPER: GREY, "lang-pai": ORANGE, "joint": BLUE}
_MARKS = {PAPER: "s", "lang-pai": "^", "joint": "o"}
_Line = Literal["-", "--", ":"]
_LINES: tuple[_Line, ...] = ("-", "--", ":")
# Least bias shown [mm]: one that happens to be near zero would stretch the logarithmic scale.
_MIN_BIAS = 5e-4


def flow_rows(measured: PaperSession, method: Method) -> tuple[MotionRow, ...]:
    """Table 1 of one method: a row for each step after the first.

    Parameters
    ----------
    measured : PaperSession         of a translation
    method : Method                 a method whose motion was measured

    Returns
    -------
    tuple of MotionRow              `command` is the true path, as the virtual stage has no error;
                                    steps that could not be measured have no points

    Raises
    ------
    RecordError, InputError         as in `rigid_steps`
    """
    rig = measured.flows[method].rig
    axis = rig.cameras[rig.reference].T_camera_object[2, :3]
    return tuple(
        flow_row(
            motion.flow, axis, step=step, encoder=encoder,
            command=float(np.linalg.norm(true[:3, 3])),
        )
        for step, (motion, (true, encoder)) in enumerate(_instants(measured, method), start=1)
    )  # fmt: skip


def flow_row(
    flow: RangeFlow | None, axis: Vector3, *, step: int, encoder: float, command: float
) -> MotionRow:
    """A row of table 1 from the range flow of one instant.

    Parameters
    ----------
    flow : RangeFlow or None        None: not measured
    axis : (3,) float [-]           optical axis of the reference camera, unit, object frame
    step : int                      from 1
    encoder, command : float [m]    see `MotionRow`

    Returns
    -------
    MotionRow
    """
    displacement = np.zeros((0, 3)) if flow is None else flow.displacement[is_valid(flow)]
    length = np.linalg.norm(displacement, axis=1)
    angle = _angle(displacement, np.broadcast_to(axis, displacement.shape))
    return MotionRow(step, _spread(angle), _spread(length), command, encoder, len(displacement))


def vertex_rows(measured: PaperSession, method: Method) -> tuple[MotionRow, ...]:
    """Table 2 of one method: a row for each step after the first.

    Parameters
    ----------
    measured : PaperSession         of a rigid motion
    method : Method                 a method whose motion was measured

    Returns
    -------
    tuple of MotionRow

    Raises
    ------
    RecordError, InputError         as in `rigid_steps`
    """
    vertices = measured.session.mesh.vertices
    return tuple(
        vertex_row(motion.vertices, vertices, true, step=step)
        for step, (motion, (true, _)) in enumerate(_instants(measured, method), start=1)
    )


def vertex_row(
    measured: VertexDisplacement | None,
    vertices: Vertices,
    motion: Float[np.ndarray, "4 4"],
    *,
    step: int,
) -> MotionRow:
    """A row of table 2 from the displacement of the vertices at one instant.

    Parameters
    ----------
    measured : VertexDisplacement or None   None: not measured
    vertices : (v, 3) float [m]     positions at the first instant
    motion : (4, 4) float           true motion from the first instant, translation in metres
    step : int                      from 1

    Returns
    -------
    MotionRow                       a vertex on the axis of a rotation has no direction and counts
                                    only for the lengths
    """
    displacement = np.full(vertices.shape, np.nan) if measured is None else measured.displacement
    known = np.isfinite(displacement).all(axis=1)
    true = rigid_displacement(motion, vertices[known])
    return MotionRow(
        step,
        _spread(_angle(displacement[known], true)),
        _spread(np.linalg.norm(displacement[known], axis=1)),
        command=_spread(np.linalg.norm(true, axis=1)).mean,
        count=int(known.sum()),
    )


def motion_table(title: str, rows: Rows, *, of_flow: bool) -> ResultTable:
    """Table 1 or 2 for one motion: every step, with a row for each source.

    Parameters
    ----------
    title : str
    rows : mapping                  source -> its rows, for the paper and the methods
    of_flow : bool                  True: table 1, of the range flow; False: table 2, of vertices

    Returns
    -------
    ResultTable                     angles in degrees, lengths in mm
    """
    angle, counted = ("angle", "points") if of_flow else ("angle error", "vertices")
    encoder = ("encoder (mm)",) if of_flow else ()
    columns = (
        "step", "source", f"{angle} (deg)", "sigma (deg)", "length (mm)", "sigma (mm)",
        *encoder, "command (mm)", counted,
    )  # fmt: skip
    cells = [
        (row.step, source, *_degrees(row.angle), *_millimetres(row.length),
         *(_millimetre(row.encoder) for _ in encoder), _millimetre(row.command), row.count)
        for source, row in _by_step(rows)
    ]  # fmt: skip
    digits = (0, 0, 2, 2, 4, 4, *(4 for _ in encoder), 4, 0)
    return ResultTable(title, columns, digits, tuple(cells))


def flow_summary(title: str, tests: Tests) -> ResultTable:
    """Summary of table 1: largest bias and standard deviation of the length over the steps, and the
    standard deviation of the angle at the first step.

    Parameters
    ----------
    title : str
    tests : mapping                 motion -> source -> rows

    Returns
    -------
    ResultTable                     angles in degrees, lengths in mm
    """
    columns = (
        "motion", "source", "length bias, worst step (mm)", "length sigma, worst step (mm)",
        "angle sigma, first step (deg)", "steps",
    )  # fmt: skip
    cells = [
        (motion, source, _MM * _worst([_length_bias(row) for row in rows]),
         _worst([_millimetres(row.length)[1] for row in rows]), _degrees(rows[0].angle)[1],
         len(rows))
        for motion, source, rows in _listed(tests)
    ]  # fmt: skip
    return ResultTable(title, columns, (0, 0, 4, 4, 2, 0), tuple(cells))


def vertex_summary(title: str, tests: Tests) -> ResultTable:
    """Summary of table 2: angle errors at the first and at the last step.

    Parameters
    ----------
    title, tests                    as in `flow_summary`

    Returns
    -------
    ResultTable                     angles in degrees
    """
    columns = (
        "motion", "source", "angle error, first step (deg)", "sigma (deg)",
        "angle error, last step (deg)", "sigma (deg)", "steps",
    )  # fmt: skip
    cells = [
        (motion, source, *_degrees(rows[0].angle), *_degrees(rows[-1].angle), len(rows))
        for motion, source, rows in _listed(tests)
    ]
    return ResultTable(title, columns, (0, 0, 2, 2, 2, 2, 0), tuple(cells))


def _length_bias(row: MotionRow) -> float:
    """Mean length in table 1 minus the true length.

    The paper's stage did not reach the commanded positions exactly, so its encoder counts as the
    truth; for the virtual stage the command does.

    Parameters
    ----------
    row : MotionRow                 the paper's rows are recognised by having no count

    Returns
    -------
    float [m]                       NaN if unknown
    """
    true = row.encoder if row.count is None else row.command
    if row.length is None or true is None:
        return float("nan")
    return row.length.mean - true


def _instants(
    measured: PaperSession, method: Method
) -> list[tuple[MeasuredMotion, tuple[Float[np.ndarray, "4 4"], float]]]:
    """Measured motion, and true motion and travel, of each step after the first."""
    return list(zip(measured.flows[method].motions, rigid_steps(measured.session), strict=True))


def _listed(tests: Tests) -> list[tuple[str, str, Sequence[MotionRow]]]:
    """Motion, source and rows of each source."""
    return [(motion, *entry) for motion, rows in tests.items() for entry in rows.items()]


def _by_step(rows: Rows) -> list[tuple[str, MotionRow]]:
    """Pairs of source and row, sorted by step."""
    pairs = [(source, row) for source, steps in rows.items() for row in steps]
    return sorted(pairs, key=lambda pair: pair[1].step)


def _degrees(spread: Spread) -> tuple[float, float]:
    return float(np.degrees(spread.mean)), float(np.degrees(spread.std))


def _millimetres(spread: Spread | None) -> tuple[float | None, float | None]:
    return (None, None) if spread is None else (_MM * spread.mean, _MM * spread.std)


def _millimetre(length: float | None) -> float | None:
    return None if length is None else _MM * length


def _worst(values: Sequence[float | None]) -> float:
    """The value of largest magnitude, with its sign; NaN if any is unknown."""
    known = np.array(values, dtype=float)
    return float(known[np.argmax(np.abs(known))])


def _angle(vectors: Points, others: Points) -> PointScalars:
    """Angle between corresponding rows [rad]; NaN where one of them is zero."""
    # Not from the cosine, which cannot resolve angles below 1e-8.
    across = np.linalg.norm(np.cross(vectors, others), axis=1)
    along = np.einsum("na,na->n", vectors, others)
    lost = (across == 0.0) & (along == 0.0)
    return np.where(lost, np.nan, np.arctan2(across, along))


def _spread(values: PointScalars) -> Spread:
    """Mean and standard deviation of the finite values; NaN if there are none."""
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return Spread(np.nan, np.nan)
    return Spread(float(known.mean()), float(known.std()))


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
    fields, mesh = measured.flows[method], measured.session.mesh
    motion = measured.motion(method, name)
    if motion.flow is None:
        raise InputError(f"motion '{name}' cannot be drawn: {motion.failure}")
    camera = fields.rig.cameras[fields.rig.reference]
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
    return max(1e3 * abs(_length_bias(row)), _MIN_BIAS)


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
    sources = dict.fromkeys(source for by_source in tests.values() for source in by_source)
    handles = [
        Line2D([], [], color=_COLOURS[source], marker=_MARKS[source], markersize=3.5, label=source)
        for source in sources
    ]
    handles += [
        Line2D([], [], color=INK, linestyle=line, linewidth=1.0, label=motion)
        for motion, line in lines.items()
    ]
    figure.legend(handles=handles, loc="upper center", ncols=len(handles), columnspacing=1.8)
