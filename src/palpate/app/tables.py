"""Tables for the terminal: one way to build them, and those of an estimate and of a flow.

They fit any terminal: where columns have no room, they go on below.
"""

import math
import re
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from palpate.errors import counted, visible
from palpate.estimation import Prediction
from palpate.lab import Material
from palpate.pipeline import MotionFigures
from palpate.records import (
    HALF_95,
    BudgetEntry,
    Estimate,
    ProbeEstimate,
    RelaxationEstimate,
    Rig,
    budget_text,
    constant_row,
    constant_text,
    error_texts,
    law_rows,
    length_unit,
    modulus_unit,
    region_row,
    relaxation_rows,
    value_text,
)

_LABELS = {
    "shear_modulus": "shear modulus G",
    "poisson_ratio": "Poisson's ratio nu",
    "young_modulus": "Young's modulus E",
}
_SHORT_CAUSES = {"reprojection": "reproj.", "neighbours": "neighb."}
# Headings go on in the next line where there is no room, but are not squeezed to less than this.
_HEADING_WIDTH = 7
# A cell that begins like this makes its column one of words, which are set to the left.
_WORD = re.compile(r"(?!unknown|nan|inf|not determined)[A-Za-z\[]")
# Words may go on in the next line, but not be squeezed to less, nor names to less than that.
_WORDS_WIDTH, _NAMES_WIDTH = 16, 32
# What stands beside every column, and at the end.
_COLUMN_PADDING, _FRAME_WIDTH = 2, 1


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
    rows += law_rows(estimate)
    columns = ("constant", "value ± 1 sigma", "95 % interval", "unit")
    caption = " ".join(_captions(estimate))
    return terminal_table("Elastic constants", columns, rows, caption=caption)


def truth_text(estimate: Estimate, true: Material) -> str:
    """Constants of a virtual specimen, and whether the intervals hold them.

    Parameters
    ----------
    estimate : Estimate
    true : Material
    """
    factor, unit = modulus_unit(true.young_modulus)
    shown = (
        f"G = {true.shear_modulus / factor:.4g} {unit}, nu = {true.poisson_ratio:.4g},"
        f" E = {true.young_modulus / factor:.4g} {unit}"
    )
    stated = f"The truth of this virtual bench: {shown}"
    if estimate.field is not None and not estimate.field.is_of_parts:
        return f"{stated}, before any part of another modulus; the constants above are means."
    outside = []
    for name, label in _LABELS.items():
        low, high = getattr(estimate, name).ci95
        if not low <= getattr(true, name) <= high:
            outside.append(label)
    verdict = f"outside its interval: {', '.join(outside)}" if outside else "all within"
    return f"{stated}; {verdict}."


def regions_table(estimate: Estimate) -> Table:
    """The regions with their moduli and intervals.

    Parameters
    ----------
    estimate : Estimate             with regions
    """
    columns = ("region", "G ± 1 sigma", "E ± 1 sigma", "95 % interval of E", "ratio to the rest")
    caption = "The constants above are those of the rest, Poisson's ratio that of all."
    rows = map(region_row, estimate.regions)
    return terminal_table("Regions", columns, rows, caption=caption)


def relaxation_table(relaxation: RelaxationEstimate) -> Table:
    """The modulus as a function of time.

    Parameters
    ----------
    relaxation : RelaxationEstimate
    """
    shown = (
        f"The constants above are those at {relaxation.age:.3g} s after contact; the window is"
        f" {relaxation.rise:.2g} to {relaxation.hold:.3g} s."
    )
    columns = ("modulus over time", "value ± 1 sigma", "95 % interval", "unit")
    rows = relaxation_rows(relaxation)
    return terminal_table(
        "Relaxation", columns, rows, caption=" ".join([shown, *relaxation.remarks])
    )


def held_out_table(predictions: Sequence[Prediction], sizes: Mapping[str, float]) -> Table:
    """Predictions of probings that were not fitted, against what was measured.

    Parameters
    ----------
    predictions : sequence of Prediction
    sizes : mapping                 `FitResult.error_sizes`
    """
    rows = []
    for prediction in predictions:
        known = np.isfinite(prediction.measured)
        off, moved = (
            values[known]
            for values in (prediction.predicted - prediction.measured, prediction.measured)
        )
        size = float(np.sqrt(np.square(moved).sum()))
        error = float(np.sqrt(np.square(off).sum())) / size if size else math.nan
        sigma = np.hypot(prediction.std, prediction.noise)[known]
        inside = np.abs(off) < HALF_95 * sigma
        share = float(inside.mean()) if inside.size else math.nan
        rows.append(
            (prediction.name, number_text(100 * error, ".2f"), number_text(100 * share, ".0f"))
        )
    columns = ("probing", "error, rms (%)", "within 95 % (%)")
    caption = (
        "Error: with the noise and the outliers of what was measured. Within: of the measured"
        " displacements, by intervals of prediction and noise together."
    )
    if sizes:
        caption += (
            " Errors of a probing are taken to be as large as in those fitted, over what the"
            " session says of them:"
            f" {', '.join(f'{source} {size:.2g}' for source, size in sizes.items())}."
        )
    return terminal_table("Probings held out", columns, rows, caption=caption)


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


