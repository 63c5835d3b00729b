"""Pictures of one measured motion as the reference camera sees it.

`flow_figure` is the paper's figure 3 (optical flow, range flow, displacement of the vertices, each
shaded on the picture); `quality_figure` shows where points were rejected, why, and how sure the
others are.
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from palpate.figures.estimate import STYLE
from palpate.figures.flow_view import (
    FlowView,
    cause_layer,
    in_view,
    interpolated,
    tinted,
    vertex_layer,
)
from palpate.records import length_unit
from palpate.shapes import Points, PointScalars
from palpate.vision import (
    Outcome,
    RangeFlow,
    VertexDisplacement,
    camera_sigma,
    cause_counts,
    is_valid,
    measured_vertices,
    project,
)

PANEL = 2.7  # inches
LONG_ARROW = 0.12  # of a panel's longer side: an arrow that one in twenty exceeds
LONGEST_ARROW = 0.2  # of it, but for one in two hundred
SHORT_ARROW = 0.012  # of it: a shorter one would be a blot
ARROWS_ACROSS = 11  # more would hide the colours
# Okabe and Ito's palette: told apart by colour-blind readers.
CAUSE_COLOURS = {
    int(Outcome.HIDDEN): "#0072B2",
    int(Outcome.TEXTURE): "#E69F00",
    int(Outcome.OUTSIDE): "#56B4E9",
    int(Outcome.LOST): "#009E73",
    int(Outcome.SCORE): "#D55E00",
    int(Outcome.REPROJECTION): "#CC79A7",
    int(Outcome.NEIGHBOURS): "#F0E442",
}
# None of them is grey anywhere: grey is what has no value.
_OPTICAL, _LENGTH, _SIGMA = "plasma", "viridis", "magma"
_UNKNOWN = 1e30  # end of a scale that has nothing on it


def write_flow_pictures(
    folder: Path,
    stem: str,
    name: str,
    flow: RangeFlow,
    vertices: VertexDisplacement | None,
    view: FlowView,
) -> tuple[str, str]:
    """Write STEM.png and STEM_quality.png.

    Parameters
    ----------
    folder : Path                   exists
    stem : str                      file name without ending
    name, flow, vertices, view      see `flow_figure`

    Returns
    -------
    tuple of two str                the names of the files

    Raises
    ------
    OSError                         a file cannot be written
    """
    names = (f"{stem}.png", f"{stem}_quality.png")
    with mpl.rc_context(STYLE):
        figures = (
            flow_figure(name, flow, vertices, view),
            quality_figure(name, flow, view),
        )
        for file, figure in zip(names, figures, strict=True):
            # The usual level of compression, 6, takes as long as drawing.
            figure.savefig(folder / file, pil_kwargs={"compress_level": 2})
    return names


def flow_figure(
    name: str,
    flow: RangeFlow,
    vertices: VertexDisplacement | None,
    view: FlowView,
) -> Figure:
    """Optical flow, range flow and displacement of the vertices, side by side.

    Colour is the length of a motion; where nothing was measured the picture stays grey. Arrows are
    drawn at some points, longer than they are, by a factor that is given.

    Parameters
    ----------
    name : str
    flow : RangeFlow
    vertices : VertexDisplacement or None
    view : FlowView
    """
    optical = project(view.camera, flow.point + flow.displacement) - project(
        view.camera, flow.point
    )
    shift, length = (np.linalg.norm(moved, axis=1) for moved in (optical, flow.displacement))
    pixels, metres = _quantile(shift, 0.99), _quantile(length, 0.99)
    figure, panels = _layout(view)
    _image(panels[0], view, f"2-D optical flow in {view.camera.name}",
           tinted(interpolated(flow, shift, view), view, _OPTICAL, _root(pixels)))  # fmt: skip
    _image(
        panels[1],
        view,
        "range flow",
        tinted(interpolated(flow, length, view), view, _LENGTH, _root(metres)),
    )
    _image(panels[2], view, "displacement of the vertices",
           vertex_layer(vertices, view, _LENGTH, _root(metres)))  # fmt: skip
    across = float((view.high - view.low).max()) * _stretch(shift)
    along = _size_there(view) * _stretch(length)
    _arrows(panels[0], view, project(view.camera, flow.point), across * optical)
    _arrows_in_space(panels[1], view, flow.point, along * flow.displacement)
    if vertices is not None:
        _dots(panels[2], view, vertices, _root(metres))
        corner = view.mesh.vertices[in_view(view)]
        motion = vertices.displacement[in_view(view)]
        _arrows_in_space(panels[2], view, corner, along * motion)
    factor, unit = length_unit(metres)
    _bar(figure, panels[:1], _OPTICAL, _root(pixels), "motion in the picture (px)")
    _bar(figure, panels[1:], _LENGTH, _root(metres / factor), f"displacement $|u|$ ({unit})")
    drawn = f"colours: square-root scale; arrows: {_times(across)} the motion, {_times(along)} |u|"
    drawn = drawn if is_valid(flow).any() else ""
    known = 0 if vertices is None else int(measured_vertices(vertices)[in_view(view)].sum())
    title = f"{name}: {_counts(flow)}, {known} of {len(in_view(view))} vertices measured"
    _texts(figure, title, drawn, _rejected(flow))
    return figure


def quality_figure(name: str, flow: RangeFlow, view: FlowView) -> Figure:
    """Why points were rejected, and the standard deviation of the others across and along the axis.

    Parameters
    ----------
    name : str
    flow : RangeFlow
    view : FlowView
    """
    figure, panels = _layout(view)
    _image(panels[0], view, "rejected, and why", cause_layer(flow, view, CAUSE_COLOURS))
    _legend(figure, panels[0], flow)
    titles = ("1 sigma across the view", "1 sigma in depth")
    sigmas = camera_sigma(flow.covariance, view.camera)
    for axes, sigma, title in zip(panels[1:], sigmas, titles, strict=True):
        high = _quantile(sigma, 0.95)
        layer = tinted(interpolated(flow, sigma, view), view, _SIGMA, Normalize(0.0, high))
        _image(axes, view, title, layer)
        factor, unit = length_unit(high)
        said = f"of one point ({unit}), median {_quantile(sigma, 0.5) / factor:.3g}"
        _bar(figure, [axes], _SIGMA, Normalize(0.0, high / factor), said)
    window = f"window of {flow.subset} px, a point every {flow.step} px"
    _texts(figure, f"{name}: {_counts(flow)}", f"seen by {view.camera.name}", window)
    return figure


def _quantile(values: PointScalars, share: float) -> float:
    """Quantile of what is known, above zero; `_UNKNOWN` where nothing is."""
    known = values[np.isfinite(values)]
    return max(float(np.quantile(known, share)), 1e-12) if len(known) else _UNKNOWN


def _root(top: float) -> Normalize:
    """A scale from zero that leaves room for small motions: they fall off fast from a contact."""
    return PowerNorm(0.5, vmin=0.0, vmax=top)


def _stretch(length: PointScalars) -> float:
    """Length of an arrow in panels, a unit of a motion."""
    usual, most = _quantile(length, 0.95), _quantile(length, 0.995)
    return min(LONG_ARROW / usual, LONGEST_ARROW / most)


def _times(factor: float) -> str:
    """A factor to two digits, never with an exponent."""
    return f"{factor:.2g} times" if factor < 10 else f"{factor:.0f} times"


def _counts(flow: RangeFlow) -> str:
    return f"{int(is_valid(flow).sum())} of {len(flow.outcome)} points valid"


def _rejected(flow: RangeFlow) -> str:
    count = len(flow.outcome) - int(is_valid(flow).sum())
    return f"grey: {count} points rejected, or nothing measured"


def _layout(view: FlowView) -> tuple[Figure, list[Axes]]:
    """A figure with three panels of the view's shape, room above and below."""
    columns, rows = (view.high - view.low).tolist()
    height = float(np.clip(PANEL * rows / columns, 0.6, 3.6))
    total = height + 1.23
    figure = Figure(figsize=(3 * PANEL + 0.3, total))
    grid = figure.add_gridspec(
        1, 3, left=0.01, right=0.99, top=1 - 0.50 / total, bottom=0.73 / total, wspace=0.025
    )
    return figure, [figure.add_subplot(grid[0, column]) for column in range(3)]


