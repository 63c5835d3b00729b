"""Tables for the terminal: one way to build them, and those of an estimate and of a flow."""

import math
import statistics
from collections.abc import Iterable, Sequence

from rich.table import Table

from palpate.app.terminal.shown_table import ShownTable
from palpate.errors import visible
from palpate.pipeline import MotionFigures
from palpate.records import (
    BudgetEntry,
    Estimate,
    ProbeEstimate,
    Rig,
    budget_text,
    constant_row,
    constant_text,
    error_texts,
    length_unit,
    modulus_unit,
    value_text,
)

_LABELS = {
    "shear_modulus": "shear modulus G",
    "poisson_ratio": "Poisson's ratio nu",
    "young_modulus": "Young's modulus E",
}
_SHORT_CAUSES = {"reprojection": "reproj.", "neighbours": "neighb."}


def terminal_table(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    caption: str = "",
    total: bool = False,
) -> Table:
    """A table for the terminal: words to the left, numbers to the right.

    On a narrow terminal a cell of words goes on in the next line, and columns that have no room go
    on below, behind the names; no number is broken, nothing is left out.

    Parameters
    ----------
    title : str
    columns : sequence of str       headings; the first column holds names
    rows : iterable of sequences    as many cells as headings, shown as they are, but for what
                                    commands a terminal
    caption : str                   below the table
    total : bool                    the last row stands apart

    Returns
    -------
    Table                           of rich
    """
    names, *cells = ([visible(cell) for cell in row] for row in (columns, *rows))
    return ShownTable(visible(title), names, cells, visible(caption), total=total)


def number_text(value: float | None, form: str) -> str:
    """A number in a format such as `.3g`, or a dash where it is not known.

    Parameters
    ----------
    value : float or None           NaN and infinity: not known, too
    form : str                      such as `.3g`

    Returns
    -------
    str
    """
    return "-" if value is None or not math.isfinite(value) else f"{value:{form}}"


def constants_table(estimate: Estimate) -> Table:
    """The three constants with their intervals; no values of those that are not determined.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    Table                           moduli in a unit of fitting size
    """
    rows = []
    for name, label in _LABELS.items():
        *texts, unit = constant_row(estimate, name)
        rows.append((label, *texts, unit or "-"))
    columns = ("constant", "value ± 1 sigma", "95 % interval", "unit")
    caption = " ".join(_captions(estimate))
    return terminal_table("Elastic constants", columns, rows, caption=caption)


def _captions(estimate: Estimate) -> list[str]:
    """What the intervals hold beside noise, in sentences."""
    sentences = []
    if assumed := len(estimate.settings.get("assumed_forces", ())):
        fraction = estimate.settings["errors"]["force"]
        sentences.append(
            f"The force of {assumed} of {len(estimate.probes)} probings is assumed known to"
            f" {100 * fraction:.2g} % (no force_std given)."
        )
    lengths = estimate.settings.get("lengths", {})
    if "rig_covariance" in lengths.get("source", ""):
        along = ", ".join(f"{100 * std:.2g} %" for std in lengths["std"])
        sentences.append(f"Lengths are known by the cameras' calibration to {along} along x, y, z.")
    sentences += budget_sentences(estimate.budget)
    errors = [*estimate.errors, *(error for probe in estimate.probes for error in probe.errors)]
    if errors:
        worst = max(errors, key=lambda error: abs(error.value) / error.prior_std)
        value, std, prior = error_texts(worst)
        sentences.append(
            f"Of the errors that points share, farthest off is the {worst.name}, by {value} ± {std}"
            f" (assumed: {prior}, prior, 1 sigma)."
        )
    return sentences


def budget_sentences(budget: Sequence[BudgetEntry]) -> list[str]:
    """What the standard deviations of E and nu come from, a sentence each.

    Parameters
    ----------
    budget : sequence of BudgetEntry

    Returns
    -------
    list of str                     none of constants that are not determined
    """
    return [
        f"Sigma of {symbol} comes from: {part}."
        for name, symbol in (("young_modulus", "E"), ("poisson_ratio", "nu"))
        if (part := budget_text(budget, name))
    ]


