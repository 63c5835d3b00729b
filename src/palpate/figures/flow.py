"""Figures of one measured motion, as seen by the reference camera.

`flow_figure` is like the paper's figure 3: optical flow, range flow and displacement of the
vertices, in colour on the picture. `quality_figure` shows the rejected points with their causes,
and the standard deviations of the others.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation

from palpate.figures.style import (
    INK,
    LIGHT,
    add_arrows,
    add_colour_bar,
    add_texts,
    magnification_text,
    place_below,
    save_figure,
    styled,
    three_panels,
    title_panel,
)
from palpate.geometry import TriangleMesh, unit_normals
from palpate.pipeline import MeasuredMotion
from palpate.records import Camera, length_unit
from palpate.shapes import Indices, Points, PointScalars
from palpate.vision import (
    Outcome,
    RangeFlow,
    SurfaceMap,
    VertexDisplacement,
    camera_sigma,
    cause_counts,
    is_valid,
    measured_vertices,
    project,
)

USUAL_ARROW = 0.12  # 95 % quantile of the arrows' length, as a fraction of a panel's longer side
LONGEST_ARROW = 0.2  # 99.5 % quantile of the same
SHORTEST_ARROW = 0.012  # the same: shorter arrows are left out, as they would be mere dots
ARROWS_ACROSS = 11  # more would hide the colours
CAUSE_COLOURS = {
    int(Outcome.HIDDEN): "#0072B2",
    int(Outcome.TEXTURE): "#E69F00",
    int(Outcome.OUTSIDE): "#56B4E9",
    int(Outcome.LOST): "#009E73",
    int(Outcome.SCORE): "#D55E00",
    int(Outcome.REPROJECTION): "#CC79A7",
    int(Outcome.NEIGHBOURS): "#F0E442",
}
# Colour maps without grey, which means "no value".
_OPTICAL, _LENGTH, _SIGMA = "plasma", "viridis", "magma"
_NO_LIMIT = 1e30  # end of a scale without values
_MARGIN = 0.05  # around the object, as a fraction of its size in the picture
MAX_PIXELS = 700  # along a side of a panel; a page shows no more
GREYS = (-0.16, 1.14)  # levels of black and white, for a slightly paler picture
OPACITY = 0.85  # of colours, so that the texture shows through faintly
CLAY = LinearSegmentedColormap.from_list("clay", ["#6f7379", "#d4d7db"])
Image = Float[np.ndarray, "rows columns"]


@dataclass(frozen=True, slots=True, eq=False)
class FlowView:
    """The part of the reference picture that shows the object.

    Attributes
    ----------
    camera : Camera                 the reference camera
    mesh : TriangleMesh
    low, high : (2,) int [px]       first and last + 1 column and row
    stride : int [px]               spacing of the pixels that are shown
    grey : (rows, columns) float    grey level of these pixels, 0 black to 1 white
    triangles : (k,) int            visible triangles, from the farthest to the nearest
    """

    camera: Camera
    mesh: TriangleMesh
    low: Int[np.ndarray, "2"]
    high: Int[np.ndarray, "2"]
    stride: int
    grey: Image
    triangles: Indices


def write_flow_pictures(
    folder: Path, stem: str, motion: MeasuredMotion, view: FlowView
) -> dict[str, str]:
    """Write STEM.png and STEM_quality.png.

    Parameters
    ----------
    folder : Path                   an existing folder
    stem : str                      file name without suffix
    motion : MeasuredMotion         without a flow nothing is drawn
    view : FlowView

    Returns
    -------
    dict of str to str              "picture" and "quality" -> file name; empty without a flow

    Raises
    ------
    OSError                         a file cannot be written
    """
    if motion.flow is None:
        return {}
    names = {"picture": f"{stem}.png", "quality": f"{stem}_quality.png"}
    measured = flow_figure(motion.name, motion.flow, motion.vertices, view)
    save_figure(measured, folder / names["picture"])
    save_figure(quality_figure(motion.name, motion.flow, view), folder / names["quality"])
    return names


@styled
def flow_figure(
    name: str,
    flow: RangeFlow,
    vertices: VertexDisplacement | None,
    view: FlowView,
) -> Figure:
    """Optical flow, range flow and displacement of the vertices, side by side.

    Colour is the length of a motion; the picture stays grey where nothing was measured. Arrows at
    some points are magnified by a factor that is stated in the figure.

    Parameters
    ----------
    name : str                      of the motion, for the heading
    flow : RangeFlow
    vertices : VertexDisplacement or None
    view : FlowView

    Returns
    -------
    Figure                          8.4 inches wide
    """
    pixel = project(view.camera, flow.point)
    optical = project(view.camera, flow.point + flow.displacement) - pixel
    shift, length = (np.linalg.norm(vector, axis=1) for vector in (optical, flow.displacement))
    pixels, metres = _quantile(shift, 0.99), _quantile(length, 0.99)
    figure, panels = three_panels(view.high - view.low)
    titles = (f"2-D optical flow in {view.camera.name}", "range flow",
              "displacement of the vertices")  # fmt: skip
    for axes, title in zip(panels, titles, strict=True):
        draw_picture(axes, view)
        title_panel(axes, title)
    draw_points(panels[0], flow, shift, _OPTICAL, _root(pixels))
    draw_points(panels[1], flow, length, _LENGTH, _root(metres))
    draw_vertices(panels[2], vertices, view, _LENGTH, _root(metres))
    across = float((view.high - view.low).max()) * _stretch(shift)
    along = _size_there(view) * _stretch(length)
    _arrows(panels[0], view, pixel, across * optical)
    _arrows_in_space(panels[1], view, flow.point, along * flow.displacement)
    rows, measured = seen_corners(view), 0
    if vertices is not None:
        measured = int(measured_vertices(vertices)[rows].sum())
        motion = along * vertices.displacement[rows]
        _arrows_in_space(panels[2], view, view.mesh.vertices[rows], motion)
    factor, unit = length_unit(metres)
    _bar(figure, panels[:1], _OPTICAL, _root(pixels), "motion in the picture (px)")
    _bar(figure, panels[1:], _LENGTH, _root(metres / factor), f"displacement $|u|$ ({unit})")
    scales = f"{magnification_text(across)} the motion, {magnification_text(along)} |u|"
    note = f"colours: square-root scale; arrows: {scales}" if is_valid(flow).any() else ""
    heading = f"{name}: {_counts(flow)}, {measured} of {len(rows)} vertices measured"
    add_texts(figure, heading, note, _rejected(flow))
    return figure


@styled
def quality_figure(name: str, flow: RangeFlow, view: FlowView) -> Figure:
    """Causes of rejected points; standard deviations of the others across the view and in depth.

    Parameters
    ----------
    name : str                      of the motion, for the heading
    flow : RangeFlow
    view : FlowView

    Returns
    -------
    Figure                          8.4 inches wide
    """
    figure, panels = three_panels(view.high - view.low)
    titles = ("rejected, and why", "1 sigma across the view", "1 sigma in depth")
    for axes, title in zip(panels, titles, strict=True):
        draw_picture(axes, view)
        title_panel(axes, title)
    causes = np.array([*CAUSE_COLOURS])
    number = np.where(np.isin(flow.outcome, causes), np.searchsorted(causes, flow.outcome), np.nan)
    colours = ListedColormap(list(CAUSE_COLOURS.values()))
    draw_points(panels[0], flow, number, colours, Normalize(-0.5, len(causes) - 0.5))
    _legend(figure, panels[0], flow)
    sigmas = camera_sigma(flow.covariance, view.camera)
    for axes, sigma in zip(panels[1:], sigmas, strict=True):
        high = _quantile(sigma, 0.95)
        draw_points(axes, flow, sigma, _SIGMA, Normalize(0.0, high))
        factor, unit = length_unit(high)
        label = f"of one point ({unit}), median {_quantile(sigma, 0.5) / factor:.3g}"
        _bar(figure, [axes], _SIGMA, Normalize(0.0, high / factor), label)
    window = f"window of {flow.subset} px, a point every {flow.step} px"
    add_texts(figure, f"{name}: {_counts(flow)}", f"seen by {view.camera.name}", window)
    return figure


def _quantile(values: PointScalars, share: float) -> float:
    """Quantile of the finite values, positive; `_NO_LIMIT` if there are none."""
    known = values[np.isfinite(values)]
    return max(float(np.quantile(known, share)), 1e-12) if len(known) else _NO_LIMIT


def _root(top: float) -> Normalize:
    """A square-root scale from zero, which resolves the small motions away from a contact."""
    return PowerNorm(0.5, vmin=0.0, vmax=top)


def _stretch(length: PointScalars) -> float:
    """Length of an arrow, in panel sides, per unit of motion."""
    usual, most = _quantile(length, 0.95), _quantile(length, 0.995)
    return min(USUAL_ARROW / usual, LONGEST_ARROW / most)


def _counts(flow: RangeFlow) -> str:
    return f"{int(is_valid(flow).sum())} of {len(flow.outcome)} points valid"


def _rejected(flow: RangeFlow) -> str:
    count = len(flow.outcome) - int(is_valid(flow).sum())
    return f"grey: {count} points rejected, or nothing measured"


def _size_there(view: FlowView) -> float:
    """Size of the shown part of the picture's longer side, at the distance of the object [m]."""
    depth = view.camera.T_camera_object[2, :3] @ view.mesh.vertices.mean(axis=0)
    depth += view.camera.T_camera_object[2, 3]
    side = float((view.high - view.low).max())
    return max(float(depth), 1e-12) * side / float(view.camera.matrix[0, 0])


