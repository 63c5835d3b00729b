"""Figure of a modulus that differs from place to place: a view into the body and sections."""

from typing import Any, cast

import matplotlib as mpl
import numpy as np
from jaxtyping import Int
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LogNorm, to_rgba
from matplotlib.figure import Figure

from palpate.figures.displacement import SurfaceView, make_view
from palpate.figures.style import GREY, INK, styled
from palpate.geometry import TriangleMesh, unit_normals
from palpate.records import FieldEstimate, ModulusMap
from palpate.shapes import Vector3

_MM = 1e3
# Pixels along the longer side of a section.
_PIXELS = 240
# Horizontal and vertical axis of each section.
_PLANES = ((0, 1), (0, 2), (1, 2))
_NAMES = "xyz"
# Colour map of matplotlib: softer, mean, stiffer.
MODULI = "RdBu_r"
# Toward the viewer of the body; cosine between the faces of an edge that is drawn.
_TOWARD = np.array([0.45, -0.75, 0.48]) / np.linalg.norm([0.45, -0.75, 0.48])
_SHARP = 0.8
_NOT_KNOWN, _GLASS = "#dbdee0", (0.45, 0.5, 0.6, 0.12)
_UNKNOWN = "Grey: the data do not tell the modulus"
# Least range of the colours, as a factor from the mean: less than that is no difference to show.
_LEAST_RANGE = 1.5


@styled
def modulus_figure(modulus: ModulusMap, field: FieldEstimate | None) -> Figure:
    """A view into the body, to where the modulus is half way from the rest to its extremes, and
    sections along the axes through the part that differs most, or the middle of the body.

    Parameters
    ----------
    modulus : ModulusMap
    field : FieldEstimate or None   None: of regions, through the middle of what differs from the
                                    rest

    Returns
    -------
    Figure                          9.6 by 3.1 inches; grey where the modulus is not known
    """
    corner = modulus.nodes[modulus.tetrahedra]
    low, high = modulus.nodes.min(axis=0), modulus.nodes.max(axis=0)
    through = 0.5 * (low + high)
    if field is None:
        through = corner.mean(axis=1)[modulus.log_modulus != 0.0].mean(axis=0)
    elif field.parts:
        through = np.array(field.parts[0].centre)
    span = modulus_span(modulus)
    colours = LogNorm(1.0 / span, span)
    size = high - low
    body, _ = modulus.boundary(np.ones(len(corner), dtype=bool))
    view = make_view(body, _TOWARD)
    figure = Figure(figsize=(9.6, 3.1))
    grid = figure.add_gridspec(
        1, 4, width_ratios=[float(np.ptp(view.polygons[..., 0])), *(size[i] for i, _ in _PLANES)],
        left=0.01, right=0.885, top=0.86, bottom=0.15, wspace=0.3,
    )  # fmt: skip
    for k, (i, j) in enumerate(_PLANES, start=1):
        _draw_section(figure.add_subplot(grid[k]), modulus, through, (i, j), colours)
    base = "that of the rest" if field is None or field.is_of_parts else "its mean"
    axes, contours = figure.add_subplot(grid[0]), half_way(modulus, field)
    _draw_inside(axes, modulus, body, view, colours, contours)
    if contours:
        times = " and ".join(f"{contour:.2g}" for contour in contours)
        axes.set_title(f"{times} times {base}", color=INK)
    bar = figure.colorbar(
        ScalarMappable(colours, MODULI), cax=figure.add_axes((0.912, 0.2, 0.012, 0.6))
    )
    bar.set_label(f"modulus over {base}")
    ticks = _ticks(span)
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.ax.minorticks_off()
    if not modulus.is_known.all():
        figure.text(0.5, 0.985, _UNKNOWN, color=GREY, ha="center", va="top")
    return figure


