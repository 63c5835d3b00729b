"""Pictures of a surface that was mended and remeshed: before, after, and between them."""

from typing import Any, cast

import numpy as np
from jaxtyping import Bool, Int
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from palpate.figures.displacement import CLAY, SurfaceView, make_view, projected
from palpate.figures.style import INK, ORANGE, add_texts, styled, three_panels, title_panel
from palpate.geometry import TriangleMesh, bounding_diagonal, triangle_areas, unit_normals
from palpate.scanning import PreparedSurface, distances
from palpate.shapes import Points, TriangleScalars, Vector3

# From above the front, a little from the right.
_DIRECTION = np.array([0.45, -0.75, 0.48]) / np.linalg.norm([0.45, -0.75, 0.48])
# More lines than these and the triangles are not seen for their edges.
_MOST_LINED = 20_000
# Below, distances are all one colour [mm].
_SMALLEST = 0.01


@styled
def surface_figure(name: str, surface: PreparedSurface) -> Figure:
    """Three views: the surface as it came, as it is now, and how far one is from the other.

    Parameters
    ----------
    name : str                      heading
    surface : PreparedSurface

    Returns
    -------
    Figure
    """
    direction = _seen_from(surface)
    given, made = _view(surface.given, direction), make_view(surface.mesh, direction)
    corners = np.concatenate([view.polygons.reshape(-1, 2) for view in (given, made)])
    low, high = 1e3 * corners.min(axis=0), 1e3 * corners.max(axis=0)
    margin = 0.04 * float((high - low).max())
    figure, panels = three_panels(high - low + 2 * margin)
    for axes in panels:
        axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
        axes.set_aspect("equal")
    _draw(panels[0], given, lined=len(surface.given.triangles) <= _MOST_LINED)
    shown = _drawn_order(surface.mesh, direction)
    lined = len(surface.mesh.triangles) <= _MOST_LINED
    _draw(panels[1], made, lined=lined, orange=surface.guessed[shown])
    places = np.array([action.place for action in surface.actions]).reshape(-1, 3)
    _mark(panels[0], given, places)
    gap = 1e3 * distances(
        surface.mesh.vertices[surface.mesh.triangles].mean(axis=1), surface.mended
    )
    _coloured(figure, panels[2], surface.mesh, direction, gap)
    for axes, mesh, title in (
        (panels[0], surface.given, "given"), (panels[1], surface.mesh, "made"),
    ):  # fmt: skip
        title_panel(axes, f"{title}: {len(mesh.vertices)} vertices")
    title_panel(panels[2], "distance between them")
    marks = "dots: the first defect of each kind" if len(places) else "nothing was broken"
    share = float((areas := triangle_areas(surface.mesh))[surface.guessed].sum() / areas.sum())
    guessed = f"; orange triangles: closed, not measured, {100.0 * share:.1f} % of the area"
    add_texts(figure, name, marks + (guessed if share else ""), "")
    return figure


def _seen_from(surface: PreparedSurface) -> Vector3:
    """The usual view, from the side of the first defect where that is on the other side."""
    if not surface.actions:
        return _DIRECTION
    offset = surface.actions[0].place - surface.mesh.vertices.mean(axis=0)
    sign = np.where(offset * _DIRECTION < -0.1 * bounding_diagonal(surface.mesh), -1.0, 1.0)
    return _DIRECTION * sign


def _view(mesh: TriangleMesh, direction: Vector3) -> SurfaceView:
    """A view of triangles that may have no area, or their back to the viewer."""
    sound = triangle_areas(mesh) > 0.0
    mesh = TriangleMesh(vertices=mesh.vertices, triangles=mesh.triangles[sound])
    both = TriangleMesh(
        vertices=mesh.vertices, triangles=np.concatenate([mesh.triangles, mesh.triangles[:, ::-1]])
    )
    return make_view(both, direction)


def _drawn_order(mesh: TriangleMesh, direction: Vector3) -> Int[np.ndarray, " k"]:
    """Triangles in the order that `make_view` draws them."""
    front = np.flatnonzero(unit_normals(mesh) @ direction > 0.0)
    depth = mesh.vertices[mesh.triangles[front]].mean(axis=1) @ direction
    return front[np.argsort(depth)]


def _draw(
    axes: Axes, view: SurfaceView, *, lined: bool, orange: Bool[np.ndarray, " m"] | None = None
) -> None:
    colours = CLAY(view.brightness)
    if orange is not None:
        colours[orange, :3] = 0.35 * colours[orange, :3] + 0.65 * np.array(to_rgb(ORANGE))
    axes.add_collection(
        PolyCollection(
            cast(Any, 1e3 * view.polygons),
            facecolors=colours,
            edgecolors=INK if lined else colours,
            linewidths=0.15 if lined else 0.3,
        ),
        autolim=False,
    )


def _mark(axes: Axes, view: SurfaceView, places: Points) -> None:
    """Points in orange, also those that the surface hides."""
    if len(places):
        place = 1e3 * projected(view, places)
        axes.scatter(
            place[:, 0], place[:, 1], s=26.0, color=ORANGE, linewidths=0.4, edgecolors=INK, zorder=3
        )


def _coloured(
    figure: Figure, axes: Axes, mesh: TriangleMesh, direction: Vector3, value: TriangleScalars
) -> None:
    """Triangles in the colour of a value [mm], with its bar below."""
    view = make_view(mesh, direction)
    shown = value[_drawn_order(mesh, direction)]
    norm = Normalize(0.0, max(float(np.quantile(value, 0.99)), _SMALLEST))
    colours = ScalarMappable(norm, "magma_r").to_rgba(shown)
    axes.add_collection(
        PolyCollection(
            cast(Any, 1e3 * view.polygons), facecolors=colours, edgecolors=colours, linewidths=0.3
        ),
        autolim=False,
    )
    total = figure.get_figheight()
    cell = axes.get_position(original=True)
    place = (cell.x0 + 0.19 * cell.width, 0.61 / total, 0.62 * cell.width, 0.075 / total)
    bar = figure.colorbar(
        ScalarMappable(norm, "magma_r"), cax=figure.add_axes(place), orientation="horizontal",
        extend="max", ticks=MaxNLocator(3),
    )  # fmt: skip
    bar.outline.set_linewidth(0.4)
    bar.set_label("distance (mm)", labelpad=2)
