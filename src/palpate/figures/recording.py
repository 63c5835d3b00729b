"""Figure of a recording over time: force, motion, plateaus and moments at rest."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from palpate.figures.style import (
    BLUE,
    GREY,
    INK,
    MIDDLE_BLUE,
    ORANGE,
    PALE_BLUE,
    open_frame,
    styled,
)
from palpate.recording import Recorded

# Largest number of points of a line: more than 8 inches show at 150 dpi.
_POINTS = 4000


@styled
def recording_figure(found: Recorded, name: str) -> Figure:
    """Force and motion over the whole recording, with plateaus and moments at rest.

    Parameters
    ----------
    found : Recorded
    name : str                      of the session, for the heading

    Returns
    -------
    Figure
    """
    rows = 1 + len(found.motions)
    figure = Figure(figsize=(8.4, 2.3 + 0.85 * len(found.motions)), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=True, height_ratios=[2.2, *[1.0] * (rows - 1)])
    axes = np.atleast_1d(axes)
    _draw_force(axes[0], found)
    for panel, motion, clock in zip(axes[1:], found.motions, found.clocks, strict=True):
        time = motion.time + clock.offset
        every = max(1, len(time) // _POINTS)
        panel.plot(time[::every], motion.change[::every], color=BLUE, linewidth=0.7)
        text = f"{1e3 * clock.std:.1f} ms" if np.isfinite(clock.std) else "unknown"
        accuracy = "told" if clock.given else f"± {text}"
        panel.annotate(
            f"{motion.camera}: clock {clock.offset:+.4f} s, {accuracy}", (0.005, 0.97),
            xycoords="axes fraction", va="top", fontsize=6.5, parse_math=False,
        )  # fmt: skip
        panel.set_ylim(0.0, 1.35 * float(motion.change.max()))
        panel.set_yticks([])
        panel.set_ylabel("picture's\nchange")
    for panel in axes:
        _draw_moments(panel, found)
        open_frame(panel)
    axes[-1].set_xlabel("time of the force log [s]")
    axes[-1].set_xlim(found.resampled.time[0], found.resampled.time[-1])
    figure.legend(handles=_keys(found), loc="outside lower center", ncols=4)
    kept, all_of = len(found.presses), len(found.touches)
    figure.suptitle(
        f"{name}: {kept} of {all_of} presses", fontsize=9, weight="bold", parse_math=False
    )
    return figure


def _keys(found: Recorded) -> list[Artist]:
    """Legend of the colours."""
    keys: list[Artist] = [
        Patch(color=MIDDLE_BLUE, alpha=0.7, label="picture at rest"),
        Patch(color=PALE_BLUE, label="plateau: nothing moves"),
        Line2D([], [], color=ORANGE, linewidth=2.0, label="force that is read"),
    ]
    if len(found.presses) < len(found.touches):
        keys.append(Patch(color=GREY, alpha=0.35, label="left out"))
    return keys


def _draw_force(axes: Axes, found: Recorded) -> None:
    """Draw the magnitude of the force without weight and drift, and the reading of each press."""
    even = found.resampled
    size = np.linalg.norm(even.force - found.zero.at(even.time), axis=1)
    every = max(1, len(size) // _POINTS)
    axes.plot(even.time[::every], size[::every], color=INK, linewidth=0.7)
    for press in found.presses:
        reading = press.reading
        force = float(np.linalg.norm(reading.force))
        axes.plot([reading.begin, reading.end], [force, force], color=ORANGE, linewidth=2.0)
        axes.annotate(
            press.name, (reading.time, force), (0.0, 4.0), textcoords="offset points",
            ha="center", fontsize=6.5, parse_math=False,
        )  # fmt: skip
    axes.set_ylim(0.0, 1.15 * float(np.nanmax(size)))
    axes.set_ylabel("force [N]")


def _draw_moments(axes: Axes, found: Recorded) -> None:
    """Draw plateaus and moments at rest as bands, and touches that are left out in grey."""
    kept = {press.number for press in found.presses}
    for number, touch in enumerate(found.touches, start=1):
        if number not in kept:
            axes.axvspan(touch.begin, touch.end, color=GREY, alpha=0.35, linewidth=0)
    for press in found.presses:
        axes.axvspan(press.reading.begin, press.reading.end, color=PALE_BLUE, linewidth=0, zorder=0)
        axes.axvspan(*press.rest, color=MIDDLE_BLUE, alpha=0.7, linewidth=0, zorder=0)
