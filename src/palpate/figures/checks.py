"""Diagnostic figures of an estimate: cross-validated predictions, estimated systematic errors,
uncertainty budget."""

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from palpate.estimation import FitResult, ProbeFit
from palpate.figures.displacement import OUTLIER_WEIGHT
from palpate.figures.style import BLUE, GREY, INK, ORANGE, open_frame, styled
from palpate.records import (
    IMPOSSIBLE,
    SURPRISING,
    Estimate,
    Probing,
    Reciprocity,
    Session,
)

# Largest number of dots; more would hide each other.
_MOST_DOTS = 4000
# Largest number of errors shown: those with the most prior standard deviations.
_MOST_ERRORS = 16
# Constant, axis label, factor of its standard deviations.
_BUDGETS = (
    ("young_modulus", "standard deviation of $E$ (%)", 100.0),
    ("poisson_ratio", r"standard deviation of $\nu$", 1.0),
)
# Most names along a side of the pairs.
_MOST_NAMES = 24
# Smallest contribution shown, as a fraction of the largest.
_SMALLEST_PART = 0.02


@styled
def predictions_figure(session: Session, result: FitResult) -> Figure | None:
    """Measured displacement of every point against its prediction from the other probings.

    The component of the measured displacement along the predicted direction is drawn: unlike its
    length, it is not biased by noise. Outliers are left out.

    Parameters
    ----------
    session : Session
    result : FitResult              of that session

    Returns
    -------
    Figure or None                  None if there is only one probing
    """
    by_name = {probing.name: probing for probing in session.probings}
    pairs = [_pairs(by_name[one.name], one) for one in result.probes]
    known = [pair for pair in pairs if pair is not None]
    if not known:
        return None
    predicted, measured, used = np.concatenate(known, axis=1)
    predicted, measured = 1e3 * predicted[used > 0.0], 1e3 * measured[used > 0.0]
    step = max(1, len(measured) // _MOST_DOTS)
    size = float(np.clip(60.0 / np.sqrt(len(measured) + 1.0), 2.2, 5.0))
    low = min(float(measured.min(initial=0.0)), 0.0)
    figure = Figure(figsize=(4.6, 3.9))
    axes = figure.add_axes((0.14, 0.12, 0.82, 0.78))
    top = float(max(predicted.max(initial=0.0), measured.max(initial=0.0))) or 1.0
    axes.plot([0.0, top], [0.0, top], color=INK, linewidth=0.8, label="equal")
    axes.plot(
        predicted[::step], measured[::step], "o", color=BLUE, markersize=size, alpha=0.55,
        markeredgewidth=0, label="a point", zorder=3,
    )  # fmt: skip
    axes.set(
        xlabel="predicted by the other probings (mm)", ylabel="measured along that direction (mm)"
    )
    axes.set(xlim=(0.0, 1.04 * top), ylim=(low - 0.02 * top, 1.04 * top))
    figure.legend(loc="upper center", ncols=2)
    open_frame(axes)
    return figure


def _pairs(probing: Probing, fit: ProbeFit) -> np.ndarray | None:
    """Predicted lengths [m], measured components along the predicted directions [m], and 1 for used
    points, else 0; (3, n)."""
    field = probing.displacement
    if field is None or fit.left_out_predicted is None:
        return None
    seen = np.isfinite(field.displacement).all(axis=1)
    predicted, measured = fit.left_out_predicted[seen], field.displacement[seen]
    length = np.linalg.norm(predicted, axis=1)
    along = np.einsum("nk,nk->n", predicted, measured) / np.maximum(length, 1e-300)
    return np.stack([length, along, fit.weight[seen].max(axis=1) >= OUTLIER_WEIGHT])


@styled
def errors_figure(estimate: Estimate) -> Figure | None:
    """Estimate and posterior deviation of each systematic error, in prior standard deviations.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    Figure or None                  None if no systematic error was estimated
    """
    every = [*estimate.errors, *(one for probe in estimate.probes for one in probe.errors)]
    every = [one for one in every if one.prior_std > 0.0]
    if not every:
        return None
    farthest = sorted(every, key=lambda one: -abs(one.value) / one.prior_std)[:_MOST_ERRORS]
    value = np.array([one.value / one.prior_std for one in farthest])
    std = np.array([one.std / one.prior_std for one in farthest])
    figure = Figure(figsize=(7.0, 0.85 + 0.2 * len(farthest)), layout="constrained")
    axes = figure.add_subplot()
    rows = np.arange(len(farthest))
    axes.axvspan(
        -1.0, 1.0, color="#e6e8eb", linewidth=0, zorder=0, label="assumed (prior, 1 sigma)"
    )
    for limit in (SURPRISING, IMPOSSIBLE):
        for side in (-limit, limit):
            axes.axvline(side, color=ORANGE if limit == IMPOSSIBLE else GREY, linewidth=0.8,
                         linestyle=(0, (2, 2)), zorder=1)  # fmt: skip
    axes.errorbar(value, rows, xerr=std, fmt="o", color=BLUE, markersize=3.5, elinewidth=0.9,
                  label="found, 1 sigma", zorder=3)  # fmt: skip
    reach = max(SURPRISING + 0.4, float(np.abs(value).max() + std.max()) + 0.2)
    axes.set(xlim=(-reach, reach), ylim=(len(farthest) - 0.4, -0.6))
    axes.set_yticks(rows, [_short(one.name) for one in farthest], parse_math=False)
    axes.set_xlabel("in the assumed standard deviations (prior)")
    axes.tick_params(axis="y", length=0)
    axes.spines[["top", "right", "left"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=2)
    return figure


@styled
def budget_figure(estimate: Estimate) -> Figure | None:
    """Uncertainty budget: contributions to the standard deviations of E and nu, by source.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    Figure or None                  None if neither is determined, or there is no budget
    """
    panels = [
        (name, label, factor)
        for name, label, factor in _BUDGETS
        if estimate.budget and estimate.identifiable[name]
    ]
    if not panels:
        return None
    parts = np.array([[f * getattr(one, name) for name, _, f in panels] for one in estimate.budget])
    # The smallest bars would be invisible.
    shown = np.flatnonzero((parts > _SMALLEST_PART * parts.max(axis=0)).any(axis=1))
    sources = [estimate.budget[k].source for k in shown]
    height = 1.05 + 0.22 * len(shown)
    figure = Figure(figsize=(7.0, height))
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    figure.subplots_adjust(
        left=0.27, right=0.95, wspace=0.12, bottom=0.5 / height, top=1 - 0.35 / height
    )
    for panel, (_, label, _), values in zip(axes, panels, parts.T, strict=True):
        whole = float(np.sqrt((values**2).sum()))
        panel.barh(np.arange(len(shown)), values[shown], height=0.62, color=BLUE)
        panel.axvline(whole, color=ORANGE, linewidth=1.2)
        panel.set(xlabel=label, xlim=(0.0, 1.08 * whole), ylim=(len(shown) - 0.4, -0.6))
        panel.tick_params(axis="y", length=0)
        panel.spines[["top", "right"]].set_visible(False)
    axes[0].set_yticks(np.arange(len(shown)), sources, parse_math=False)
    handles = {"from one source, 1 sigma": Patch(color=BLUE, linewidth=0),
               "all together": Line2D([], [], color=ORANGE, linewidth=1.2)}  # fmt: skip
    figure.legend(handles.values(), handles.keys(), loc="upper center", ncols=2)
    return figure


def _short(name: str) -> str:
    return name if len(name) <= 54 else f"{name[:53]}\N{HORIZONTAL ELLIPSIS}"


@styled
def reciprocity_figure(found: Reciprocity) -> Figure | None:
    """Works of every two pushes in each other's motions: how far they differ, in standard
    deviations, and how much larger each force is than the others say.

    Parameters
    ----------
    found : Reciprocity

    Returns
    -------
    Figure or None                  None where nothing could be tested
    """
    if not found.is_tested:
        return None
    names = [push.name for push in found.pushes]
    grid = np.full((len(names), len(names)), np.nan)
    for pair in found.pairs:
        one, other = names.index(pair.first), names.index(pair.second)
        # Of sizes: a force may do negative work in the motion under another.
        larger = float(np.sign(pair.work + pair.other)) * pair.sigmas
        grid[other, one], grid[one, other] = larger, -larger
    figure = Figure(figsize=(7.0, 3.6))
    left = figure.add_axes((0.09, 0.28, 0.36, 0.64))
    bar = figure.add_axes((0.11, 0.14, 0.32, 0.025))
    right = figure.add_axes((0.56, 0.28, 0.41, 0.64))
    colours = LinearSegmentedColormap.from_list("signs", [BLUE, "#ffffff", ORANGE])
    colours.set_bad("#e6e8eb")
    shown = left.imshow(grid, cmap=colours, vmin=-IMPOSSIBLE, vmax=IMPOSSIBLE)
    scale = figure.colorbar(shown, cax=bar, orientation="horizontal")
    scale.set_label("work of the row's force above the column's (sigma)")
    scale.outline.set_linewidth(0.6)
    step = max(1, -(-len(names) // _MOST_NAMES))
    ticks = np.arange(0, len(names), step)
    left.set_xticks(ticks, names[::step], rotation=90, parse_math=False)
    left.set_yticks(ticks, names[::step], parse_math=False)
    left.tick_params(length=0)
    rows = np.arange(len(names))
    value = 100.0 * np.array([push.excess for push in found.pushes])
    std = 100.0 * np.array([push.std for push in found.pushes])
    right.axvline(0.0, color=INK, linewidth=0.8)
    odd = np.array([name in found.odd for name in names])
    for chosen, colour in ((~odd, BLUE), (odd, ORANGE)):
        right.errorbar(value[chosen], rows[chosen], xerr=std[chosen], fmt="o", color=colour,
                       markersize=3.5, elinewidth=0.9)  # fmt: skip
    right.set(ylim=(len(names) - 0.5, -0.5), xlabel="force above what the others say (%)")
    right.set_yticks(ticks, names[::step], parse_math=False)
    right.tick_params(axis="y", length=0)
    right.spines[["top", "right", "left"]].set_visible(False)
    left.set_title("pairs of pushes (grey: not seen)")
    right.set_title("each push, with 1 sigma")
    return figure
