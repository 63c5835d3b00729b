"""Figures of repaired and scanned surfaces with their accuracy; where to probe next."""

from typing import Any, cast

import numpy as np
from jaxtyping import Bool
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgb, to_rgba
from matplotlib.figure import Figure

from palpate.errors import counted
from palpate.figures.displacement import CLAY, SurfaceView, draw_body, make_view, projected
from palpate.figures.style import (
    BLUE,
    GREY,
    INK,
    MIDDLE_BLUE,
    ORANGE,
    add_colour_bar,
    add_texts,
    styled,
    three_panels,
    title_panel,
)
from palpate.geometry import TriangleMesh, bounding_diagonal, triangle_areas
from palpate.pipeline import PREDICTION, NextProbings
from palpate.scanning import PreparedSurface, ScannedSurface, distances
from palpate.shapes import Points, TriangleScalars, Vector3

# Default view: from the front, slightly from above and from the right.
_DIRECTION = np.array([0.45, -0.75, 0.48]) / np.linalg.norm([0.45, -0.75, 0.48])
# Largest number of triangles drawn with edges; more edges would hide the triangles.
_MOST_LINED = 20_000
# Largest number of points; more would hide each other.
_MOST_POINTS = 40_000
_PALE_GREY = "#d9dce1"
# Least end of the colour scale [mm].
_SMALLEST = 0.01
# Viewing directions, all from slightly above.
_SIDES = ((0.45, -0.75, 0.48), (0.5, 0.75, 0.43), (-0.85, -0.1, 0.52))
_TITLES = ("from the front", "from behind", "from the left")
# Least cosine between outward direction and view of a place that is drawn.
_FRONT = 0.15
_MAP = "viridis"


