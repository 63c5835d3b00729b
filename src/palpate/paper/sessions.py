"""What the paper printed, and the facility's sessions that repeat it, measured by each method.

The paper's own numbers, tables 1, 2 and 3, are in SI units; lengths are printed in cm there, angles
in degrees. Results of this project for the same tables use the same types, so that both can be
compared. The ground truth of the sessions is known.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), sections 4
and 5.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.files import stored_arrays
from palpate.lab import LabConfig, Material, Variant, make_session
from palpate.pipeline import FLOW_METHODS, MeasuredMotion, SessionFlow, measure_motion
from palpate.progress import Progress, part_of, silent
from palpate.records import Session, TomlTable, read_session, read_toml
from palpate.shapes import Points
from palpate.threads import Distribute
from palpate.vision import RangeFlow

Method = Literal["lang-pai", "joint"]
METHODS: tuple[Method, ...] = ("lang-pai", "joint")
# Fraction of the time for making a session; the rest is for measuring its motion.
_MAKING = 0.5
# Quick runs: largest number of steps or probings, and divisor of the picture size.
_QUICK_STEPS, _QUICK_SHRINK = 3, 2


@dataclass(frozen=True, slots=True, eq=False)
class PaperSession:
    """A session of the facility and its motion by several methods.

    Attributes
    ----------
    session : Session               with `truth.toml` in its folder
    flows : mapping                 method -> SessionFlow
    """

    session: Session
    flows: Mapping[Method, SessionFlow]

    def motion(self, method: Method, name: str) -> MeasuredMotion:
        """The motion of a step or probing, by one method.

        Parameters
        ----------
        method : str                one of `METHODS` that was measured
        name : str                  of the step or probing

        Returns
        -------
        MeasuredMotion
        """
        return next(motion for motion in self.flows[method].motions if motion.name == name)


def reduced(config: LabConfig) -> LabConfig:
    """Reduced configuration for a quick run: half the picture size, up to three steps or probings.

    The texture is enlarged with the pixels, so that it can be matched equally well.

    Parameters
    ----------
    config : LabConfig

    Returns
    -------
    LabConfig
    """
    head, look, stage = config.head, config.look, config.stage
    small = replace(
        head,
        columns=head.columns // _QUICK_SHRINK,
        rows=head.rows // _QUICK_SHRINK,
        focal=None if head.focal is None else head.focal / _QUICK_SHRINK,
    )
    if stage is not None:
        stage = replace(stage, steps=min(stage.steps, _QUICK_STEPS))
    coarse = replace(look, size=_QUICK_SHRINK * look.size)
    probes = config.probes[:_QUICK_STEPS]
    return replace(config, head=small, look=coarse, stage=stage, probes=probes)


def measured_session(
    config: LabConfig,
    folder: Path,
    *,
    methods: Sequence[Method] = METHODS,
    variant: Variant,
    progress: Progress = silent,
    parts: Path | None = None,
    distribute: Distribute = map,
) -> PaperSession:
    """Make a session in the facility and measure its motion.

    The object's pose in the session is used without refinement.

    Parameters
    ----------
    config : LabConfig
    folder : Path                   an empty folder, in which the session is kept
    methods : sequence of Method
    variant : Variant               of Mitsuba
    progress : callable             called with the current step (text) and the fraction done, 0..1
    parts, distribute               as in `make_session`

    Returns
    -------
    PaperSession

    Raises
    ------
    PalpateError                    as in `make_session` and `measure_motion`
    """
    making = part_of(progress, 0.0, _MAKING)
    make_session(
        config, folder, variant=variant, progress=making, parts=parts, distribute=distribute
    )
    session, motions = read_session(folder), {}
    for k, method in enumerate(methods):
        begin, end = (_MAKING + (1.0 - _MAKING) * i / len(methods) for i in (k, k + 1))
        motions[method] = measure_motion(
            session,
            method=FLOW_METHODS[method](),
            pose="given",
            progress=part_of(progress, begin, end, prefix=f"{method}: "),
            parts=parts,
        )
    return PaperSession(session, motions)


def rigid_steps(session: Session) -> list[tuple[Float[np.ndarray, "4 4"], float]]:
    """True motions of a session's steps after the first, from its `truth.toml`.

    Parameters
    ----------
    session : Session               made by the facility, with steps

    Returns
    -------
    list of ((4, 4) float, float)   x(step) = R x(first) + t, object frame, t in metres; travel of
                                    the stage from its encoder [m]

    Raises
    ------
    RecordError                     no readable `truth.toml`, a step without its motion
    InputError                      a number of steps that differs from the session's
    """
    root = read_toml(session.path.parent / "truth.toml")
    tables = root.tables("step", "[[step]]")
    if len(tables) != len(session.steps):
        raise InputError(
            f"{root.file}: has {len(tables)} steps, the session {len(session.steps)}; they must"
            " come from the same run of the facility: make the session anew"
        )
    start = tables[0].vector("encoder")
    return [
        (_motion(table), float(np.linalg.norm(table.vector("encoder") - start)))
        for table in tables[1:]
    ]


def true_material(session: Session) -> Material:
    """True constants of the specimen in a session of the facility.

    Parameters
    ----------
    session : Session               with `truth.toml` in its folder

    Returns
    -------
    Material                        the law is not read: always "linear"

    Raises
    ------
    RecordError                     `truth.toml` cannot be read
    """
    truth = read_toml(session.path.parent / "truth.toml")
    return Material(truth.number("young_modulus"), truth.number("poisson_ratio"))


def true_displacement(session: Session, name: str, flow: RangeFlow) -> Points:
    """True displacement of the points of a range flow.

    Parameters
    ----------
    session : Session               made by the facility, with `truth.toml` or truth maps in its
                                    folder
    name : str                      of a step after the first, or of a probing
    flow : RangeFlow                of that instant

    Returns
    -------
    (n, 3) float [m]                in a probing that of the pixel nearest to each point; NaN where
                                    the reference camera does not see the object there

    Raises
    ------
    RecordError                     the truth cannot be read
    """
    if not session.steps:
        return _by_map(session, name, flow)
    names = [step.name for step in session.steps[1:]]
    motion, _ = rigid_steps(session)[names.index(name)]
    return rigid_displacement(motion, flow.point)


def rigid_displacement(motion: Float[np.ndarray, "4 4"], points: Points) -> Points:
    """Displacement of points under a rigid motion.

    Parameters
    ----------
    motion : (4, 4) float           homogeneous matrix, translation in metres
    points : (n, 3) float [m]       positions before the motion

    Returns
    -------
    (n, 3) float [m]
    """
    return points @ (motion[:3, :3] - np.eye(3)).T + motion[:3, 3]


def _by_map(session: Session, name: str, flow: RangeFlow) -> Points:
    """True displacement from the truth map of a probing."""
    file = session.path.parent / f"truth_{name}.npz"
    cure = "make the session anew with `palpate lab`"
    with stored_arrays(file, cure, what="cannot be read as a truth map") as content:
        pixel, displacement = content["pixel"], content["U"].astype(float)
        rows, columns = content["shape"].tolist()
    column, row = np.rint(flow.pixel).astype(int).T
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    target = np.where(inside, row * columns + column, -1)
    position = np.minimum(np.searchsorted(pixel, target), len(pixel) - 1)
    return np.where((pixel[position] == target)[:, None], displacement[position], np.nan)


def _motion(table: TomlTable) -> Float[np.ndarray, "4 4"]:
    """Rotation and translation of a step."""
    rows = table.get("R")
    if not (isinstance(rows, list) and len(rows) == 3):
        table.fail("R", f"is {rows!r}; must be three rows of three numbers")
    motion = np.eye(4)
    motion[:3, :3] = [TomlTable(table.file, table.name, {"R": row}).vector("R") for row in rows]
    motion[:3, 3] = table.vector("t")
    return motion


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and standard deviation of a quantity over points.

    Attributes
    ----------
    mean, std : float               in the quantity's unit; NaN if there are no points
    """

    mean: float
    std: float


