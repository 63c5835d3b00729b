"""A campaign's table, a row for every session: outliers, CSV and Parquet files, summary figure."""

import io
import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from palpate.arrays import STD_OVER_MEDIAN
from palpate.disk import write_bytes
from palpate.errors import InputError
from palpate.figures import BLUE, GREY, INK, ORANGE, open_frame, styled
from palpate.optional_imports import late_import
from palpate.records import CONSTANT_NAMES, HALF_95, Estimate, modulus_unit, spreadsheet_text

WAITING, DONE, FAILED = "waiting", "done", "failed"
# Bound on the modified z-score, which uses the median absolute deviation: Iglewicz and Hoaglin
# (1993), How to detect and handle outliers, section 3.3.
_OUTLIER_BOUND = 3.5
# In small groups the median absolute deviation is inaccurate, and z-scores above 3.5 are not rare:
# one in 80 of 12 normal values. With the bound raised by a factor of 1 + this over the group's size
# it is one in 370, and one in 90 for groups of 5 (simulated).
_SMALL_GROUP = 5.0
_MIN_GROUP_SIZE = 5
_OUTLIER = "outlier"
# Largest numbers of sessions and of outliers whose names are shown.
_MAX_NAMES, _MAX_OUTLIERS = 30, 12
# Ratio of the largest to the smallest value beyond which the scale is logarithmic.
_LOG_SCALE_RATIO = 4.0


@dataclass(frozen=True, slots=True)
class Row:
    """One session's row of the table; None means unknown.

    Attributes
    ----------
    session, group : str            as in `CampaignItem`
    state : "waiting", "done" or "failed"
    status : str or None            of the estimate, as in estimate.json
    shear_modulus, young_modulus : float or None [Pa]       None if the data do not determine it
    shear_modulus_low, shear_modulus_high, ... : float or None      ends of the 95 % interval
    poisson_ratio : float or None
    message : str                   why it failed, or the notes of the estimate
    seconds : float or None [s]     duration of the fit
    address : str                   digest of files, options and version, which names the result
    finished : str                  time of completion, UTC, ISO format
    """

    session: str
    group: str
    state: Literal["waiting", "done", "failed"] = "waiting"
    status: str | None = None
    shear_modulus: float | None = None
    shear_modulus_low: float | None = None
    shear_modulus_high: float | None = None
    poisson_ratio: float | None = None
    poisson_ratio_low: float | None = None
    poisson_ratio_high: float | None = None
    young_modulus: float | None = None
    young_modulus_low: float | None = None
    young_modulus_high: float | None = None
    message: str = ""
    seconds: float | None = None
    address: str = ""
    finished: str = ""


COLUMNS = tuple(field.name for field in fields(Row))


def constants_of(estimate: Estimate) -> dict[str, float | None]:
    """The constants of an estimate as fields of a row.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    dict                            value, `_low` and `_high` of every constant; None if unknown
    """
    constants: dict[str, float | None] = {}
    for name in CONSTANT_NAMES:
        constant = getattr(estimate, name)
        known = estimate.identifiable[name]
        constants[name] = _finite(constant.value) if known else None
        constants[f"{name}_low"], constants[f"{name}_high"] = map(_finite, constant.ci95)
    return constants


def outliers(rows: Sequence[Row]) -> dict[str, tuple[str, ...]]:
    """Sessions with a constant that is an outlier of its group, relative to the group's scatter
    combined with the constant's own interval.

    Parameters
    ----------
    rows : sequence of Row

    Returns
    -------
    dict of str to tuple of str     session -> its outlying constants, `young_modulus` or
                                    `poisson_ratio`; groups of fewer than five have no outliers

    Source
    ------
    Iglewicz and Hoaglin (1993), How to detect and handle outliers, section 3.3
    """
    outlying: dict[str, list[str]] = {}
    for group in groups_of(rows):
        for name in ("young_modulus", "poisson_ratio"):
            complete = [row for row in rows if row.group == group and _is_complete(row, name)]
            if len(complete) >= _MIN_GROUP_SIZE:
                for row, is_outlier in zip(complete, _are_outliers(complete, name), strict=True):
                    if is_outlier:
                        outlying.setdefault(row.session, []).append(name)
    return {session: tuple(names) for session, names in outlying.items()}


