"""Figure of the best places for further probings."""

from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure

from palpate.figures.displacement import CLAY, HELD, SurfaceView, make_view
from palpate.figures.style import (
    INK,
    ORANGE,
    add_colour_bar,
    add_texts,
    styled,
    three_panels,
    title_panel,
)
from palpate.pipeline import NextProbings

# Viewing directions, all from slightly above.
_SIDES = ((0.45, -0.75, 0.48), (0.5, 0.75, 0.43), (-0.85, -0.1, 0.52))
_TITLES = ("from the front", "from behind", "from the left")
# Least cosine between outward direction and view of a place that is drawn.
_FRONT = 0.15
_MAP = "viridis"


@styled
def next_probings_figure(name: str, found: NextProbings) -> Figure:
    """Three views of the object with the candidate places; the best ones are numbered.

    Parameters
    ----------
    name : str                      heading
    found : NextProbings

    Returns
    -------
    Figure
    """
    mesh = found.session.mesh
    views = [make_view(mesh, np.array(side) / np.linalg.norm(side)) for side in _SIDES]
    corners = np.concatenate([1e3 * view.polygons.reshape(-1, 2) for view in views])
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.06 * float((high - low).max())
    figure, panels = three_panels(high - low + 2 * margin)
    gain = _gain(found)
    norm = Normalize(0.0, max(float(gain.max(initial=0.0)), 1.0))
    for axes, view, title in zip(panels, views, _TITLES, strict=True):
        axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
        axes.set_aspect("equal")
        _draw(axes, view, found)
        _mark(axes, view, found, gain, norm)
        title_panel(axes, title)
    add_colour_bar(figure, panels, _MAP, norm, "one push there narrows the interval of nu by [%]")
    held = np.isin(np.concatenate([one.triangle for one in views]), found.session.held_triangles)
    note = "grey: held" if held.any() else ""
    add_texts(figure, name, "crosses: measured; rings: push here, in this order", note)
    return figure


def _gain(found: NextProbings) -> np.ndarray:
    """Relative reduction of the interval of nu by a push at each place alone [%]."""
    now = found.now["poisson_ratio"]
    after = np.array([one["poisson_ratio"] for one in found.alone])
    if not np.isfinite(now):
        now = float(np.max(after[np.isfinite(after)], initial=1.0))
    return 100.0 * np.clip(1.0 - np.where(np.isfinite(after), after, now) / now, 0.0, 1.0)


def _draw(axes: Axes, view: SurfaceView, found: NextProbings) -> None:
    colours = CLAY(view.brightness)
    held = np.isin(view.triangle, found.session.held_triangles)
    colours[held, :3] = (0.75 + 0.25 * view.brightness[held, None]) * np.array(to_rgb(HELD))
    polygons = PolyCollection(
        cast(Any, 1e3 * view.polygons), facecolors=colours, edgecolors=colours, linewidths=0.3
    )
    axes.add_collection(polygons, autolim=False)


def _mark(
    axes: Axes, view: SurfaceView, found: NextProbings, gain: np.ndarray, norm: Normalize
) -> None:
    """Draw candidate, chosen and existing contact points on the near side."""
    turn = view.R_view_object
    # A place whose outward normal faces the viewer is on the near side of a convex body, and of
    # most others.
    front = -found.inward @ turn[2] > _FRONT
    place = 1e3 * (found.point @ turn.T)
    axes.scatter(
        place[front, 0], place[front, 1], c=gain[front], cmap=_MAP, norm=norm, s=22,
        linewidths=0.3, edgecolors=INK, zorder=3,
    )  # fmt: skip
    for number, k in enumerate(found.chosen, start=1):
        if front[k]:
            axes.plot(*place[k, :2], "o", mfc="none", mec=ORANGE, mew=1.6, ms=9, zorder=4)
            axes.annotate(
                str(number), place[k, :2], (6, 4), textcoords="offset points", color=ORANGE,
                weight="bold", zorder=5,
            )  # fmt: skip
    measured = np.array([one.contact.point for one in found.session.probings])
    pushed = np.array([one.force for one in found.session.probings])
    length = np.maximum(np.linalg.norm(pushed, axis=1), np.finfo(float).tiny)
    seen = -(pushed / length[:, None]) @ turn[2] > _FRONT
    crosses = 1e3 * (measured @ turn.T)[seen]
    axes.plot(crosses[:, 0], crosses[:, 1], "x", color=INK, markersize=5, mew=1.2, zorder=4)
