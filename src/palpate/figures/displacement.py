"""Figure of the measured and predicted displacement of one probing on the object's surface."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from jaxtyping import Bool, Float, Shaped
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke

from palpate.estimation import ProbeFit
from palpate.figures.style import (
    INK,
    LIGHT,
    ORANGE,
    add_arrows,
    add_colour_bar,
    add_texts,
    magnification_text,
    styled,
    three_panels,
    title_panel,
)
from palpate.geometry import TriangleMesh, bounding_diagonal, closest_points, unit_normals
from palpate.records import Probing, observed_rows
from palpate.shapes import Flags, Indices, Matrix3, Points, PointScalars, TriangleScalars, Vector3

Points2 = Float[np.ndarray, "n 2"]
OUTLIER_WEIGHT = 0.1  # robust weight below which a point counts as an outlier
ARROWS_ACROSS = 12  # more would hide the points
LONGEST_ARROW = 0.13  # of the object's size in the picture
CLAY = LinearSegmentedColormap.from_list("clay", ["#b9bcc2", "#fafafa"])
# Colour maps with monotonic lightness, and without the grey of the body.
LENGTHS, RESIDUALS = "viridis", "YlOrRd"
MOST_SIGMAS = 4.0  # end of the colour scale of residuals
HELD = "#7d8796"  # colour of supports
MIN_FACING = 0.25  # cosine between normal and view below which a point is hard to see
ELEVATIONS = (15.0, 30.0, 45.0, 65.0)  # candidate views, degrees above the horizon
AZIMUTHS = 24


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceView:
    """A view of a surface: its front-facing triangles, from the farthest to the nearest.

    Attributes
    ----------
    R_view_object : (3, 3) float      rows: right, up, toward the viewer
    polygons : (m, 3, 2) float [m]    corners in the picture plane
    brightness : (m,) float           0 dark to 1 bright
    triangle : (m,) int               indices of these triangles in the surface
    """

    R_view_object: Matrix3
    polygons: Float[np.ndarray, "m 3 2"]
    brightness: TriangleScalars
    triangle: Indices


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """Content common to all three panels, in the viewer's frame and millimetres."""

    view: SurfaceView
    points: Points
    front: Flags
    contact: Vector3
    push: Vector3
    newtons: float
    held: Bool[np.ndarray, " m"]
    outlier: Flags
    size: float
    spot: float

    @property
    def used(self) -> Flags:
        """Points that are coloured: all but outliers, unless all points are outliers."""
        return self.outlier if self.outlier.all() else ~self.outlier


@styled
def displacement_figure(
    mesh: TriangleMesh, probing: Probing, fit: ProbeFit, *, held: Indices | None = None
) -> Figure | None:
    """Three views of the surface: measured and predicted displacement, and normalised residual.

    Colour is the length of the displacement, on the same scale in the first two panels; some points
    have arrows. Points on the far side are left out.

    Parameters
    ----------
    mesh : TriangleMesh
    probing : Probing
    fit : ProbeFit                  of that probing
    held : (k,) int or None         triangles of the supports, drawn darker

    Returns
    -------
    Figure or None                  None if nothing was measured
    """
    field = probing.displacement
    if field is None or not observed_rows(field).any():
        return None
    seen = observed_rows(field)
    normals = unit_normals(mesh)[field.surface.triangle[seen]]
    outlier = fit.weight[seen].min(axis=1) < OUTLIER_WEIGHT
    held = np.zeros(0, dtype=int) if held is None else held
    scene = _scene(mesh, probing, field.points[seen], normals, outlier, held)
    measured, predicted = field.displacement[seen], fit.predicted[seen]
    # What one camera does not see is drawn as predicted.
    measured = np.where(np.isnan(measured), predicted, measured)
    vectors = [
        1e3 * projected(scene.view, vector)
        for vector in (measured, predicted, measured - predicted)
    ]
    sigma = None if fit.sigma is None else fit.sigma[seen]
    return _drawn(probing.name, scene, vectors, _sigmas(measured - predicted, sigma))


def _sigmas(difference: Points, sigma: Points | None) -> PointScalars | None:
    """Rms over the components of residual over sigma, about 1 if model and sigmas are right."""
    return None if sigma is None else rms_of_known(difference / sigma)


def rms_of_known(vectors: Points) -> PointScalars:
    """Root mean square over the components that are known; NaN where none is.

    Parameters
    ----------
    vectors : (n, 3) float          NaN where not known
    """
    known = np.isfinite(vectors)
    squares = np.where(known, vectors, 0.0) ** 2
    mean = squares.sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return np.where(known.any(axis=1), np.sqrt(mean), np.nan)