def _draw_section(
    axes: Axes,
    modulus: ModulusMap,
    through: Vector3,
    plane: tuple[int, int],
    colours: LogNorm,
) -> None:
    """The modulus in a plane along two axes."""
    i, j = plane
    low, high = modulus.nodes.min(axis=0), modulus.nodes.max(axis=0)
    step = float(max((high - low)[[i, j]])) / _PIXELS
    across, up = (np.arange(low[a] + 0.5 * step, high[a], step) for a in plane)
    points = np.tile(through, (len(up), len(across), 1))
    points[..., i], points[..., j] = np.meshgrid(across, up)
    element = modulus.element_at(points.reshape(-1, 3))
    inside = (element >= 0).reshape(points.shape[:2])
    shown = inside & modulus.is_known[element].reshape(inside.shape)
    ratio = np.exp(modulus.log_modulus[element]).reshape(inside.shape)
    extent = tuple(_MM * x for x in (low[i], high[i], low[j], high[j]))
    grey = np.where(inside[..., None], to_rgba(_NOT_KNOWN), 0.0)
    axes.imshow(grey, extent=extent, origin="lower")
    axes.imshow(
        np.ma.masked_where(~shown, ratio), extent=extent, origin="lower", norm=colours,
        cmap=MODULI,
    )  # fmt: skip
    third = 3 - i - j
    axes.set_title(f"{_NAMES[third]} = {round(_MM * through[third])} mm", color=INK)
    axes.set_xlabel(f"{_NAMES[i]} (mm)")
    axes.set_ylabel(f"{_NAMES[j]} (mm)")


def _draw_inside(
    axes: Axes,
    modulus: ModulusMap,
    body: TriangleMesh,
    view: SurfaceView,
    colours: LogNorm,
    ratios: list[float],
) -> None:
    """The body as if of glass, with where the modulus passes some values."""
    axes.set_axis_off()
    axes.set_aspect("equal")
    creases = _MM * (body.vertices[_creases(body)] @ view.R_view_object.T)[..., :2]
    axes.add_collection(LineCollection(cast(Any, creases), colors=GREY, linewidths=0.5))
    for ratio in ratios:
        surface = modulus.isosurface(ratio)
        if surface is None:
            continue
        # Of a layer the far side is seen.
        sides = np.concatenate([surface.triangles, surface.triangles[:, ::-1]])
        part = make_view(TriangleMesh(surface.vertices, sides), _TOWARD)
        # In the colour of the part.
        paint = np.array(mpl.colormaps[MODULI](float(colours(ratio**2))))[:3]
        shade = paint * (0.55 + 0.45 * part.brightness)[:, None]
        polygons = cast(Any, _MM * part.polygons)
        axes.add_collection(
            PolyCollection(polygons, facecolors=shade, edgecolors=shade, linewidths=0.3)
        )
    polygons = cast(Any, _MM * view.polygons)
    axes.add_collection(PolyCollection(polygons, facecolors=_GLASS, linewidths=0.0))
    axes.autoscale_view()


def _creases(body: TriangleMesh) -> Int[np.ndarray, "e 2"]:
    """Ends of the sharp edges of a surface."""
    normals = unit_normals(body)
    edges = np.sort(body.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    first, other = (np.repeat(np.arange(len(normals)), 3)[order]).reshape(-1, 2).T
    return edges[order][::2][(normals[first] * normals[other]).sum(axis=1) < _SHARP]


def half_way(modulus: ModulusMap, field: FieldEstimate | None) -> list[float]:
    """Moduli half way, in logarithms, from the rest to the stiffest and to the softest part.

    Parameters
    ----------
    modulus : ModulusMap
    field : FieldEstimate or None   None: of regions

    Returns
    -------
    list of float                   relative as in the map
    """
    ratios = np.exp(modulus.log_modulus)
    if field is not None:
        ratios = np.array([part.ratio for part in field.parts])
    ends = (float(ratios.max(initial=1.0)), float(ratios.min(initial=1.0)))
    return [modulus.rest * float(np.sqrt(ratio)) for ratio in ends if ratio != 1.0]


def modulus_span(modulus: ModulusMap) -> float:
    """Factor from the mean at the ends of the colours of a modulus.

    Parameters
    ----------
    modulus : ModulusMap
    """
    farthest = float(np.abs(modulus.log_modulus[modulus.is_known]).max(initial=0.0))
    return max(_LEAST_RANGE, float(np.exp(farthest)))


def _ticks(span: float) -> list[float]:
    """Ratios to label, symmetric about 1."""
    steps = [step for step in (1.2, 1.5, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0) if step <= span][-2:]
    return sorted([*(round(1.0 / step, 3) for step in steps), 1.0, *steps])