def _arrows_in_space(axes: Axes, view: FlowView, point: Points, vector: Points) -> None:
    """Draw vectors in space as arrows in the camera's projection."""
    pixel = project(view.camera, point)
    _arrows(axes, view, pixel, project(view.camera, point + vector) - pixel)


def _arrows(
    axes: Axes, view: FlowView, pixel: Float[np.ndarray, "n 2"], vector: Float[np.ndarray, "n 2"]
) -> None:
    """Draw white arrows with a dark rim, visible on every colour."""
    side = float((view.high - view.low).max())
    pitch, shortest = side / ARROWS_ACROSS, SHORTEST_ARROW * side
    add_arrows(axes, pixel, vector, pitch=pitch, shortest=shortest, colour="white")


def _bar(figure: Figure, panels: list[Axes], cmap: str, norm: Normalize, label: str) -> None:
    """Draw a colour bar under some panels, or a note if nothing was measured."""
    if norm.vmax is None or norm.vmax >= _NO_LIMIT:
        middle, _ = place_below(figure, panels)
        figure.text(middle, 0.55 / figure.get_figheight(), "nothing was measured", ha="center")
    else:
        add_colour_bar(figure, panels, cmap, norm, label)


def _legend(figure: Figure, axes: Axes, flow: RangeFlow) -> None:
    """Draw the legend of the causes that occur, with their counts."""
    counts = cause_counts(flow)
    handles = [
        Patch(facecolor=colour, label=f"{Outcome(cause).name.lower()} {counts[name]}")
        for cause, colour in CAUSE_COLOURS.items()
        if counts[name := Outcome(cause).name.lower()]
    ]
    middle, _ = place_below(figure, [axes])
    if handles:
        figure.legend(
            handles=handles, loc="upper center", ncols=3, columnspacing=0.9, handlelength=0.9,
            handletextpad=0.4, borderaxespad=0.0, labelspacing=0.35, fontsize=7.0,
            bbox_to_anchor=(middle, 0.68 / figure.get_figheight()),
        )  # fmt: skip


