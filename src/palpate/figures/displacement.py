"""Measured against predicted displacement of one probing, on the object's surface."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpecFromSubplotSpec, SubplotSpec
from matplotlib.ticker import MaxNLocator

from palpate.estimation import ProbeFit
from palpate.figures.surface_view import SurfaceView, best_direction, make_view, projected
from palpate.geometry import TriangleMesh, bounding_diagonal, closest_points, unit_normals
from palpate.records import Probing, observed_rows
from palpate.shapes import Flags, Points, PointScalars, Vector3

INK, RED = "#1c1f24", "#D55E00"
OFF = 0.1  # robust weight under which a point counts as an outlier
ARROWS = 60  # more would hide the points
LONGEST_ARROW = 0.13  # of the object's size in the picture
PANEL = 2.3  # inches
CLAY = LinearSegmentedColormap.from_list("clay", ["#a9adb4", "#f4f5f6"])


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What all three panels share, in the viewer's frame and millimetres."""

    view: SurfaceView
    place: Points
    front: Flags
    contact: Vector3
    push: Vector3
    off: Flags
    size: float
    spot: float


def displacement_figure(mesh: TriangleMesh, probing: Probing, fit: ProbeFit) -> Figure | None:
    """Three views of the surface: measured, predicted, and their difference.

    Points carry the length of their displacement as colour, the same scale for the first two;
    arrows are drawn at some of them. Points on the far side are left out.

    Parameters
    ----------
    mesh : TriangleMesh
    probing : Probing
    fit : ProbeFit          of that probing

    Returns
    -------
    Figure, or None where nothing was measured
    """
    field = probing.displacement
    if field is None or not observed_rows(field).any():
        return None
    seen = observed_rows(field)
    normals = unit_normals(mesh)[field.surface.triangle[seen]]
    touched = closest_points(mesh, probing.contact.point[None]).triangle[0]
    direction = best_direction(normals, unit_normals(mesh)[touched])
    off = fit.weight[seen].min(axis=1) < OFF
    scene = _scene(mesh, probing, field.points[seen], normals, direction, off)
    residual = field.displacement[seen] - fit.predicted[seen]
    vectors = [
        1e3 * projected(scene.view, moved)
        for moved in (field.displacement[seen], fit.predicted[seen], residual)
    ]
    return _drawn(probing.name, scene, vectors)


def _scene(
    mesh: TriangleMesh,
    probing: Probing,
    points: Points,
    normals: Points,
    direction: Vector3,
    off: Flags,
) -> _Scene:
    """Surface, points and force as the viewer has them."""
    view = make_view(mesh, direction)
    force = probing.force / np.linalg.norm(probing.force)
    return _Scene(
        view=view,
        place=1e3 * projected(view, points),
        front=normals @ view.R_view_object[2] > 0.05,
        contact=1e3 * projected(view, probing.contact.point),
        push=projected(view, force),
        off=off,
        size=1e3 * bounding_diagonal(mesh),
        spot=float(np.clip(3000.0 / len(points), 5.0, 42.0)),
    )


def _drawn(name: str, scene: _Scene, vectors: list[Points]) -> Figure:
    """The figure: two panels with one colour bar, the residual with its own."""
    lengths = [np.linalg.norm(moved, axis=1) for moved in vectors]
    used = ~scene.off if not scene.off.all() else scene.off
    largest = max(float(np.quantile(lengths[0][used], 0.99)), float(lengths[1].max()), 1e-9)
    over = max(float(np.quantile(lengths[2][used], 0.95)), 1e-9)
    figure, panels, bars = _layout(scene)
    titles = ("measured", "predicted", "measured \N{MINUS SIGN} predicted")
    scales = (("cividis", largest), ("cividis", largest), ("magma_r", over))
    for axes, title, moved, length, (cmap, top) in zip(
        panels, titles, vectors, lengths, scales, strict=True
    ):
        _surface(axes, scene)
        _points(axes, scene, length, cmap, top)
        _arrows(axes, scene, moved, LONGEST_ARROW * scene.size / top)
        # A title proper would look for room above ticks that are not there: it takes 30 ms.
        axes.text(0.5, 1.03, title, transform=axes.transAxes, ha="center", fontsize=8.5)
    _contact(panels[0], scene)
    _scale_bar(panels[0])
    _bar(figure, bars[0], "cividis", largest, "displacement $|u|$ (mm)", 0.32)
    _bar(figure, bars[1], "magma_r", over, "difference (mm)", 0.7)
    rms = float(np.sqrt(np.mean(lengths[2][used] ** 2)))
    text = f"{name}: {used.sum()} points, rms difference {rms:.3g} mm"
    figure.text(
        0.5, 0.965, text, ha="center", va="top", fontsize=9, weight="bold", parse_math=False
    )
    size = LONGEST_ARROW * scene.size
    said = f"arrows: {_times(size / largest)} the displacement, "
    said += f"{_times(size / over)} the difference"
    figure.text(0.01, 0.02, said, ha="left", va="bottom", fontsize=6.5)
    figure.text(0.99, 0.02, _left_out(scene), ha="right", va="bottom", fontsize=6.5)
    return figure


def _times(factor: float) -> str:
    """A factor to two digits, never with an exponent."""
    return f"{factor:.2g} times" if factor < 10 else f"{factor:.0f} times"


def _left_out(scene: _Scene) -> str:
    """What the picture does not colour, in words."""
    said = []
    if scene.off.any() and not scene.off.all():
        count = int(scene.off.sum())
        said.append(f"\N{MULTIPLICATION SIGN} {count} outlier{'s' * (count > 1)}, left aside")
    hidden = int((~scene.front).sum())
    if hidden:
        said.append(f"{hidden} point{'s' * (hidden > 1)} on the far side not drawn")
    return "; ".join(said)