@dataclass(frozen=True, slots=True)
class MotionRow:
    """A row of table 1 or 2: measurements after some steps of a rigid motion.

    Attributes
    ----------
    step : int                      from 1
    angle : Spread [rad]            table 1: between the range flow and the optical axis of the
                                    reference camera; table 2: between the measured and the true
                                    displacement of a vertex
    length : Spread or None [m]     of the flow or displacement; None: not printed
    command : float or None [m]     table 1: commanded travel of the stage; table 2: mean length of
                                    the true displacement of the same vertices
    encoder : float or None [m]     table 1: travel from the first instant, from the stage's encoder
    count : int or None             tracked points or measured vertices; None: not printed
    """

    step: int
    angle: Spread
    length: Spread | None = None
    command: float | None = None
    encoder: float | None = None
    count: int | None = None


def _rows(*rows: tuple[float, ...]) -> tuple[MotionRow, ...]:
    """Rows from the printed numbers: angle and sigma [deg], then, if printed, length, sigma,
    encoder (table 1 only) and command [cm]."""
    made = []
    for step, row in enumerate(rows, start=1):
        angle, metres = np.deg2rad(row[:2]).tolist(), [1e-2 * length for length in row[2:]]
        made.append(
            MotionRow(
                step,
                Spread(*angle),
                Spread(*metres[:2]) if metres else None,
                command=metres[-1] if metres else None,
                encoder=metres[2] if len(metres) == 4 else None,
            )
        )
    return tuple(made)


