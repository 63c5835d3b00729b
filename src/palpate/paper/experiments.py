"""The paper's experiments by name: the sessions that each one needs, and its evaluation."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.arrays import known_median
from palpate.figures import Picture, figure_pixels, probings_figure
from palpate.lab import LabConfig, Variant, built_in, read_lab_config
from palpate.paper.budget import budget_picture, budget_table, error_budget, sizes_table
from palpate.paper.constants import (
    compressed_modulus,
    constants_summary,
    constants_table,
    estimated_constants,
    motion_picture,
)
from palpate.paper.motion import (
    PAPER,
    flow_curves,
    flow_picture,
    flow_rows,
    flow_summary,
    motion_table,
    vertex_curves,
    vertex_rows,
    vertex_summary,
)
from palpate.paper.result import Cell, PaperResult, ResultTable
from palpate.paper.sessions import (
    METHODS,
    PAPER_ANGLE_ERROR_ROTATION,
    PAPER_ANGLE_ERROR_X,
    PAPER_ANGLE_ERROR_Y,
    PAPER_FLOW_LEFT_REAR,
    PAPER_FLOW_REAR_RIGHT,
    Method,
    MotionRow,
    PaperSession,
    measured_session,
    reduced,
    true_displacement,
    true_material,
)
from palpate.progress import Progress, part_of
from palpate.records import CONSTANT_NAMES
from palpate.threads import Distribute
from palpate.vision import is_valid

# Built-in configurations of the facility.
_X, _Y, _ROTATION, _PROBING = "translation-x", "translation-y", "rotation-z", "toy-probing"
_BALL = "half-ball"
Measured = Mapping[str, PaperSession]
# Session, name of the motion in it, description.
_Motion = tuple[str, str, str]
# Number of draws of a source of error that changes no picture.
_DRAWS = 5


@dataclass(frozen=True, slots=True)
class ExperimentRun:
    """Where and how experiments make their sessions.

    Attributes
    ----------
    folder : Path                   parent of the session folders
    variant : Variant               of Mitsuba
    quick : bool                    small pictures and few steps
    progress : callable             called with the current step (text) and the fraction done, 0..1
    parts : Path or None            folder, created if missing, in which finished parts are stored
                                    so that an interrupted run can be resumed
    distribute : Distribute         measures the facility's probings and steps
    """

    folder: Path
    variant: Variant
    quick: bool
    progress: Progress
    parts: Path | None = None
    distribute: Distribute = map

    def config(self, name: str) -> LabConfig:
        """A built-in configuration, reduced (by `reduced`) if `quick`.

        Parameters
        ----------
        name : str                  one of `built_in`

        Returns
        -------
        LabConfig
        """
        config = read_lab_config(built_in()[name])
        return reduced(config) if self.quick else config

    def part(self, begin: float, end: float, name: str) -> "ExperimentRun":
        """This workplace with the progress of one part of the work.

        Parameters
        ----------
        begin, end : float          fractions of the whole, 0 to 1, where the part begins and ends
        name : str                  of the part, put before progress texts

        Returns
        -------
        ExperimentRun
        """
        return replace(self, progress=part_of(self.progress, begin, end, prefix=f"{name}: "))


def run_experiments(names: Sequence[str], work: ExperimentRun) -> dict[str, PaperResult]:
    """Make and measure the sessions of some experiments, each session once, and evaluate them.

    Parameters
    ----------
    names : sequence of str         keys of `EXPERIMENTS`
    work : ExperimentRun

    Returns
    -------
    dict of str to PaperResult      by experiment, in the order of the names

    Raises
    ------
    PalpateError                    as in `measured_session`
    """
    needed = list(
        dict.fromkeys(name for experiment in names for name in EXPERIMENTS[experiment][0])
    )
    count = len(needed) + len(names)
    measured, results = {}, {}
    work.folder.mkdir(exist_ok=True)
    for k, name in enumerate(needed):
        part = work.part(k / count, (k + 1) / count, name)
        folder = work.folder / name
        folder.mkdir()
        measured[name] = measured_session(
            work.config(name),
            folder,
            variant=work.variant,
            progress=part.progress,
            parts=work.parts,
            distribute=work.distribute,
        )
    for k, name in enumerate(names, start=len(needed)):
        part = work.part(k / count, (k + 1) / count, name)
        part.progress("evaluation", 0.0)
        _, evaluate = EXPERIMENTS[name]
        results[name] = evaluate(measured, part)
    return results


def _table1(measured: Measured, _work: ExperimentRun) -> PaperResult:
    paper_rows = {_X: PAPER_FLOW_LEFT_REAR, _Y: PAPER_FLOW_REAR_RIGHT}
    tests = {
        name: _with_paper_rows(rows, measured[name], flow_rows) for name, rows in paper_rows.items()
    }
    return PaperResult(
        "Table 1: range flow of a translation",
        "A rigid object moves 2.5 mm a step. Angle: between the flow of the tracked surface points"
        " and the optical axis of the reference camera. Length: of that flow. The paper's motion"
        " (a), to the left-rear, stands beside the one along x, (b), to the rear-right, beside the"
        " one along y; the angles themselves are those of other directions. The length's bias is"
        " against the encoder for the paper, against the true path for the virtual bench.",
        flow_summary("Table 1, the worst of it", tests),
        tuple(motion_table(f"Table 1, {name}", rows, of_flow=True) for name, rows in tests.items()),
        {"table1": flow_curves(tests)},
    )


def _table2(measured: Measured, _work: ExperimentRun) -> PaperResult:
    paper_rows = {
        _X: PAPER_ANGLE_ERROR_X,
        _Y: PAPER_ANGLE_ERROR_Y,
        _ROTATION: PAPER_ANGLE_ERROR_ROTATION,
    }
    tests = {
        name: _with_paper_rows(rows, measured[name], vertex_rows)
        for name, rows in paper_rows.items()
    }
    return PaperResult(
        "Table 2: displacement of the vertices",
        "The same translations, and a rotation of 2 degrees a step about the object's z. Angle"
        " error: between the measured and the true displacement of a vertex. Command: mean length"
        " of the true displacement of the vertices that were measured. Near the axis of the"
        " rotation vertices hardly move, and any method has trouble with their directions. The"
        " paper's errors hold those of the registration of its mesh, too; here the pose is given.",
        vertex_summary("Table 2, its first and last steps", tests),
        tuple(
            motion_table(f"Table 2, {name}", rows, of_flow=False) for name, rows in tests.items()
        ),
        {"table2": vertex_curves(tests)},
    )


def _figure2(measured: Measured, _work: ExperimentRun) -> PaperResult:
    shown = [(_X, "s2", "translation by 5 mm"), (_ROTATION, "s1", "rotation by 2°")]
    return PaperResult(
        "Figure 2: optical flow and range flow of a rigid object",
        "Above a translation by 5 mm, below a rotation by 2 degrees about the object's z: optical"
        " flow, range flow, and the displacement of the vertices. The table has medians over the"
        " valid points: of their true displacement, and of the length of the error.",
        _tracking_table("Figure 2, points that were tracked", measured, shown),
        (),
        _flow_pictures("figure2", measured, shown),
    )


def _figure3(measured: Measured, _work: ExperimentRun) -> PaperResult:
    last = measured[_PROBING].session.probings[0].name
    shown = [(_PROBING, last, f"probing of the {last}")]
    return PaperResult(
        "Figure 3: a probing",
        "A soft toy is pushed from the side at an ear. Optical flow, range flow, and the"
        " displacement of the vertices; the probe hides what is behind it. The table has medians"
        " over the valid points: of their true displacement, and of the length of the error.",
        _tracking_table("Figure 3, points that were tracked", measured, shown),
        (),
        _flow_pictures("figure3", measured, shown),
    )


def _table3(measured: Measured, _work: ExperimentRun) -> PaperResult:
    ball = measured[_BALL]
    estimates = {method: estimated_constants(ball, method)[1].estimate for method in METHODS}
    truth = true_material(ball.session)
    return PaperResult(
        "Table 3: elastic constants of a half ball",
        "Each probing alone, and all together, from pictures and forces. A push moves what is in"
        " sight by a millimetre, as far as the paper's method can follow in one step: it rounds"
        " every step to whole pixels, and takes less than half a pixel for none. The paper's error"
        " of E is against its compression test, the others are against the truth. The cylinder of"
        " the compression test sticks to its lower plate, so that it says a little too much. No"
        " interval is stated where the data contradict the model.",
        constants_summary(estimates, truth, compressed_modulus(truth)),
        tuple(
            constants_table(estimate, f"Table 3, {method}")
            for method, estimate in estimates.items()
        ),
        {
            f"table3_{method}": figure_pixels(
                probings_figure(
                    estimate, truth={name: getattr(truth, name) for name in CONSTANT_NAMES}
                )
            )
            for method, estimate in estimates.items()
        },
    )


def _budget(_measured: Measured, work: ExperimentRun) -> PaperResult:
    folder = work.folder / "budget"
    folder.mkdir()
    sources = error_budget(
        work.config(_BALL),
        folder,
        variant=work.variant,
        draws=1 if work.quick else _DRAWS,
        progress=work.progress,
        parts=work.parts,
        distribute=work.distribute,
    )
    return PaperResult(
        "What limits table 3",
        "The bench of table 3 without any error, then with one source of error at a time, in the"
        " size that a careful laboratory has. `none` is what flow, mesh and the contact's model"
        " leave: a sphere also presses a little sideways, which the model leaves out. Errors of"
        " calibration and registration are the same for all probings: more probings do not help"
        " against them.",
        budget_table(sources),
        (sizes_table(sources),),
        {"budget": budget_picture(sources)},
    )


def _figure4(measured: Measured, _work: ExperimentRun) -> PaperResult:
    ball = measured[_BALL]
    session, result = estimated_constants(ball, "joint")
    names = [probing.name for probing in ball.session.probings]
    shown = names[:: max(len(names) // 2, 1)][:2]
    return PaperResult(
        "Figure 4: measured and simulated displacement",
        "Two probings of the half ball: the displacement of its vertices as measured from the"
        " pictures, and as predicted by the boundary element model with the estimated constants.",
        constants_table(result.estimate, "Figure 4, the constants of the simulation"),
        (),
        {f"figure4_{name}": motion_picture(session, result, name) for name in shown},
    )


def _with_paper_rows(
    paper_rows: Sequence[MotionRow],
    measured: PaperSession,
    rows_of: Callable[[PaperSession, Method], Sequence[MotionRow]],
) -> dict[str, Sequence[MotionRow]]:
    """The paper's rows, for as many steps as were measured, and those of each method."""
    rows_by_method: dict[str, Sequence[MotionRow]] = {
        method: rows_of(measured, method) for method in METHODS
    }
    return {PAPER: paper_rows[: len(rows_by_method[METHODS[0]])], **rows_by_method}