def probes_table(estimate: Estimate) -> Table:
    """Each probing alone: its constants, what was used of it, how well it was explained.

    Parameters
    ----------
    estimate : Estimate             with probings

    Returns
    -------
    Table                           moduli in a unit of fitting size, residuals in mm
    """
    _, unit = modulus_unit(estimate.young_modulus.value)
    rows = [
        (
            probe.name, _probing_constant(estimate, probe, "poisson_ratio"),
            _probing_constant(estimate, probe, "shear_modulus"),
            _probing_constant(estimate, probe, "young_modulus"), str(probe.observed),
            str(probe.missing), str(probe.rejected), _millimetres(probe.rms_residual),
            _millimetres(probe.prediction_error),
        )
        for probe in estimate.probes
    ]  # fmt: skip
    return terminal_table(
        f"Each probing alone (moduli in {unit}, residuals in mm)",
        ("probing", "nu", "G", "E", "points", "missing", "outliers", "rms", "predicted"),
        rows,
        caption="missing: points not measured; outliers: excluded; rms: residual of the joint"
        " estimate; predicted: residual of the prediction from the other probings; a dash: not"
        " determined by this probing alone",
    )


def _probing_constant(estimate: Estimate, probe: ProbeEstimate, name: str) -> str:
    """A constant as one probing alone determines it; the shear modulus without its deviation."""
    # What all together do not determine, none does.
    if not probe.identifiable.get(name, estimate.identifiable[name]):
        return "-"
    factor = 1.0
    if name != "poisson_ratio":
        factor, _ = modulus_unit(estimate.young_modulus.value)
    form = value_text if name == "shear_modulus" else constant_text
    return form(getattr(probe, name), factor=factor)


def flow_table(figures: Sequence[MotionFigures], rig: Rig) -> Table:
    """A line for every motion: points, rejected by cause, sigma, noise, reprojection error.

    Parameters
    ----------
    figures : sequence of MotionFigures
    rig : Rig                       whose cameras are named below the table

    Returns
    -------
    Table                           sigma in um or mm, reprojection error in px
    """
    depths = [f.median_sigma["depth"] for f in figures if f.valid]
    factor, unit = length_unit(statistics.median(depths) if depths else math.nan)
    rows = [
        (
            f.name, str(f.points), f"{100.0 * f.valid / f.points:.1f}", _causes(f),
            " ".join(number_text(level, ".1f") for level in f.noise.values()),
            ", ".join(number_text(sigma / factor, ".2g") for sigma in f.median_sigma.values()),
            number_text(f.median_reprojection, ".2g"), "{measured}/{seen}".format(**f.vertices),
        )
        if f.points else (f.name, "-", "-", "failed", "-", "-", "-", "-")
        for f in figures
    ]  # fmt: skip
    cameras = ", ".join(camera.name for camera in rig.cameras)
    return terminal_table(
        "Measured motion",
        ("name", "points", "valid %", "rejected", "noise grey", f"1 sigma {unit}", "reproj. px",
         "vertices"),
        rows,
        caption=f"noise: of a pixel in {cameras}; 1 sigma: median over the valid points, across and"
        " along the axis of the reference camera; reproj.: median over them; vertices: with a"
        " displacement, of those looked at",
    )  # fmt: skip


def _causes(f: MotionFigures) -> str:
    """Causes and counts, the most frequent first."""
    found = sorted(((n, cause) for cause, n in f.rejected.items() if n), key=lambda x: -x[0])
    # Without a space, lest a line be broken between a cause and its count.
    return (
        " ".join(f"{_SHORT_CAUSES.get(cause, cause)}:{count}" for count, cause in found) or "none"
    )


def _millimetres(metres: float | None) -> str:
    """A residual, or a dash where there is none."""
    return number_text(None if metres is None else 1e3 * metres, ".3g")
