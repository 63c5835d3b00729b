"""Tables 1 and 2 of the paper: rigid motion, the paper's own numbers compared with both methods.

Every instant of a measured session becomes a row of the same type as the paper's rows.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), section 4.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from palpate.paper.published import MotionRow, Spread
from palpate.paper.result import ResultTable
from palpate.paper.sessions import Method, PaperSession, RigidStep, rigid_displacement, rigid_steps
from palpate.pipeline import MeasuredMotion
from palpate.shapes import Points, PointScalars, Vector3, Vertices
from palpate.vision import RangeFlow, VertexDisplacement, is_valid

# Name of the paper's own numbers, used like the name of a method.
PAPER = "paper"
_MM = 1e3
# Rows of one motion by source; the same for several motions, by motion.
Rows = Mapping[str, Sequence[MotionRow]]
Tests = Mapping[str, Rows]


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
    rig = measured.found[method].rig
    axis = rig.cameras[rig.reference].T_camera_object[2, :3]
    return tuple(
        flow_row(
            motion.flow, axis, step=step, encoder=true.encoder,
            command=float(np.linalg.norm(true.motion[:3, 3])),
        )
        for step, (motion, true) in enumerate(_instants(measured, method), start=1)
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
        vertex_row(motion.vertices, vertices, true.motion, step=step)
        for step, (motion, true) in enumerate(_instants(measured, method), start=1)
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


def flow_table(title: str, rows: Rows) -> ResultTable:
    """Table 1 for one direction: every step, with a row for each source.

    Parameters
    ----------
    title : str
    rows : mapping                  source -> its rows, for the paper and the methods

    Returns
    -------
    ResultTable                     angles in degrees, lengths in mm
    """
    columns = (
        "step", "source", "angle (deg)", "sigma (deg)", "length (mm)", "sigma (mm)",
        "encoder (mm)", "command (mm)", "points",
    )  # fmt: skip
    cells = [
        (row.step, source, *_degrees(row.angle), *_millimetres(row.length),
         _millimetre(row.encoder), _millimetre(row.command), row.count)
        for source, row in _by_step(rows)
    ]  # fmt: skip
    return ResultTable(title, columns, (0, 0, 2, 2, 4, 4, 4, 4, 0), tuple(cells))


def vertex_table(title: str, rows: Rows) -> ResultTable:
    """Table 2 for one motion: every step, with a row for each source.

    Parameters
    ----------
    title, rows                     as in `flow_table`

    Returns
    -------
    ResultTable                     angles in degrees, lengths in mm
    """
    columns = (
        "step", "source", "angle error (deg)", "sigma (deg)", "length (mm)", "sigma (mm)",
        "command (mm)", "vertices",
    )  # fmt: skip
    cells = [
        (row.step, source, *_degrees(row.angle), *_millimetres(row.length),
         _millimetre(row.command), row.count)
        for source, row in _by_step(rows)
    ]  # fmt: skip
    return ResultTable(title, columns, (0, 0, 2, 2, 4, 4, 4, 0), tuple(cells))


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
        (motion, source, _MM * _worst([length_bias(row) for row in rows]),
         _worst([_millimetres(row.length)[1] for row in rows]), _degrees(rows[0].angle)[1],
         len(rows))
        for motion, source, rows in _each(tests)
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
        for motion, source, rows in _each(tests)
    ]
    return ResultTable(title, columns, (0, 0, 2, 2, 2, 2, 0), tuple(cells))


def length_bias(row: MotionRow) -> float:
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


def _instants(measured: PaperSession, method: Method) -> list[tuple[MeasuredMotion, RigidStep]]:
    """Measured and true motion of each step after the first."""
    return list(zip(measured.found[method].motions, rigid_steps(measured.session), strict=True))


def _each(tests: Tests) -> list[tuple[str, str, Sequence[MotionRow]]]:
    """Motion, source and rows of each source."""
    return [(motion, *each) for motion, rows in tests.items() for each in rows.items()]


def _by_step(rows: Rows) -> list[tuple[str, MotionRow]]:
    """Pairs of source and row, sorted by step."""
    pairs = [(source, row) for source, each in rows.items() for row in each]
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