def _image(axes: Axes, view: FlowView, title: str, colours: np.ndarray) -> None:
    """Pixels at their places in the picture, and a title."""
    left, top = view.low - 0.5
    below, right = np.array(colours.shape[:2]) * view.stride + (top, left)
    axes.imshow(colours, extent=(left, right, below, top), interpolation="antialiased")
    axes.set_xlim(left, view.high[0] - 0.5)
    axes.set_ylim(view.high[1] - 0.5, top)
    axes.set_axis_off()
    # A title proper would look for room above ticks that are not there: it takes 30 ms.
    axes.annotate(
        title, (0.5, 1.0), (0.0, 5.0), xycoords="axes fraction", textcoords="offset points",
        ha="center", fontsize=8.5, annotation_clip=False, parse_math=False,
    )  # fmt: skip


def _size_there(view: FlowView) -> float:
    """Longer side of the shown part of the picture at the distance of the object [m]."""
    depth = view.camera.T_camera_object[2, :3] @ view.mesh.vertices.mean(axis=0)
    depth += view.camera.T_camera_object[2, 3]
    side = float((view.high - view.low).max())
    return max(float(depth), 1e-12) * side / float(view.camera.matrix[0, 0])


def _arrows_in_space(axes: Axes, view: FlowView, point: Points, vector: Points) -> None:
    """Arrows in space, as the camera would see them."""
    place = project(view.camera, point)
    _arrows(axes, view, place, project(view.camera, point + vector) - place)