def make_flow_view(
    picture: Image, camera: Camera, surface: SurfaceMap, mesh: TriangleMesh
) -> FlowView:
    """Crop a picture to the object; the whole picture is kept if the object is not in view.

    Parameters
    ----------
    picture : (rows, columns) float [grey levels]   first instant, reference camera
    camera : Camera                 the reference camera
    surface : SurfaceMap            surface as seen by that camera
    mesh : TriangleMesh

    Returns
    -------
    FlowView
    """
    size = np.array(picture.shape[::-1])
    rows, columns = np.nonzero(surface.triangle >= 0)
    low, high = np.zeros(2, dtype=np.int64), size
    if len(rows):
        first = np.array([columns.min(), rows.min()])
        last = np.array([columns.max(), rows.max()])
        more = int(np.ceil(_MARGIN * (last - first).max())) + 2
        low, high = np.maximum(first - more, 0), np.minimum(last + more + 1, size)
    stride = int(np.ceil((high - low).max() / MAX_PIXELS))
    part = (slice(low[1], high[1], stride), slice(low[0], high[0], stride))
    shown, seen = picture[part].astype(np.float64), surface.triangle[part] >= 0
    black, white = np.quantile(shown[seen] if seen.any() else shown, [0.01, 0.99])
    grey = np.clip((shown - black) / max(white - black, 1.0), 0.0, 1.0)
    triangles = np.unique(surface.triangle[surface.triangle >= 0])
    centre = mesh.vertices[mesh.triangles[triangles]].mean(axis=1)
    order = np.argsort(-(centre @ camera.T_camera_object[2, :3]), kind="stable")
    return FlowView(camera, mesh, low, high, stride, grey, triangles[order])