def _layout(scene: _Scene) -> tuple[Figure, list[Axes], tuple[SubplotSpec, SubplotSpec]]:
    """Figure, its three panels with their limits, and the cells of the two colour bars."""
    low, high = _extent(scene)
    height = float(np.clip(PANEL * (high[1] - low[1]) / (high[0] - low[0]), 1.2, 3.4))
    total = height + 1.15
    figure = Figure(figsize=(3 * PANEL + 0.3, total))
    grid = figure.add_gridspec(
        2, 3, height_ratios=[1.0, 0.08 / height], left=0.01, right=0.99,
        top=1 - 0.48 / total, bottom=0.56 / total, wspace=0.03, hspace=0.06,
    )  # fmt: skip
    panels = [figure.add_subplot(grid[0, column]) for column in range(3)]
    for axes in panels:
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_aspect("equal")
        axes.set_axis_off()
    return figure, panels, (grid[1, 0:2], grid[1, 2])


def _extent(scene: _Scene) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Lower left and upper right of the picture [mm], with room for the force's arrow."""
    corners = 1e3 * scene.view.polygons.reshape(-1, 2)
    tail = (scene.contact - 0.2 * scene.size * scene.push)[None, :2]
    everything = np.concatenate([corners, tail])
    more = 0.03 * scene.size
    return everything.min(axis=0) - more, everything.max(axis=0) + more


def _surface(axes: Axes, scene: _Scene) -> None:
    """Shaded triangles, nearest last."""
    colours = CLAY(scene.view.brightness)
    axes.add_collection(
        PolyCollection(
            cast(Any, 1e3 * scene.view.polygons),
            facecolors=colours,
            edgecolors=colours,
            linewidths=0.3,
        ),
        autolim=False,  # the limits are set: looking at each corner takes time
    )


def _points(axes: Axes, scene: _Scene, length: PointScalars, cmap: str, top: float) -> None:
    """Observed points on the near side, coloured by length; outliers as crosses."""
    used = scene.front & (~scene.off | scene.off.all())
    place = scene.place[used]
    axes.scatter(
        place[:, 0], place[:, 1], c=length[used], s=scene.spot, cmap=cmap,
        norm=Normalize(0.0, top), linewidths=0.15, edgecolors=INK, zorder=2,
    )  # fmt: skip
    crossed = scene.place[scene.front & ~used]
    axes.scatter(
        crossed[:, 0], crossed[:, 1], s=scene.spot, marker="x", color=INK, linewidths=0.7, zorder=2
    )


def _arrows(axes: Axes, scene: _Scene, moved: Points, stretch: float) -> None:
    """Displacements of some points as arrows in the picture plane."""
    front = np.flatnonzero(scene.front & (~scene.off | scene.off.all()))
    chosen = front[_spread(scene.place[front, :2], ARROWS)]
    place, vector = scene.place[chosen, :2], stretch * moved[chosen, :2]
    axes.quiver(
        place[:, 0], place[:, 1], vector[:, 0], vector[:, 1], angles="xy", scale_units="xy",
        scale=1.0, width=0.005, headwidth=3.6, headlength=4.2, color=INK, zorder=3,
    )  # fmt: skip


def _spread(place: Float[np.ndarray, "n 2"], count: int) -> list[int]:
    """Indices of at most `count` points, each as far as it can be from the ones before."""
    if len(place) == 0:
        return []
    chosen = [0]
    distance = np.linalg.norm(place - place[0], axis=1)
    while len(chosen) < min(count, len(place)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(place - place[chosen[-1]], axis=1))
    return chosen


def _contact(axes: Axes, scene: _Scene) -> None:
    """The contact point and the direction of the force on it."""
    tip, tail = scene.contact[:2], (scene.contact - 0.2 * scene.size * scene.push)[:2]
    axes.annotate(
        "", xy=(tip[0], tip[1]), xytext=(tail[0], tail[1]), zorder=5,
        arrowprops={"arrowstyle": "-|>", "color": RED, "linewidth": 1.6, "shrinkA": 0,
                    "shrinkB": 0, "mutation_scale": 9},
    )  # fmt: skip
    axes.plot(*tip, "o", color=RED, markersize=3, zorder=5)


def _scale_bar(axes: Axes) -> None:
    """A bar of a round length in the lower left corner."""
    low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
    target = 0.22 * float(high[0] - low[0])
    power = 10.0 ** np.floor(np.log10(target))
    length = float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= target))
    x, y = float(low[0]) + 0.03 * float(high[0] - low[0]), float(low[1])
    axes.plot([x, x + length], [y, y], color=INK, linewidth=1.6, clip_on=False)
    axes.annotate(
        f"{length:g} mm", (x + length, y), xytext=(3, 0), textcoords="offset points",
        va="center", fontsize=7, annotation_clip=False,
    )  # fmt: skip


def _bar(
    figure: Figure, cell: SubplotSpec, cmap: str, top: float, label: str, share: float
) -> None:
    """A horizontal colour bar in the middle of a cell."""
    side = (1.0 - share) / 2.0
    parts = GridSpecFromSubplotSpec(1, 3, subplot_spec=cell, width_ratios=[side, share, side])
    axes = figure.add_subplot(parts[0, 1])
    bar = figure.colorbar(
        ScalarMappable(Normalize(0.0, top), cmap), cax=axes, orientation="horizontal",
        extend="max",
        ticks=MaxNLocator(4),
    )  # fmt: skip
    bar.outline.set_linewidth(0.4)
    bar.set_label(label, labelpad=2)
