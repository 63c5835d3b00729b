"""Figure of a body that creeps: force and motion over time, and the modulus over time."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from palpate.estimation import FitResult
from palpate.figures.style import BLUE, GREY, ORANGE, PALE_BLUE, open_frame, styled
from palpate.records import RelaxationEstimate, modulus_unit
from palpate.relaxation import CreepFit

_SYMBOLS = {"shear_modulus": "shear modulus", "young_modulus": "Young's modulus"}


@styled
def creep_figure(result: FitResult) -> Figure | None:
    """Left: force and motion over those of the static fit, with the fitted creep. Right: the
    modulus inside the window, with its 95 % interval.

    Parameters
    ----------
    result : FitResult

    Returns
    -------
    Figure or None                  7.6 by 2.9 inches; None: no probing has a series
    """
    creep, relaxation = result.creep, result.estimate.relaxation
    if creep is None or relaxation is None:
        return None
    figure = Figure(figsize=(7.6, 2.9))
    moved, modulus = (figure.add_axes((x, 0.16, 0.39, 0.72)) for x in (0.075, 0.59))
    _draw_motion(moved, creep)
    _draw_modulus(modulus, relaxation)
    figure.legend(*moved.get_legend_handles_labels(), loc="upper left", ncols=3)
    return figure


def _draw_motion(axes: Axes, creep: CreepFit) -> None:
    for number, motion in enumerate(creep.motions):
        later = motion.time > 0.0
        names = ("force", "motion", "fit") if number == 0 else ("", "", "")
        axes.plot(
            motion.time[later], motion.force[later], color=GREY, linewidth=1.0, label=names[0]
        )
        axes.plot(
            motion.time[motion.instant], motion.amplitude, ".", color=BLUE, markersize=3.0,
            markeredgewidth=0.0, label=names[1],
        )  # fmt: skip
        axes.plot(
            motion.time[later], creep.predicted(number)[later], color=ORANGE, linewidth=1.2,
            label=names[2],
        )  # fmt: skip
    axes.set(xscale="log", xlabel="time after contact (s)", ylabel="over that of the static fit")
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    open_frame(axes)


def _draw_modulus(axes: Axes, relaxation: RelaxationEstimate) -> None:
    factor, unit = modulus_unit(relaxation.unrelaxed)
    time = [point.time for point in relaxation.curve]
    value = np.array([point.modulus.value for point in relaxation.curve]) / factor
    ends = np.array([point.modulus.ci95 for point in relaxation.curve]).reshape(-1, 2) / factor
    axes.fill_between(time, ends[:, 0], ends[:, 1], color=PALE_BLUE, linewidth=0)
    axes.plot(time, value, color=BLUE, linewidth=1.4)
    name = f"{_SYMBOLS[relaxation.constant]} ({unit})"
    axes.set(xscale="log", yscale="log", xlabel="time under a held displacement (s)", ylabel=name)
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(ScalarFormatter())
    open_frame(axes)
