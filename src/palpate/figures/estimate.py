"""Figures of an estimate: likelihood, single probings, measured against predicted; diagnostics.

Diagnostics are cross-validated predictions, estimated systematic errors and the uncertainty budget.
"""

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from scipy.interpolate import RectBivariateSpline

from palpate.estimation import FitResult, LikelihoodMap, ProbeFit
from palpate.figures.creep import creep_figure
from palpate.figures.displacement import OUTLIER_WEIGHT, displacement_figure
from palpate.figures.modulus import modulus_figure
from palpate.figures.style import (
    BLUE,
    GREY,
    INK,
    MIDDLE_BLUE,
    ORANGE,
    PALE_BLUE,
    open_frame,
    save_drawing,
    save_figure,
    styled,
)
from palpate.records import (
    IMPOSSIBLE,
    SURPRISING,
    Constant,
    Estimate,
    Probing,
    Reciprocity,
    Session,
    file_stems,
    modulus_unit,
)

# Deviance at the edge of the 50 and 95 % regions: chi squared with two degrees of freedom.
_REGIONS = {50: 1.3863, 95: 5.9915}
MAX_DEVIANCE = 16.0  # the likelihood is shown up to this deviance
_SYMBOLS = {
    "poisson_ratio": r"Poisson's ratio $\nu$",
    "shear_modulus": "shear modulus $G$",
    "young_modulus": "Young's modulus $E$",
}
# Largest number of dots; more would hide each other.
_MOST_DOTS = 4000
# Largest number of errors shown: those with the most prior standard deviations.
_MOST_ERRORS = 16
# Constant, axis label, factor of its standard deviations.
_BUDGETS = (
    ("young_modulus", "standard deviation of $E$ (%)", 100.0),
    ("poisson_ratio", r"standard deviation of $\nu$", 1.0),
)
# Smallest contribution shown, as a fraction of the largest.
_SMALLEST_PART = 0.02


def write_plots(folder: Path, session: Session, result: FitResult) -> list[Path]:
    """Write all figures of an estimate as PNG files, line drawings as SVG too.

    `likelihood.png` shows the regions of Poisson's ratio and shear modulus, `probings.png` the
    constants of each probing alone, `predictions.png` the predictions of each probing from the
    others, `errors.png` the estimated systematic errors, `budget.png` the uncertainty budget,
    `reciprocity.png` how well pushes agree whatever the material, `modulus.png` where the modulus
    differs, `creep.png` force and motion over time and the modulus over time,
    `displacement/NAME.png` the measured and predicted displacement of each probing on the object's
    surface.

    Parameters
    ----------
    folder : Path           an existing folder; existing pictures are replaced
    session : Session
    result : FitResult      of that session

    Returns
    -------
    list of Path            the files, in the order of writing

    Raises
    ------
    OSError                 a file cannot be written
    """
    written = save_drawing(likelihood_figure(result), folder / "likelihood.png")
    if result.estimate.probes:
        written += save_drawing(probings_figure(result.estimate), folder / "probings.png")
    tested = result.estimate.reciprocity
    for name, drawn in (
        ("predictions", predictions_figure(session, result)),
        ("errors", errors_figure(result.estimate)),
        ("budget", budget_figure(result.estimate)),
        ("reciprocity", None if tested is None else reciprocity_figure(tested)),
        ("modulus", modulus_map_figure(result)),
        ("creep", creep_figure(result)),
    ):
        if drawn is not None:
            written += save_drawing(drawn, folder / f"{name}.png")
    by_name = {probing.name: probing for probing in session.probings}
    stems = file_stems([fit.name for fit in result.probes], kind="probing")
    for stem, fit in zip(stems, result.probes, strict=True):
        figure = displacement_figure(
            session.mesh, by_name[fit.name], fit, held=session.held_triangles
        )
        if figure is not None:
            file = folder / "displacement" / f"{stem}.png"
            file.parent.mkdir(exist_ok=True)
            written.append(save_figure(figure, file))
    return written


def modulus_map_figure(result: FitResult) -> Figure | None:
    """Sections through a body that is not the same everywhere; None: one modulus fits.

    Parameters
    ----------
    result : FitResult
    """
    return None if result.map is None else modulus_figure(result.map, result.estimate.field)