@styled
def surface_figure(name: str, surface: PreparedSurface) -> Figure:
    """Three views: the given surface, the repaired mesh, and the distance between them.

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
    figure, panels = _panels_around([given, made], margin=0.04)
    _draw(panels[0], given, lined=len(surface.given.triangles) <= _MOST_LINED)
    lined = len(surface.mesh.triangles) <= _MOST_LINED
    _draw(panels[1], made, lined=lined, orange=surface.guessed[made.triangle])
    places = np.array([action.place for action in surface.actions]).reshape(-1, 3)
    _mark(panels[0], given, places)
    gap = 1e3 * distances(
        surface.mesh.vertices[surface.mesh.triangles].mean(axis=1), surface.mended
    )
    _coloured(figure, panels[2], surface.mesh, direction, gap, label="distance (mm)")
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


@styled
def scan_figure(name: str, surface: ScannedSurface) -> Figure:
    """Three views: the points, coloured by view; the mesh, with unmeasured triangles in orange; its
    standard deviation.

    Parameters
    ----------
    name : str                      heading
    surface : ScannedSurface

    Returns
    -------
    Figure
    """
    mesh, direction = surface.mesh, _scan_direction(surface)
    made = make_view(mesh, direction)
    figure, panels = _panels_around([made], margin=0.06)
    _points_of_views(panels[0], made, surface, direction)
    lined = len(mesh.triangles) <= _MOST_LINED
    _draw(panels[1], made, lined=lined, orange=surface.guessed[made.triangle])
    corner = surface.sigma[mesh.triangles]
    known = np.isfinite(corner)
    sigma = np.where(known, corner, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    sigma[~known.any(axis=1)] = np.nan
    _coloured(figure, panels[2], mesh, direction, 1e3 * sigma, label="1 sigma (mm)")
    count = sum(len(view.points) for view in surface.views)
    title_panel(panels[0], f"{count} points of {counted(len(surface.views), 'view')}")
    title_panel(panels[1], f"mesh: {len(mesh.vertices)} vertices")
    title_panel(panels[2], "its standard deviation")
    share = float((areas := triangle_areas(mesh))[surface.guessed].sum() / areas.sum())
    guessed = f"orange: not seen, {100.0 * share:.1f} % of the area; " if share else ""
    add_texts(figure, name, guessed + "grey on the right: no standard deviation", "")
    return figure


def _panels_around(views: list[SurfaceView], *, margin: float) -> tuple[Figure, list[Axes]]:
    """Three panels [mm] with room for all views; margin as a fraction of their larger side."""
    corners = 1e3 * np.concatenate([view.polygons.reshape(-1, 2) for view in views])
    low, high = corners.min(axis=0), corners.max(axis=0)
    room = margin * float((high - low).max())
    low, high = low - room, high + room
    figure, panels = three_panels(high - low)
    for axes in panels:
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    return figure, panels


def _scan_direction(surface: ScannedSurface) -> Vector3:
    """Viewing direction: for a single scan from the side of its viewpoint, slightly above; else the
    default."""
    middle = surface.mesh.vertices.mean(axis=0)
    toward = np.mean([view.eye for view in surface.views], axis=0) - middle
    flat = toward - toward[2] * np.array([0.0, 0.0, 1.0])
    if len(surface.views) > 1 or np.linalg.norm(flat) < 1e-9:
        return _DIRECTION
    side = flat / np.linalg.norm(flat)
    turned = np.array([side[0] - 0.7 * side[1], side[1] + 0.7 * side[0], 0.55])
    return turned / np.linalg.norm(turned)


def _points_of_views(
    axes: Axes, view: SurfaceView, surface: ScannedSurface, direction: Vector3
) -> None:
    """Draw the points on the near side, with a colour for each view."""
    colours = [BLUE, ORANGE, MIDDLE_BLUE, GREY, INK]
    for k, scan in enumerate(surface.views):
        front = scan.normals @ direction > 0.0
        point = 1e3 * projected(view, scan.points[front])
        step = max(1, len(point) * len(surface.views) // _MOST_POINTS)
        x, y = point[::step, 0], point[::step, 1]
        axes.scatter(x, y, s=0.6, color=colours[k % len(colours)], linewidths=0)


def _seen_from(surface: PreparedSurface) -> Vector3:
    """The default viewing direction, mirrored if necessary to show the first defect."""
    if not surface.actions:
        return _DIRECTION
    offset = surface.actions[0].place - surface.mesh.vertices.mean(axis=0)
    sign = np.where(offset * _DIRECTION < -0.1 * bounding_diagonal(surface.mesh), -1.0, 1.0)
    return _DIRECTION * sign


def _view(mesh: TriangleMesh, direction: Vector3) -> SurfaceView:
    """A view of a defective surface: without zero-area triangles, and with both sides visible."""
    sound = triangle_areas(mesh) > 0.0
    mesh = TriangleMesh(vertices=mesh.vertices, triangles=mesh.triangles[sound])
    both = TriangleMesh(
        vertices=mesh.vertices, triangles=np.concatenate([mesh.triangles, mesh.triangles[:, ::-1]])
    )
    return make_view(both, direction)


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
    """Draw points in orange, including those hidden by the surface."""
    if len(places):
        point = 1e3 * projected(view, places)
        axes.scatter(
            point[:, 0], point[:, 1], s=26.0, color=ORANGE, linewidths=0.4, edgecolors=INK, zorder=3
        )


def _coloured(
    figure: Figure,
    axes: Axes,
    mesh: TriangleMesh,
    direction: Vector3,
    value: TriangleScalars,
    *,
    label: str,
) -> None:
    """Draw triangles coloured by a value [mm], grey if unknown, with a colour bar below."""
    view = make_view(mesh, direction)
    shown = value[view.triangle]
    norm = Normalize(0.0, max(float(np.nanquantile(value, 0.99)), _SMALLEST))
    colours = ScalarMappable(norm, "magma_r").to_rgba(np.nan_to_num(shown))
    colours[np.isnan(shown)] = to_rgba(_PALE_GREY)
    axes.add_collection(
        PolyCollection(
            cast(Any, 1e3 * view.polygons), facecolors=colours, edgecolors=colours, linewidths=0.3
        ),
        autolim=False,
    )
    add_colour_bar(figure, [axes], "magma_r", norm, label)


@styled
def next_probings_figure(name: str, next_probings: NextProbings) -> Figure:
    """Three views of the object with the candidate places; the best ones are numbered.

    Parameters
    ----------
    name : str                      heading
    next_probings : NextProbings

    Returns
    -------
    Figure
    """
    mesh = next_probings.session.mesh
    views = [make_view(mesh, np.array(side) / np.linalg.norm(side)) for side in _SIDES]
    figure, panels = _panels_around(views, margin=0.06)
    gain = _gain(next_probings)
    norm = Normalize(0.0, max(float(gain.max(initial=0.0)), 1.0))
    for axes, view, title in zip(panels, views, _TITLES, strict=True):
        draw_body(axes, view, np.isin(view.triangle, next_probings.session.held_triangles))
        _mark_places(axes, view, next_probings, gain, norm)
        title_panel(axes, title)
    quantity = "predicted displacements" if PREDICTION in next_probings.now else "nu"
    label = f"one push there narrows the interval of {quantity} by [%]"
    add_colour_bar(figure, panels, _MAP, norm, label)
    held = np.isin(
        np.concatenate([surface_view.triangle for surface_view in views]),
        next_probings.session.held_triangles,
    )
    note = "grey: held" if held.any() else ""
    add_texts(figure, name, "crosses: measured; rings: push here, in this order", note)
    return figure


def _gain(next_probings: NextProbings) -> np.ndarray:
    """Relative reduction of an interval by a push at each place alone [%]: of nu, or of
    displacements where these decide."""
    name = PREDICTION if PREDICTION in next_probings.now else "poisson_ratio"
    now = next_probings.now[name]
    after = np.array([precision[name] for precision in next_probings.alone])
    if not np.isfinite(now):
        now = float(np.max(after[np.isfinite(after)], initial=1.0))
    return 100.0 * np.clip(1.0 - np.where(np.isfinite(after), after, now) / now, 0.0, 1.0)


def _mark_places(
    axes: Axes, view: SurfaceView, next_probings: NextProbings, gain: np.ndarray, norm: Normalize
) -> None:
    """Draw candidate, chosen and existing contact points on the near side."""
    turn = view.R_view_object
    # A place whose outward normal faces the viewer is on the near side of a convex body, and of
    # most others.
    front = -next_probings.inward @ turn[2] > _FRONT
    point = 1e3 * (next_probings.point @ turn.T)
    axes.scatter(
        point[front, 0], point[front, 1], c=gain[front], cmap=_MAP, norm=norm, s=22,
        linewidths=0.3, edgecolors=INK, zorder=3,
    )  # fmt: skip
    for number, k in enumerate(next_probings.chosen, start=1):
        if front[k]:
            axes.plot(*point[k, :2], "o", mfc="none", mec=ORANGE, mew=1.6, ms=9, zorder=4)
            axes.annotate(
                str(number), point[k, :2], (6, 4), textcoords="offset points", color=ORANGE,
                weight="bold", zorder=5,
            )  # fmt: skip
    measured = np.array([probing.contact.point for probing in next_probings.session.probings])
    pushed = np.array([probing.force for probing in next_probings.session.probings])
    length = np.maximum(np.linalg.norm(pushed, axis=1), np.finfo(float).tiny)
    seen = -(pushed / length[:, None]) @ turn[2] > _FRONT
    crosses = 1e3 * (measured @ turn.T)[seen]
    axes.plot(crosses[:, 0], crosses[:, 1], "x", color=INK, markersize=5, mew=1.2, zorder=4)