# Table 1 (a): motion to the left-rear of the reference picture.
PAPER_FLOW_LEFT_REAR = _rows(
    (67.0081, 10.2836, 0.2678, 0.0340, 0.2355, 0.2500),
    (64.7748, 5.7253, 0.5396, 0.0402, 0.4864, 0.5000),
    (64.8529, 4.1890, 0.8113, 0.0464, 0.7374, 0.7500),
    (64.8575, 3.5898, 1.0849, 0.0571, 0.9911, 1.0000),
    (64.9783, 2.8942, 1.3567, 0.0626, 1.2378, 1.2500),
    (65.0915, 2.6112, 1.6290, 0.0697, 1.4867, 1.5000),
    (65.1626, 2.3755, 1.9019, 0.0770, 1.7366, 1.7500),
    (65.2725, 1.9633, 2.1747, 0.0827, 1.9929, 2.0000),
)
# Table 1 (b): motion to the rear-right.
PAPER_FLOW_REAR_RIGHT = _rows(
    (48.8813, 7.4717, 0.2367, 0.0334, 0.2230, 0.2500),
    (46.2486, 4.5264, 0.4926, 0.0461, 0.4750, 0.5000),
    (46.0249, 3.3112, 0.7404, 0.0518, 0.7146, 0.7500),
    (45.4467, 2.6273, 0.9997, 0.0507, 0.9729, 1.0000),
    (45.6313, 2.6246, 1.2471, 0.0606, 1.2161, 1.2500),
    (45.4051, 2.5060, 1.5086, 0.0780, 1.4705, 1.5000),
    (45.4808, 2.4960, 1.7614, 0.0889, 1.7192, 1.7500),
    (45.2843, 2.3798, 2.0266, 0.0937, 1.9736, 2.0000),
)
# Table 2, translation in X.
PAPER_ANGLE_ERROR_X = _rows(
    (10.9142, 23.2285), (8.6968, 20.3784), (7.9037, 18.9947), (8.0567, 21.4754),
    (8.3435, 23.5471), (8.0368, 24.2161), (8.1894, 26.5517), (7.9706, 28.0945),
)  # fmt: skip
# Table 2, translation in Y.
PAPER_ANGLE_ERROR_Y = _rows(
    (7.4402, 15.0430), (5.8115, 11.7741), (5.2960, 10.6937), (5.0309, 10.2249),
    (4.8527, 9.9227), (4.8800, 9.994), (4.9821, 10.1555), (4.9916, 10.1864),
)  # fmt: skip
# Table 2, rotation around Z by 2 degrees a step.
PAPER_ANGLE_ERROR_ROTATION = _rows(
    (23.5574, 47.8135, 0.2998, 0.0518, 0.3053),
    (24.8044, 58.0988, 0.5928, 0.0884, 0.6089),
    (19.1940, 42.1753, 0.8739, 0.1468, 0.9052),
    (17.5430, 41.4193, 1.1370, 0.2130, 1.2070),
    (13.7172, 37.8691, 1.4744, 0.2350, 1.5336),
    (12.2357, 36.0586, 1.7621, 0.3434, 1.8643),
    (10.0026, 32.9437, 1.9929, 0.4729, 2.1297),
    (8.2385, 31.2005, 2.1469, 0.6727, 2.3233),
)
# Table 3: the probed node -> constants from its probing alone: nu, then G and E in a unit that is
# not printed; N/cm^2 would fit its other units.
PAPER_PROBES = {
    1: (0.1183, 0.7809, 1.746),
    2: (0.1878, 0.6308, 1.499),
    3: (0.2227, 0.6039, 1.477),
    4: (0.2516, 0.6555, 1.641),
    5: (0.1857, 0.6977, 1.655),
    6: (0.2009, 0.6696, 1.608),
    8: (0.2089, 0.6550, 1.584),
    9: (0.2007, 0.6646, 1.596),
    11: (0.1868, 0.7175, 1.703),
    12: (0.2082, 0.7585, 1.833),
    14: (0.1997, 0.7993, 1.918),
    15: (0.2084, 0.7451, 1.801),
    17: (0.1192, 0.7666, 1.716),
    18: (0.1366, 0.7562, 1.719),
    20: (0.1400, 0.7480, 1.705),
    22: (0.1264, 0.7121, 1.604),
    26: (0.1442, 0.9383, 2.147),
}
# Table 3: all probings in one estimate, and the compression test of a cylinder ("about").
PAPER_ALL_PROBES = (0.1730, 0.7283, 1.709)
PAPER_COMPRESSION_MODULUS = 1.75