@styled
def likelihood_figure(result: FitResult) -> Figure:
    """Joint 50 and 95 % regions of Poisson's ratio and shear modulus.

    Parameters
    ----------
    result : FitResult

    Returns
    -------
    Figure                          4.6 by 3.9 inches
    """
    estimate = result.estimate
    factor, unit = modulus_unit(estimate.shear_modulus.value)
    nu, shear, deviance = refined_likelihood(result.likelihood)
    shear = shear / factor
    figure = Figure(figsize=(4.6, 3.9))
    axes = figure.add_axes((0.14, 0.12, 0.82, 0.70))
    # A spline may dip below zero.
    levels = [min(0.0, float(deviance.min())) - 1e-9, *_REGIONS.values()]
    axes.contourf(nu, shear, deviance, levels=levels, colors=[MIDDLE_BLUE, PALE_BLUE])
    axes.contour(nu, shear, deviance, levels=levels[1:], colors=BLUE, linewidths=0.8)
    axes.set(xlim=(nu[0], nu[-1]), ylim=(shear[0], shear[-1]))
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set(xlabel=r"Poisson's ratio $\nu$", ylabel=f"shear modulus $G$ ({unit})")
    patches = {
        f"both together, {share} %": Patch(facecolor=colour, edgecolor=BLUE, linewidth=0.8)
        for share, colour in zip(_REGIONS, (MIDDLE_BLUE, PALE_BLUE), strict=True)
    }
    handles = patches | _interval_lines(axes, estimate, nu, factor)
    figure.legend(handles.values(), handles.keys(), loc="upper center", ncols=2, columnspacing=1.4)
    open_frame(axes)
    return figure


def _estimate_dot(axes: Axes, estimate: Estimate, factor: float) -> Artist:
    """Mark the estimate in the plane of nu and G."""
    (dot,) = axes.plot(
        estimate.poisson_ratio.value, estimate.shear_modulus.value / factor, "o", color=ORANGE,
        markersize=5, markeredgecolor="white", zorder=5, clip_on=False,
    )  # fmt: skip
    return dot


def _interval_lines(
    axes: Axes, estimate: Estimate, nu: Float[np.ndarray, " a"], factor: float
) -> dict[str, Artist]:
    """Draw the marginal intervals of each constant next to the joint region; gives the artists by
    their labels."""
    artists: dict[str, Artist] = {}
    ratio, shear, young = (
        getattr(estimate, name) for name in ("poisson_ratio", "shear_modulus", "young_modulus")
    )
    known = [estimate.identifiable[name] for name in ("poisson_ratio", "shear_modulus")]
    edge = [0.035 * np.ptp(limits()) + limits()[0] for limits in (axes.get_xlim, axes.get_ylim)]
    if np.isnan(ratio.ci95[0]):
        # The model is contradicted: its best fit has no interval.
        return {"best fit": _estimate_dot(axes, estimate, factor)}
    low, high = np.clip(ratio.ci95, *axes.get_xlim())
    soft, stiff = np.clip(np.array(shear.ci95) / factor, *axes.get_ylim())
    # The interval of a constant that is not determined is its possible range.
    lines = [
        axes.plot([low, high], [edge[1]] * 2, **_interval_style(known[0]))[0],
        axes.plot([edge[0]] * 2, [soft, stiff], **_interval_style(known[1]))[0],
    ]
    for line, is_known in zip(lines, known, strict=True):
        label = "each alone, 95 %: as printed" if is_known else "not determined: possible range"
        artists[label] = line
    if all(known):
        artists["estimate"] = _estimate_dot(axes, estimate, factor)
    if estimate.identifiable["young_modulus"]:
        edges = [end / factor / (2.0 * (1.0 + nu)) for end in young.ci95]
        artists["E, 95 %: as printed"] = axes.fill_between(
            nu, *edges, color=ORANGE, alpha=0.12, linewidth=0, zorder=-1
        )
        size, unit = modulus_unit(young.value)
        (artists[f"$E$ = {young.value / size:.4g} {unit}"],) = axes.plot(
            nu, young.value / factor / (2.0 * (1.0 + nu)), "--", color=GREY, linewidth=0.8
        )
    return artists


def _interval_style(known: bool) -> dict[str, Any]:
    """Line style of the interval of one constant."""
    ends = {"marker": "|", "markersize": 6.0, "zorder": 4, "clip_on": False}
    return ends | {"color": ORANGE if known else GREY, "linewidth": 2.0 if known else 1.2}


