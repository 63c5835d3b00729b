"""The table of measured motions on the terminal."""

import math
import statistics
from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from palpate.pipeline import MotionFigures
from palpate.records import Rig, length_unit

_SHORT = {"reprojection": "reproj.", "neighbours": "neighb."}


def flow_table(figures: Sequence[MotionFigures], rig: Rig) -> Table:
    """A line for every motion: points, rejected by cause, sigma, noise, reprojection error."""
    factor, unit = length_unit(_median([f.depth for f in figures]))
    table = Table(
        title="Measured motion", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False,
        caption_justify="left",
    )  # fmt: skip
    table.add_column("name", no_wrap=True, min_width=4)
    table.add_column("points", justify="right", no_wrap=True)
    table.add_column("valid\n%", justify="right", no_wrap=True)
    # On a narrow terminal these two take several lines; no cause with its count is longer.
    table.add_column("rejected", overflow="fold", min_width=13)
    table.add_column("noise\ngrey", overflow="fold", min_width=5)
    for heading in (f"1 sigma\n{unit}", "reproj.\npx", "vertices"):
        table.add_column(heading, justify="right", no_wrap=True)
    for f in figures:
        if f.points == 0:
            table.add_row(escape(f.name), "-", "-", "failed", "-", "-", "-", "-")
            continue
        table.add_row(
            escape(f.name),
            str(f.points),
            f"{100.0 * f.valid / f.points:.1f}",
            _causes(f),
            " ".join(f"{level:.1f}" if math.isfinite(level) else "-" for level in f.noise),
            f"{_number(f.lateral / factor, 2)}, {_number(f.depth / factor, 2)}",
            _number(f.reprojection, 2),
            f"{f.measured}/{f.vertices}",
        )
    cameras = escape(", ".join(camera.name for camera in rig.cameras))
    table.caption = (
        f"noise: of a pixel in {cameras}; 1 sigma: median over the valid points, across and along"
        " the axis of the reference camera; reproj.: median over them; vertices: with a"
        " displacement, of those looked at"
    )
    return table


def _causes(f: MotionFigures) -> str:
    """Causes and counts, the most frequent first."""
    found = [(count, cause) for cause, count in f.rejected.items() if count]
    found.sort(key=lambda item: -item[0])
    # Without a space, lest a line be broken between a cause and its count.
    return " ".join(f"{_SHORT.get(cause, cause)}:{count}" for count, cause in found) or "none"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else "-"


def _median(values: Sequence[float]) -> float:
    """Median of what is known; NaN of nothing."""
    known = [value for value in values if math.isfinite(value)]
    return statistics.median(known) if known else math.nan