def groups_of(rows: Sequence[Row]) -> tuple[str, ...]:
    """Names of the groups, in the order of their first sessions.

    Parameters
    ----------
    rows : sequence of Row

    Returns
    -------
    tuple of str
    """
    return tuple(dict.fromkeys(row.group for row in rows))


def _is_complete(row: Row, name: str) -> bool:
    return all(getattr(row, f"{name}{end}") is not None for end in ("", "_low", "_high"))


def _are_outliers(rows: Sequence[Row], name: str) -> list[bool]:
    """Whether each value of a constant is an outlier; moduli are compared by their logarithms."""
    value, low, high = (
        np.array([getattr(row, f"{name}{end}") for row in rows]) for end in ("", "_low", "_high")
    )
    if name != "poisson_ratio":
        value, low, high = np.log(value), np.log(low), np.log(high)
    deviation = value - np.median(value)
    spread = STD_OVER_MEDIAN * np.median(np.abs(deviation))
    # Of a skewed interval take the side that faces the median.
    own_std: Float[np.ndarray, " n"] = np.where(deviation > 0, value - low, high - value) / HALF_95
    bound = _OUTLIER_BOUND * (1.0 + _SMALL_GROUP / len(rows))
    return (np.abs(deviation) > bound * np.hypot(spread, own_std)).tolist()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write a table, whose last column names the constants that make a session an outlier.

    Parameters
    ----------
    path : Path                     with suffix .csv or .parquet; an existing file is replaced
    rows : sequence of Row

    Raises
    ------
    InputError                      another suffix; the package for Parquet is not installed
    RecordError                     the file cannot be written
    """
    if path.suffix == ".csv":
        write_bytes(path, table_text(rows).encode())
    elif path.suffix == ".parquet":
        write_bytes(path, _parquet(rows))
    else:
        raise InputError(f"{path}: ends in '{path.suffix}'; a table is a .csv or a .parquet file")


def table_text(rows: Sequence[Row]) -> str:
    """A table as CSV text; unknown values are empty.

    Parameters
    ----------
    rows : sequence of Row

    Returns
    -------
    str
    """
    outlying = outliers(rows)
    cells = ((*astuple(row), " ".join(outlying.get(row.session, ()))) for row in rows)
    return spreadsheet_text([(*COLUMNS, _OUTLIER), *cells])


def _parquet(rows: Sequence[Row]) -> bytes:
    arrow = late_import("pyarrow", extra="parquet", purpose="a table in Parquet")
    parquet = late_import("pyarrow.parquet", extra="parquet", purpose="a table in Parquet")
    outlying = outliers(rows)
    columns = {name: [getattr(row, name) for row in rows] for name in COLUMNS}
    columns[_OUTLIER] = [" ".join(outlying.get(row.session, ())) for row in rows]
    content = io.BytesIO()
    parquet.write_table(arrow.table(columns), content)
    return content.getvalue()


@styled
def campaign_figure(rows: Sequence[Row], title: str) -> Figure:
    """Young's modulus and Poisson's ratio of all sessions, group by group.

    Parameters
    ----------
    rows : sequence of Row
    title : str                     plain text, without markup

    Returns
    -------
    Figure                          two panels, one above the other; outliers in another colour with
                                    their names, the median of each group as a line, a cross for
                                    each session that failed
    """
    ordered = [row for group in groups_of(rows) for row in rows if row.group == group]
    known = [row.young_modulus for row in rows if row.young_modulus is not None]
    factor, unit = modulus_unit(float(np.median(known)) if known else 1.0)
    figure = Figure(figsize=(min(max(6.0, 0.06 * len(rows)), 14.0), 5.2), layout="constrained")
    upper, lower = figure.subplots(2, sharex=True)
    outlying = outliers(rows)
    panels = (
        (upper, "young_modulus", f"Young's modulus E / {unit}", factor),
        (lower, "poisson_ratio", "Poisson's ratio nu", 1.0),
    )
    for axes, name, label, scale in panels:
        _draw(axes, ordered, name, scale, {s for s, names in outlying.items() if name in names})
        axes.set_ylabel(label)
        open_frame(axes)
    _mark_groups(upper, lower, ordered)
    failed = sum(row.state == FAILED for row in rows)
    text = f"{title}: {len(rows)} sessions" + (f", {failed} without a result" if failed else "")
    upper.set_title(text, loc="left", parse_math=False, pad=18 if any(groups_of(rows)) else 6)
    return figure


def _draw(axes: Axes, rows: Sequence[Row], name: str, factor: float, outlying: set[str]) -> None:
    """Draw one constant of all sessions, with a gap where it is unknown."""
    for colour, is_outlier in ((BLUE, False), (ORANGE, True)):
        chosen = [
            (k, row)
            for k, row in enumerate(rows)
            if getattr(row, name) is not None and (row.session in outlying) == is_outlier
        ]
        if not chosen:
            continue
        position = [k for k, _ in chosen]
        value, low, high = (
            np.array([getattr(row, f"{name}{end}") for _, row in chosen], dtype=float) / factor
            for end in ("", "_low", "_high")
        )
        axes.errorbar(
            position, value, [value - low, high - value], fmt="o", markersize=2.6, color=colour,
            elinewidth=0.8, zorder=3 if is_outlier else 2,
        )  # fmt: skip
        for (k, row), y in (
            list(zip(chosen, value, strict=True))[:_MAX_OUTLIERS] if is_outlier else ()
        ):
            axes.annotate(
                row.session, (k, y), (5, 0), textcoords="offset points", va="center", fontsize=6.5,
                color=ORANGE, parse_math=False,
            )  # fmt: skip
    for begin, end, members in _spans(rows):
        values = [v for row in members if (v := getattr(row, name)) is not None]
        if len(values) > 2:
            middle = float(np.median(values)) / factor
            axes.plot([begin - 0.4, end - 0.6], [middle, middle], color=INK, lw=0.7, zorder=1)
    failed = [k for k, row in enumerate(rows) if row.state == FAILED]
    axes.plot(
        failed,
        [0.02] * len(failed),
        "x",
        color=GREY,
        markersize=4,
        transform=axes.get_xaxis_transform(),
    )
    _set_scale(axes, [v for row in rows if (v := getattr(row, name)) is not None])


def _set_scale(axes: Axes, values: Sequence[float]) -> None:
    """Set the scale of the ordinate, logarithmic if the values differ by a large factor."""
    if values and 0.0 < _LOG_SCALE_RATIO * min(values) < max(values):
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.yaxis.set_major_locator(MaxNLocator(6))


def _spans(rows: Sequence[Row]) -> list[tuple[int, int, list[Row]]]:
    """First index, one past the last index, and the rows of each group."""
    spans, begin = [], 0
    for group in groups_of(rows):
        members = [row for row in rows if row.group == group]
        spans.append((begin, begin + len(members), members))
        begin += len(members)
    return spans


def _mark_groups(upper: Axes, lower: Axes, rows: Sequence[Row]) -> None:
    """Draw group names at the top, session names at the bottom, and lines between groups."""
    for begin, end, members in _spans(rows):
        upper.annotate(
            members[0].group, (0.5 * (begin + end - 1), 1.0), (0, 3),
            xycoords=("data", "axes fraction"), textcoords="offset points", ha="center",
            fontsize=7.5, annotation_clip=False, parse_math=False,
        )  # fmt: skip
        for axes in (upper, lower) if begin else ():
            axes.axvline(begin - 0.5, color=GREY, lw=0.5, ls=":")
    lower.set_xlim(-0.8, len(rows) - 0.2)
    if len(rows) <= _MAX_NAMES:
        lower.set_xticks(range(len(rows)))
        names = [row.session.removeprefix(f"{row.group}/") for row in rows]
        lower.set_xticklabels(names, rotation=60, ha="right", fontsize=6.5, parse_math=False)
    else:
        lower.set_xlabel("session, group by group")