def seen_corners(view: FlowView) -> Indices:
    """Vertices of the visible triangles.

    Parameters
    ----------
    view : FlowView

    Returns
    -------
    (k,) int                        indices of the mesh's vertices, ascending
    """
    return np.unique(view.mesh.triangles[view.triangles])


def draw_picture(axes: Axes, view: FlowView) -> None:
    """Draw the grey picture and set the limits of a panel, in pixels of the uncropped picture.

    Parameters
    ----------
    axes : Axes
    view : FlowView
    """
    left, top = view.low - 0.5
    below, right = np.array(view.grey.shape) * view.stride + (top, left)
    axes.imshow(
        view.grey, cmap="gray", vmin=GREYS[0], vmax=GREYS[1], extent=(left, right, below, top),
        interpolation="antialiased",
    )  # fmt: skip
    axes.set(xlim=(left, view.high[0] - 0.5), ylim=(view.high[1] - 0.5, top))


def draw_points(
    axes: Axes, flow: RangeFlow, values: PointScalars, cmap: str | ListedColormap, norm: Normalize
) -> None:
    """Draw values at the points of a flow, each as a square around its point.

    Parameters
    ----------
    axes : Axes
    flow : RangeFlow                n points
    values : (n,) float             NaN: not drawn
    cmap, norm                      colour map and scale
    """
    if len(flow.pixel) == 0:
        return
    first = flow.pixel.min(axis=0)
    column, row = np.rint((flow.pixel - first) / flow.step).astype(np.int64).T
    grid = np.full((row.max() + 1, column.max() + 1), np.nan)
    grid[row, column] = values
    left, top = first - 0.5 * flow.step
    below, right = np.array(grid.shape) * flow.step + (top, left)
    axes.imshow(
        grid, cmap=cmap, norm=norm, alpha=OPACITY, extent=(left, right, below, top),
        interpolation="nearest",
    )  # fmt: skip


def draw_vertices(
    axes: Axes, vertices: VertexDisplacement | None, view: FlowView, cmap: str, norm: Normalize
) -> None:
    """Draw the mesh as seen by the camera: grey, and coloured by displacement where measured.

    Triangles with three measured vertices are coloured; measured vertices are also drawn as dots.

    Parameters
    ----------
    axes : Axes
    vertices : VertexDisplacement or None
    view : FlowView
    cmap, norm                      colour map and scale of the lengths
    """
    rows, mesh = seen_corners(view), view.mesh
    pixel, corners = project(view.camera, mesh.vertices[rows]), mesh.triangles[view.triangles]
    right, below, into = view.camera.T_camera_object[:3, :3]
    toward = LIGHT[0] * right - LIGHT[1] * below - LIGHT[2] * into
    light = unit_normals(mesh)[view.triangles] @ (toward / np.linalg.norm(toward))
    colours = CLAY(np.clip(light, 0.0, 1.0))
    local = np.searchsorted(rows, corners)
    polygons = cast(Any, pixel[local])
    axes.add_collection(
        PolyCollection(polygons, facecolors=colours, edgecolors=colours, linewidths=0.8),
        autolim=False,
    )
    if vertices is None:
        return
    across, down = pixel.T
    known = measured_vertices(vertices)[rows]
    length = np.linalg.norm(vertices.displacement[rows], axis=1)
    whole = known[local].all(axis=1)
    if whole.any():
        shape = Triangulation(across, down, local[whole])
        values = np.nan_to_num(length)
        axes.tripcolor(shape, values, cmap=cmap, norm=norm, shading="gouraud")
    size = float(np.clip(1500.0 / max(known.sum(), 1), 2.0, 9.0))
    axes.scatter(
        across[known], down[known], c=length[known], s=size, cmap=cmap, norm=norm, linewidths=0.3,
        edgecolors=INK, zorder=2,
    )  # fmt: skip