def _flow_pictures(name: str, measured: Measured, motions: Sequence[_Motion]) -> dict[str, Picture]:
    """For each method, the flow pictures of some motions, one below the other."""
    return {
        f"{name}_{method}": np.concatenate(
            [flow_picture(measured[s], method, step, f"{t}, {method}") for s, step, t in motions]
        )
        for method in METHODS
    }


def _tracking_table(title: str, measured: Measured, motions: Sequence[_Motion]) -> ResultTable:
    """Table of the number of tracked points and their errors, for some motions and each method."""
    cells: list[tuple[Cell, ...]] = []
    for name, step, _ in motions:
        for method in METHODS:
            motion = measured[name].motion(method, step)
            if motion.flow is None or motion.vertices is None:
                cells.append((name, step, method, None, None, None, None, None))
                continue
            flow, valid = motion.flow, is_valid(motion.flow)
            true = true_displacement(measured[name].session, step, flow)
            error = np.linalg.norm(flow.displacement - true, axis=1)[valid]
            vertices = np.isfinite(motion.vertices.displacement).all(axis=1)
            cells.append(
                (
                    name, step, method, len(valid), int(valid.sum()),
                    1e3 * known_median(np.linalg.norm(true, axis=1)[valid]),
                    1e3 * known_median(error),
                    int(vertices.sum()),
                )
            )  # fmt: skip
    columns = (
        "session", "instant", "source", "points", "valid", "true motion (mm)", "error (mm)",
        "vertices",
    )  # fmt: skip
    return ResultTable(title, columns, (0, 0, 0, 0, 0, 4, 4, 0), tuple(cells))


# By their names on the command line: the built-in configurations whose sessions each of them needs,
# and its evaluation.
EXPERIMENTS: dict[str, tuple[tuple[str, ...], Callable[[Measured, ExperimentRun], PaperResult]]] = {
    "table1": ((_X, _Y), _table1),
    "table2": ((_X, _Y, _ROTATION), _table2),
    "table3": ((_BALL,), _table3),
    "budget": ((), _budget),
    "figure2": ((_X, _ROTATION), _figure2),
    "figure3": ((_PROBING,), _figure3),
    "figure4": ((_BALL,), _figure4),
}