def refined_likelihood(
    likelihood: LikelihoodMap,
) -> tuple[Float[np.ndarray, " a"], Float[np.ndarray, " b"], Float[np.ndarray, "b a"]]:
    """The relevant part of a likelihood map, interpolated to a finer grid for smooth contours.

    Parameters
    ----------
    likelihood : LikelihoodMap

    Returns
    -------
    (a,) float                      Poisson's ratios
    (b,) float [Pa]                 shear moduli
    (b, a) float                    deviance; spline interpolation may undershoot zero
    """
    nu, shear, deviance = likelihood.poisson_ratio, likelihood.shear_modulus, likelihood.deviance.T
    near = deviance < MAX_DEVIANCE
    if not near.any():
        return nu, shear, deviance
    along, across = (
        slice(max(rows[0] - 2, 0), rows[-1] + 3)
        for rows in (np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0)))
    )
    nu, shear, part = nu[across], shear[along], deviance[along, across]
    if min(part.shape) < 4 or not np.isfinite(part).all():
        return nu, shear, part
    fine_nu, fine_shear = (np.linspace(x[0], x[-1], 300) for x in (nu, shear))
    return fine_nu, fine_shear, RectBivariateSpline(shear, nu, part)(fine_shear, fine_nu)


@styled
def probings_figure(estimate: Estimate, *, truth: Mapping[str, float] | None = None) -> Figure:
    """Constants of each probing alone with 95 % intervals, and the joint interval as a band.

    Intervals of a constant that is not determined are drawn without a dot.

    Parameters
    ----------
    estimate : Estimate             with probings
    truth : mapping or None         constant's name -> true value [Pa; -], drawn as a line

    Returns
    -------
    Figure                          7 inches wide; the height depends on the number of probings
    """
    count = len(estimate.probes)
    height = 1.25 + 0.2 * max(count, 3)
    figure = Figure(figsize=(7.0, height))
    panels = figure.subplots(1, 3, sharey=True)
    longest = max(len(probe.name) for probe in estimate.probes)
    figure.subplots_adjust(
        left=min(0.03 + 0.011 * longest, 0.3), right=0.97, wspace=0.14,
        bottom=0.5 / height, top=1 - 0.5 / height,
    )  # fmt: skip
    for axes, (name, symbol) in zip(panels, _SYMBOLS.items(), strict=True):
        joint = getattr(estimate, name)
        factor, unit = (1.0, "") if name == "poisson_ratio" else modulus_unit(joint.value)
        intervals = [
            (getattr(probe, name), probe.identifiable.get(name, estimate.identifiable[name]))
            for probe in estimate.probes
        ]
        true = None if truth is None else truth[name] / factor
        _dots(axes, intervals, joint, factor, known=estimate.identifiable[name], true=true)
        axes.set_xlabel(f"{symbol} ({unit})" if unit else symbol)
        if not estimate.identifiable[name]:
            axes.set_title("not determined by these data", color=INK)
        if true is not None:
            line = axes.axvline(true, color=INK, linestyle="--", linewidth=0.9)
    panels[0].set_yticks(range(count), [probe.name for probe in estimate.probes], parse_math=False)
    panels[0].set_ylim(count - 0.4, -0.6)
    handles: dict[str, Artist] = {
        "one probing, 95 %": Line2D([], [], color=BLUE, marker="o", markersize=3.5, linewidth=0.9),
        "all probings": Line2D([], [], color=ORANGE, linewidth=1.0),
        "its 95 % interval": Patch(color=ORANGE, alpha=0.18, linewidth=0),
    }
    if truth is not None:
        handles["truth"] = line
    figure.legend(handles.values(), handles.keys(), loc="upper center", ncols=4)
    return figure