def _scene(
    mesh: TriangleMesh,
    probing: Probing,
    positions: Points,
    normals: Points,
    outlier: Flags,
    held: Indices,
) -> _Scene:
    """Surface, points and force in the viewer's frame."""
    touched = closest_points(mesh, probing.contact.point[None]).triangle[0]
    view = make_view(mesh, best_direction(normals, unit_normals(mesh)[touched]))
    return _Scene(
        view=view,
        points=1e3 * projected(view, positions),
        front=normals @ view.R_view_object[2] > 0.05,
        contact=1e3 * projected(view, probing.contact.point),
        push=projected(view, probing.force / max(float(np.linalg.norm(probing.force)), 1e-300)),
        newtons=float(np.linalg.norm(probing.force)),
        held=np.isin(view.triangle, held),
        outlier=outlier,
        size=1e3 * bounding_diagonal(mesh),
        spot=float(np.clip(3000.0 / len(positions), 5.0, 42.0)),
    )


def _drawn(name: str, scene: _Scene, vectors: list[Points], sigmas: PointScalars | None) -> Figure:
    """The figure: two panels with one colour bar, the difference with its own."""
    lengths = [np.linalg.norm(vector, axis=1) for vector in vectors]
    used = scene.used
    largest = max(float(np.quantile(lengths[0][used], 0.99)), float(lengths[1].max()), 1e-9)
    worst = max(float(np.quantile(lengths[2][used], 0.95)), 1e-9)
    titles = ("measured", "predicted", "measured \N{MINUS SIGN} predicted")
    shown = [*lengths[:2], lengths[2] if sigmas is None else sigmas]
    last = worst if sigmas is None else MOST_SIGMAS
    scales = ((LENGTHS, largest, largest), (LENGTHS, largest, largest), (RESIDUALS, last, worst))
    arrow = LONGEST_ARROW * scene.size
    front = scene.front & scene.used
    arrows = [
        _bounded(arrow / top * vector[front, :2], 1.5 * arrow)
        for vector, (_, _, top) in zip(vectors, scales, strict=True)
    ]
    low, high = _extent(
        scene, np.concatenate([scene.points[front, :2] + panel_arrow for panel_arrow in arrows])
    )
    figure, panels = three_panels(high - low)
    for axes, title, panel_arrows, colour, (cmap, most, _) in zip(
        panels, titles, arrows, shown, scales, strict=True
    ):
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        draw_body(axes, scene.view, scene.held)
        _points(axes, scene, colour, cmap, most)
        add_arrows(axes, scene.points[front, :2], panel_arrows, pitch=scene.size / ARROWS_ACROSS)
        title_panel(axes, title)
    _contact(panels[0], scene)
    _scale_bar(panels[0])
    label = "displacement $|u|$ (mm)"
    add_colour_bar(figure, panels[:2], LENGTHS, Normalize(0.0, largest), label)
    label = "difference (mm)" if sigmas is None else "difference (sigmas)"
    add_colour_bar(figure, panels[2:], RESIDUALS, Normalize(0.0, last), label)
    rms = float(np.sqrt(np.mean(lengths[2][used] ** 2)))
    note = f"arrows: {magnification_text(arrow / largest)} the displacement, "
    note += f"{magnification_text(arrow / worst)} the difference"
    heading = f"{name}: {used.sum()} points, rms difference {rms:.3g} mm"
    add_texts(figure, heading, note, _left_out(scene))
    return figure


def _bounded(vectors: Points2, longest: float) -> Points2:
    """Arrows limited in length, so that they do not leave the picture."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors * np.minimum(1.0, longest / np.maximum(length, 1e-300)))


def _left_out(scene: _Scene) -> str:
    """Note on the parts of the picture without colour."""
    notes = ["dark: held"] if scene.held.any() else []
    if scene.outlier.any() and not scene.outlier.all():
        count = int(scene.outlier.sum())
        notes.append(f"\N{MULTIPLICATION SIGN} {count} outlier{'s' * (count > 1)}, excluded")
    hidden = int((~scene.front).sum())
    if hidden:
        notes.append(f"{hidden} point{'s' * (hidden > 1)} on the far side not drawn")
    return "; ".join(notes)


def _extent(
    scene: _Scene, ends: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Lower left and upper right corner of the picture [mm], with room for the arrow of the force
    and those of the points, which end at `ends`."""
    corners = 1e3 * scene.view.polygons.reshape(-1, 2)
    everything = np.concatenate([corners, _arrow_tail(scene)[None], ends])
    margin = 0.03 * scene.size
    return everything.min(axis=0) - margin, everything.max(axis=0) + margin


def _arrow_tail(scene: _Scene) -> Float[np.ndarray, "2"]:
    """Start of the force's arrow [mm]."""
    return (scene.contact - 0.2 * scene.size * scene.push)[:2]


def _points(axes: Axes, scene: _Scene, length: PointScalars, cmap: str, top: float) -> None:
    """Draw the observed points on the near side, coloured by length, and outliers as crosses."""
    used = scene.front & scene.used
    shown = scene.points[used]
    axes.scatter(
        shown[:, 0], shown[:, 1], c=length[used], s=scene.spot, cmap=cmap,
        norm=Normalize(0.0, top), linewidths=0.15, edgecolors=INK, zorder=2,
    )  # fmt: skip
    crossed = scene.points[scene.front & ~used]
    axes.scatter(
        crossed[:, 0], crossed[:, 1], s=scene.spot, marker="x", color=INK, linewidths=0.7, zorder=2
    )


