"""Summary figure of a campaign: both constants of every session with their intervals."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from palpate.campaign.rows import FAILED, Row, groups_of, outliers
from palpate.figures import BLUE, GREY, INK, ORANGE, open_frame, styled
from palpate.records import modulus_unit

# Largest numbers of sessions and of outliers whose names are shown.
_MAX_NAMES, _MAX_OUTLIERS = 30, 12
# Ratio of the largest to the smallest value beyond which the scale is logarithmic.
_LOG_SCALE_RATIO = 4.0


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
        place = [k for k, _ in chosen]
        value, low, high = (
            np.array([getattr(row, f"{name}{end}") for _, row in chosen], dtype=float) / factor
            for end in ("", "_low", "_high")
        )
        axes.errorbar(
            place, value, [value - low, high - value], fmt="o", markersize=2.6, color=colour,
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