def _dots(
    axes: Axes,
    intervals: list[tuple[Constant, bool]],
    joint: Constant,
    factor: float,
    *,
    known: bool,
    true: float | None,
) -> None:
    """Draw one panel of the dot plot; intervals that leave the panel end in arrow heads."""
    singles = [single for single, _ in intervals]
    low, high = joint.ci95
    if known:
        axes.axvline(joint.value / factor, color=ORANGE, linewidth=1.0, zorder=1)
    if known and np.isfinite([low, high]).all():
        axes.axvspan(low / factor, high / factor, color=ORANGE, alpha=0.18, linewidth=0, zorder=0)
    value = np.array([single.value for single in singles]) / factor
    ends = np.array([single.ci95 for single in singles]).reshape(-1, 2) / factor
    shown = np.array([joint.value, *joint.ci95]) / factor
    shown = shown[np.isfinite(shown)]
    left, right = _panel_limits(np.append(value, shown if true is None else [*shown, true]), ends)
    rows = np.arange(len(singles))
    reach = np.clip(ends, left, right)
    finite = np.isfinite(value)
    dot = np.clip(value, left, right)
    bars = np.abs(reach - dot[:, None]).T
    alone = np.array([is_known for _, is_known in intervals])
    for those, form, colour in ((finite & alone, "o", BLUE), (finite & ~alone, "none", GREY)):
        axes.errorbar(
            dot[those], rows[those], xerr=bars[:, those], fmt=form, color=colour, ecolor=colour,
            markersize=3.5, elinewidth=0.9, zorder=3,
        )  # fmt: skip
    for marker, beyond, edge in (("<", ends[:, 0] < left, left), (">", ends[:, 1] > right, right)):
        hit = finite & beyond
        axes.plot(np.full(hit.sum(), edge), rows[hit], marker, color=BLUE, markersize=3,
                  linestyle="none", clip_on=False, zorder=4)  # fmt: skip
    axes.set_xlim(left, right)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", color="#e6e8eb", linewidth=0.5, zorder=-1)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)


def _panel_limits(
    values: Float[np.ndarray, " k"], ends: Float[np.ndarray, "n 2"]
) -> tuple[float, float]:
    """Limits of a panel that show all values, and the intervals unless they are very wide."""
    values = values[np.isfinite(values)]
    low, high = values.min(), values.max()
    width = max(high - low, 1e-3 * max(abs(high), 1e-12))
    reach = np.concatenate([values, ends[np.isfinite(ends)]])
    low, high = max(reach.min(), low - 2 * width), min(reach.max(), high + 2 * width)
    margin = 0.04 * max(high - low, width)
    return float(low - margin), float(high + margin)


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
    pairs = [_pairs(by_name[probe.name], probe) for probe in result.probes]
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
    every = [*estimate.errors, *(error for probe in estimate.probes for error in probe.errors)]
    every = [error for error in every if error.prior_std > 0.0]
    if not every:
        return None
    farthest = sorted(every, key=lambda error: -abs(error.value) / error.prior_std)[:_MOST_ERRORS]
    value = np.array([error.value / error.prior_std for error in farthest])
    std = np.array([error.std / error.prior_std for error in farthest])
    figure = Figure(figsize=(4.8, 0.85 + 0.27 * len(farthest)), layout="constrained")
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
    # Narrow enough for a phone.
    names = [textwrap.fill(_short(error.name), 28) for error in farthest]
    axes.set_yticks(rows, names, parse_math=False, linespacing=1.0)
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
    parts = np.array(
        [[f * getattr(entry, name) for name, _, f in panels] for entry in estimate.budget]
    )
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


# Most names along a side of the pairs.
_MOST_NAMES = 24


@styled
def reciprocity_figure(reciprocity: Reciprocity) -> Figure | None:
    """Works of every two pushes in each other's motions: how far they differ, in standard
    deviations, and how much larger each force is than the others say.

    Parameters
    ----------
    reciprocity : Reciprocity

    Returns
    -------
    Figure or None                  None where nothing could be tested
    """
    if not reciprocity.is_tested:
        return None
    names = [push.name for push in reciprocity.pushes]
    grid = np.full((len(names), len(names)), np.nan)
    for pair in reciprocity.pairs:
        first, other = names.index(pair.first), names.index(pair.second)
        # Of sizes: a force may do negative work in the motion under another.
        larger = float(np.sign(pair.work + pair.other)) * pair.sigmas
        grid[other, first], grid[first, other] = larger, -larger
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
    value = 100.0 * np.array([push.excess for push in reciprocity.pushes])
    std = 100.0 * np.array([push.std for push in reciprocity.pushes])
    right.axvline(0.0, color=INK, linewidth=0.8)
    odd = np.array([name in reciprocity.odd for name in names])
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
