"""Tables for the terminal: one way to build them, and those of an estimate and of a flow."""

import math
import re
import statistics
import textwrap
from collections.abc import Iterable, Sequence

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from palpate.pipeline import MotionFigures
from palpate.records import (
    Estimate,
    Rig,
    constant_text,
    error_texts,
    interval_text,
    length_unit,
    modulus_unit,
    value_text,
)

_LABELS = {
    "shear_modulus": "shear modulus G",
    "poisson_ratio": "Poisson's ratio nu",
    "young_modulus": "Young's modulus E",
}
_SHORT = {"reprojection": "reproj.", "neighbours": "neighb."}
# Headings are broken between words, so that columns are as narrow as what is in them, or this.
_HEADING_WIDTH = 7
# A cell that begins like this makes its column one of words, which are set to the left.
_WORD = re.compile(r"(?!unknown|nan|inf)[A-Za-z\[]")


def terminal_table(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    caption: str = "",
    total: bool = False,
) -> Table:
    """A table for the terminal: words to the left, numbers to the right.

    On a narrow terminal a cell goes on in the next line; nothing is left out.

    Parameters
    ----------
    title : str
    columns : sequence of str       headings; the first column holds names
    rows : iterable of sequences    as many cells as headings, shown as they are
    caption : str                   below the table
    total : bool                    the last row stands apart

    Returns
    -------
    Table                           of rich
    """
    rows = [list(row) for row in rows]
    table = Table(
        title=escape(title), title_justify="left", caption=escape(caption) or None,
        caption_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False,
    )  # fmt: skip
    for k, heading in enumerate(columns):
        cells = [row[k] for row in rows]
        width = max(_HEADING_WIDTH, *map(len, cells)) if cells else _HEADING_WIDTH
        words = k == 0 or any(_WORD.match(cell) for cell in cells)
        # A name may go on in the next line, a number may not.
        unbroken = 0 if k == 0 else max((len(w) for cell in cells for w in cell.split()), default=0)
        table.add_column(
            escape(textwrap.fill(heading, width, break_long_words=False)),
            justify="left" if words else "right",
            overflow="fold",
            min_width=unbroken,
        )
    for k, row in enumerate(rows):
        if total and k == len(rows) - 1:
            table.add_section()
        table.add_row(*map(escape, row))
    return table


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
    """The three constants with their intervals, and whether the data determine them.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    Table                           moduli in a unit of fitting size
    """
    rows = []
    for name, label in _LABELS.items():
        constant = getattr(estimate, name)
        factor, unit = (1.0, "-") if name == "poisson_ratio" else modulus_unit(constant.value)
        values = constant_text(constant, factor=factor), interval_text(constant, factor=factor)
        rows.append((label, *values, unit, "yes" if estimate.identifiable[name] else "no"))
    columns = ("constant", "value ± 1 sigma", "95 % interval", "unit", "identifiable")
    caption = " ".join(_captions(estimate))
    return terminal_table("Elastic constants", columns, rows, caption=caption)


def _captions(estimate: Estimate) -> list[str]:
    """What the intervals hold beside noise, in sentences."""
    found = []
    if assumed := len(estimate.settings.get("assumed_forces", ())):
        share = estimate.settings["errors"]["force"]
        found.append(
            f"The force of {assumed} of {len(estimate.probes)} probings is taken as known to"
            f" {100 * share:.2g} % of its length, for no force_std is given."
        )
    lengths = estimate.settings.get("lengths", {})
    if "rig_covariance" in lengths.get("source", ""):
        along = ", ".join(f"{100 * std:.2g} %" for std in lengths["std"])
        found.append(f"Lengths are known by the cameras' calibration to {along} along x, y, z.")
    every = [*estimate.errors, *(one for probe in estimate.probes for one in probe.errors)]
    if every:
        worst = max(every, key=lambda one: abs(one.value) / one.prior_std)
        value, std, prior = error_texts(worst)
        found.append(
            "Errors of force, contact, pose and scale are in the intervals; farthest off is the"
            f" {worst.name}, by {value} ± {std} (taken for possible: {prior})."
        )
    return found


def probes_table(estimate: Estimate) -> Table:
    """Each probing alone: its constants, what was used of it, how well it was explained.

    Parameters
    ----------
    estimate : Estimate             with probings

    Returns
    -------
    Table                           moduli in a unit of fitting size, residuals in mm
    """
    factor, unit = modulus_unit(estimate.young_modulus.value)
    rows = [
        (
            probe.name, constant_text(probe.poisson_ratio),
            value_text(probe.shear_modulus, factor=factor),
            constant_text(probe.young_modulus, factor=factor), str(probe.observed),
            str(probe.missing), str(probe.rejected), _millimetres(probe.rms_residual),
            _millimetres(probe.prediction_error),
        )
        for probe in estimate.probes
    ]  # fmt: skip
    return terminal_table(
        f"Each probing alone (moduli in {unit}, residuals in mm)",
        ("probing", "nu", "G", "E", "seen", "nan", "off", "rms", "left out"),
        rows,
        caption="seen: points; nan: of them not measured; off: outliers left aside; rms: residual"
        " of the joint estimate; left out: residual of the prediction from the other probings",
    )


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
    return " ".join(f"{_SHORT.get(cause, cause)}:{count}" for count, cause in found) or "none"


def _millimetres(metres: float | None) -> str:
    """A residual, or a dash where there is none."""
    return number_text(None if metres is None else 1e3 * metres, ".3g")