def _dots(axes: Axes, view: FlowView, vertices: VertexDisplacement, norm: Normalize) -> None:
    """The measured vertices themselves, also those whose neighbours were not measured."""
    rows = in_view(view)
    rows = rows[measured_vertices(vertices)[rows]]
    place = project(view.camera, view.mesh.vertices[rows])
    length = np.linalg.norm(vertices.displacement[rows], axis=1)
    size = float(np.clip(1500.0 / max(len(rows), 1), 2.0, 9.0))
    axes.scatter(
        place[:, 0], place[:, 1], c=length, s=size, cmap=_LENGTH, norm=norm, linewidths=0.3,
        edgecolors="#1c1f24", zorder=2,
    )  # fmt: skip


def _arrows(
    axes: Axes,
    view: FlowView,
    place: Float[np.ndarray, "n 2"],
    vector: Float[np.ndarray, "n 2"],
) -> None:
    """Arrows at points of an even choice, light with a dark rim: seen on every colour."""
    known = np.flatnonzero(np.isfinite(vector).all(axis=1) & np.isfinite(place).all(axis=1))
    pitch = float((view.high - view.low).max()) / ARROWS_ACROSS
    cell = np.floor((place[known] - view.low) / pitch)
    off = np.linalg.norm((place[known] - view.low) / pitch - cell - 0.5, axis=1)
    order = np.argsort(off, kind="stable")
    _, first = np.unique(cell[order], axis=0, return_index=True)
    chosen = known[order[first]]
    shortest = SHORT_ARROW * pitch * ARROWS_ACROSS
    chosen = chosen[np.linalg.norm(vector[chosen], axis=1) > shortest]
    axes.quiver(
        *place[chosen].T, *vector[chosen].T, angles="xy", scale_units="xy", scale=1.0,
        units="inches", width=0.022, headwidth=3.4, headlength=3.6, headaxislength=3.2,
        minlength=0.5, color="white", edgecolor="#1c1f24", linewidth=0.5, zorder=3,
    )  # fmt: skip


def _bar(figure: Figure, panels: list[Axes], cmap: str, norm: Normalize, label: str) -> None:
    """A horizontal colour bar under the middle of some panels."""
    total = figure.get_figheight()
    cells = [axes.get_position(original=True) for axes in panels]
    left, right, width = cells[0].x0, cells[-1].x1, 0.62 * cells[0].width
    if norm.vmax is None or norm.vmax >= _UNKNOWN:
        figure.text(0.5 * (left + right), 0.55 / total, "nothing was measured", ha="center")
        return
    axes = figure.add_axes((0.5 * (left + right - width), 0.61 / total, width, 0.075 / total))
    bar = figure.colorbar(
        ScalarMappable(norm, cmap), cax=axes, orientation="horizontal", extend="max",
        ticks=MaxNLocator(4),
    )  # fmt: skip
    bar.outline.set_linewidth(0.4)
    bar.set_label(label, labelpad=2)


def _legend(figure: Figure, axes: Axes, flow: RangeFlow) -> None:
    """The colours of the causes that occur, with their counts."""
    counts = cause_counts(flow)
    handles = [
        Patch(facecolor=colour, label=f"{Outcome(cause).name.lower()} {counts[name]}")
        for cause, colour in CAUSE_COLOURS.items()
        if counts[name := Outcome(cause).name.lower()]
    ]
    place = axes.get_position(original=True)
    if handles:
        figure.legend(
            handles=handles, loc="upper center", ncols=3, columnspacing=0.9, handlelength=0.9,
            handletextpad=0.4, borderaxespad=0.0, labelspacing=0.35, fontsize=7.0,
            bbox_to_anchor=(0.5 * (place.x0 + place.x1), 0.68 / figure.get_figheight()),
        )  # fmt: skip


def _texts(figure: Figure, title: str, left: str, right: str) -> None:
    """Heading, and two notes along the lower edge."""
    total = figure.get_figheight()
    # Names may hold dollars: they are no mathematics.
    figure.text(
        0.5, 1 - 0.07 / total, title, ha="center", va="top", fontsize=9, weight="bold",
        parse_math=False,
    )  # fmt: skip
    for place, side, text in ((0.01, "left", left), (0.99, "right", right)):
        figure.text(place, 0.05 / total, text, ha=side, va="bottom", fontsize=6.5, parse_math=False)