def _contact(axes: Axes, scene: _Scene) -> None:
    """Draw the contact point and the force on it."""
    tip, tail = scene.contact[:2], _arrow_tail(scene)
    axes.annotate(
        "", xy=(tip[0], tip[1]), xytext=(tail[0], tail[1]), zorder=5,
        arrowprops={"arrowstyle": "-|>", "color": ORANGE, "linewidth": 1.6, "shrinkA": 0,
                    "shrinkB": 0, "mutation_scale": 9},
    )  # fmt: skip
    axes.plot(*tip, "o", color=ORANGE, markersize=3, zorder=5)
    if scene.newtons > 0.0:
        axes.annotate(
            f"{scene.newtons:.3g} N", (tail[0], tail[1]), (3, 1), textcoords="offset points",
            color=ORANGE, fontsize=7.5, weight="bold", zorder=6, annotation_clip=False,
            path_effects=[Stroke(linewidth=2.0, foreground="white"), Normal()],
        )  # fmt: skip


def _scale_bar(axes: Axes) -> None:
    """Draw a scale bar of a round length in the lower left corner."""
    (left, right), bottom = axes.get_xlim(), axes.get_ylim()[0]
    target, start = 0.22 * (right - left), left + 0.03 * (right - left)
    power = 10.0 ** np.floor(np.log10(target))
    length = float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= target))
    axes.plot([start, start + length], [bottom] * 2, color=INK, linewidth=1.6, clip_on=False)
    axes.annotate(
        f"{length:g} mm", (start + length, bottom), xytext=(3, 0), textcoords="offset points",
        va="center", fontsize=7, annotation_clip=False,
    )  # fmt: skip


def best_direction(normals: Points, contact_normal: Vector3) -> Vector3:
    """Direction toward the viewer from which most points, and the contact, are visible.

    Parameters
    ----------
    normals : (n, 3) float      outward unit normals at the observed points
    contact_normal : (3,) float outward unit normal at the contact

    Returns
    -------
    (3,) float                  unit vector, z up
    """
    azimuth = np.radians(np.arange(AZIMUTHS) * 360.0 / AZIMUTHS - 60.0)
    elevation = np.radians(ELEVATIONS)
    phi, theta = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
    views = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), np.sin(theta)], 1)
    facing = normals @ views.T
    score = (facing > MIN_FACING).mean(axis=0)
    # An oblique view is better than a frontal one, as it shows the shape too.
    score -= 0.1 * np.abs(facing.mean(axis=0) - 0.6)
    score += 0.3 * np.clip(contact_normal @ views.T, -0.5, 0.5)
    return views[int(np.argmax(score))]


def make_view(mesh: TriangleMesh, direction: Vector3) -> SurfaceView:
    """Orthographic view of a surface along a direction.

    Parameters
    ----------
    mesh : TriangleMesh
    direction : (3,) float      unit, toward the viewer

    Returns
    -------
    SurfaceView
    """
    rotation = _rotation(direction)
    corners = (mesh.vertices @ rotation.T)[mesh.triangles]
    normals = unit_normals(mesh) @ rotation.T
    front = np.flatnonzero(normals[:, 2] > 0.0)
    order = front[np.argsort(corners[front, :, 2].mean(axis=1))]
    light = np.array(LIGHT) / np.linalg.norm(LIGHT)
    brightness = np.clip(normals[order] @ light, 0.0, 1.0)
    return SurfaceView(rotation, corners[order, :, :2], brightness, order)


def draw_body(axes: Axes, view: SurfaceView, held: Bool[np.ndarray, " m"]) -> None:
    """Draw shaded triangles, nearest last, in millimetres.

    Parameters
    ----------
    axes : Axes                 with limits
    view : SurfaceView
    held : (m,) bool            triangles of the view that are drawn darker
    """
    colours = CLAY(view.brightness)
    colours[held, :3] = (0.75 + 0.25 * view.brightness[held, None]) * np.array(to_rgb(HELD))
    polygons = PolyCollection(
        cast(Any, 1e3 * view.polygons), facecolors=colours, edgecolors=colours, linewidths=0.3
    )
    # The limits are set already, and finding them takes time.
    axes.add_collection(polygons, autolim=False)


def projected(view: SurfaceView, points: Shaped[np.ndarray, "*n 3"]) -> Shaped[np.ndarray, "*n 3"]:
    """Points or vectors in the viewer's frame: right, up, toward the viewer.

    Parameters
    ----------
    view : SurfaceView
    points : (..., 3) float [m]     points or vectors, object frame

    Returns
    -------
    (..., 3) float [m]
    """
    return points @ view.R_view_object.T


def _rotation(direction: Vector3) -> Matrix3:
    """Rows right, up, toward the viewer; the object's z points up in the picture."""
    right = np.cross([0.0, 0.0, 1.0], direction)
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right), direction])