class ShownTable(Table):
    """A table of `terminal_table` that remembers its cells as they came.

    Parameters
    ----------
    heading : str
    names : sequence of str             of the columns; the first column holds names
    cells : list of lists of str        rows
    below : str                         a caption
    total : bool                        the last row stands apart

    Attributes
    ----------
    heading, names, cells, below        as given
    """

    def __init__(
        self,
        heading: str,
        names: Sequence[str],
        cells: list[list[str]],
        below: str,
        *,
        total: bool = False,
    ) -> None:
        super().__init__(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        self.heading, self.names, self.cells, self.below = heading, list(names), cells, below
        self.total = total
        for k, name in enumerate(names):
            self.add_column(
                escape(name), justify="left" if self._has_words(k) else "right", overflow="fold"
            )
        for k, row in enumerate(cells):
            if total and k == len(cells) - 1:
                self.add_section()
            self.add_row(*map(escape, row))

    def _has_words(self, column: int) -> bool:
        return column == 0 or any(_WORD.match(row[column]) for row in self.cells)

    def _min_width(self, column: int) -> int:
        """Width that breaks no number, no word, and no name of usual length."""
        cells = [row[column] for row in self.cells]
        head = min(_HEADING_WIDTH, _longest(self.names[column].split()))
        longest_cell = _longest(cells)
        if column == 0:
            return max(head, min(longest_cell, _NAMES_WIDTH))
        if not self._has_words(column):
            return max(head, longest_cell)
        longest_word = _longest(word for cell in cells for word in cell.split())
        return max(head, longest_word, min(longest_cell, _WORDS_WIDTH))

    def _widths(self, room: int) -> list[int]:
        """Widths of the columns: the least, then as far as there is room whole cells, whole words
        in the headings, whole headings."""
        indices = range(len(self.names))
        widths = [self._min_width(k) for k in indices]
        while sum(widths) > max(room, len(widths)):
            # Words and names are broken sooner than numbers.
            widest = max(indices, key=lambda k: (self._has_words(k) and widths[k] > 1, widths[k]))
            widths[widest] -= 1
        for wanted in (
            [_longest(row[k] for row in self.cells) for k in indices],
            [_longest(name.split()) for name in self.names],
            [len(name) for name in self.names],
        ):
            for k in sorted(indices, key=lambda k: wanted[k] - widths[k]):
                widths[k] += max(min(wanted[k] - widths[k], room - sum(widths)), 0)
        return widths

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Any]:
        """The table, split into as many as it takes to fit the width of the terminal."""
        parts = self._parts(options.max_width)
        # Above and below a narrow table there is more room than in it.
        if self.heading:
            yield Text(self.heading, style="table.title")
        if len(parts) == 1:
            room = options.max_width - _FRAME_WIDTH - _COLUMN_PADDING * len(self.names)
            for column, width in zip(self.columns, self._widths(room), strict=True):
                column.width = width
            yield from super().__rich_console__(console, options)
        else:
            for part in parts:
                shown = [0, *part]
                cells = [[row[k] for k in shown] for row in self.cells]
                names = [self.names[k] for k in shown]
                yield ShownTable("", names, cells, "", total=self.total)
        if self.below:
            yield Text(self.below, style="table.caption")

    def _parts(self, width: int) -> list[list[int]]:
        """Columns other than the names, divided evenly into parts that fit the width."""
        needed = [self._min_width(k) + _COLUMN_PADDING for k in range(len(self.names))]
        room = max(width - _FRAME_WIDTH - needed[0], 1)
        indices = range(1, len(self.names))
        parts = _split_columns(indices, needed, room)
        # The least room that takes no more parts spreads the columns evenly.
        while len(parts) > 1 and room > max(needed[1:]):
            tighter = _split_columns(indices, needed, room - 1)
            if len(tighter) > len(parts):
                break
            parts, room = tighter, room - 1
        return parts


def _captions(estimate: Estimate) -> list[str]:
    """What the intervals include besides noise, in sentences."""
    sentences = []
    if assumed := len(estimate.settings.get("assumed_forces", ())):
        fraction = estimate.settings["errors"]["force"]
        sentences.append(
            f"The force of {assumed} of {counted(len(estimate.probes), 'probing')} is assumed known"
            f" to {100 * fraction:.2g} % (no force_std given)."
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


def _causes(f: MotionFigures) -> str:
    """Causes and counts, the most frequent first."""
    causes = sorted(((n, cause) for cause, n in f.rejected.items() if n), key=lambda x: -x[0])
    # Without a space, lest a line be broken between a cause and its count.
    return (
        " ".join(f"{_SHORT_CAUSES.get(cause, cause)}:{count}" for count, cause in causes) or "none"
    )


def _millimetres(metres: float | None) -> str:
    """A residual, or a dash where there is none."""
    return number_text(None if metres is None else 1e3 * metres, ".3g")


def _longest(words: Iterable[str]) -> int:
    """Characters of the longest."""
    return max(map(len, words), default=0)


def _split_columns(columns: Sequence[int], needed: Sequence[int], room: int) -> list[list[int]]:
    """Columns divided into parts, each as full as the width allows."""
    parts, used = [list[int]()], 0
    for k in columns:
        if parts[-1] and used + needed[k] > room:
            parts.append([])
            used = 0
        parts[-1].append(k)
        used += needed[k]
    return parts
