"""Pictures of a calibration: residuals and coverage of every camera, the rig; boards to print."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from palpate.calibration import REGIONS, Calibration, Charuco
from palpate.figures.style import BLUE, GREY, ORANGE, styled
from palpate.geometry import CREASE_ANGLE, TriangleMesh, unit_normals
from palpate.records import Camera, Rig, camera_centre
from palpate.shapes import Vector3
from palpate.vision import project

_INCH = 0.0254
# Of a printed page that is kept as PNG.
_DOTS_PER_INCH = 600.0
_WIDTH = 3.2  # of one camera's panel [inches]
# Picture around an object, of its size.
_AROUND = 0.3
# Arrows of residuals: the noise is drawn as long as this share of the picture's width.
_ARROW = 0.02
_MAX_ARROWS = 3000
# Sampling of a printed board: a module of a marker is a whole number of pixels.
_PIXELS_PER_SQUARE = 240


@styled
def residual_figure(calibration: Calibration) -> Figure:
    """What the adjustment leaves at every corner, a panel for each camera.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    Figure
    """
    cameras, corners = calibration.cameras, calibration.corners
    ratio = max(rows / columns for columns, rows in calibration.found.sizes)
    figure = Figure(figsize=(_WIDTH * len(cameras), _WIDTH * ratio + 0.55), layout="constrained")
    for c, camera in enumerate(cameras):
        axes = figure.add_subplot(1, len(cameras), c + 1)
        columns, rows = calibration.found.sizes[c]
        noise = float(calibration.adjusted.noise[c])
        for good, colour in ((True, BLUE), (False, ORANGE)):
            mine = np.flatnonzero((corners.camera == c) & (calibration.adjusted.good == good))
            mine = mine[:: len(mine) // _MAX_ARROWS + 1]
            away = _ARROW * columns / noise * calibration.adjusted.residual[mine]
            axes.quiver(
                *corners.pixel[mine].T, *away.T, angles="xy", scale_units="xy", scale=1.0,
                color=colour, width=0.0022,
            )  # fmt: skip
        for k in range(1, REGIONS):
            axes.axvline(k * columns / REGIONS, color=GREY, linewidth=0.3)
            axes.axhline(k * rows / REGIONS, color=GREY, linewidth=0.3)
        axes.set(xlim=(0, columns), ylim=(rows, 0), aspect="equal", xticks=[], yticks=[])
        axes.set_title(f"{camera.name}: {noise:.3f} px", parse_math=False)
    figure.supxlabel(
        "residuals of the corners, one standard deviation drawn 2 % of the width; orange: left out",
        fontsize=7.0,
    )
    return figure


@styled
def rig_figure(calibration: Calibration) -> Figure:
    """Cameras and boards in space, from above and from the side.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    Figure                          lengths in mm, frame of the first camera
    """
    boards = [1e3 * line for line in _board_lines(calibration)]
    distance = float(np.linalg.norm(np.concatenate(boards).mean(axis=0)))
    figure = Figure(figsize=(7.2, 3.6), layout="constrained")
    panels = {"from above": (0, 2), "from the side": (2, 1)}
    for number, (title, (right, up)) in enumerate(panels.items(), start=1):
        axes = figure.add_subplot(1, 2, number)
        for line in boards:
            axes.plot(line[:, right], line[:, up], color=GREY, linewidth=0.5)
        for camera in calibration.cameras:
            for line in _camera_lines(camera, 0.15 * distance):
                axes.plot(line[:, right], line[:, up], color=BLUE, linewidth=1.0)
            place = 1e3 * camera_centre(camera)
            axes.annotate(
                camera.name, (place[right], place[up]), (0.0, -9.0), textcoords="offset points",
                ha="center", parse_math=False,
            )  # fmt: skip
        axes.set(title=title, xlabel=f"{'xyz'[right]} mm", ylabel=f"{'xyz'[up]} mm", aspect="equal")
        axes.margins(0.08)
        if up == 1:
            # y points down in a camera's frame.
            axes.invert_yaxis()
    return figure


@styled
def object_figure(rig: Rig, mesh: TriangleMesh, grey: Sequence[Float[np.ndarray, "_ _"]]) -> Figure:
    """Outlines and creases of a mesh over the pictures of the object, a panel for each camera.

    Parameters
    ----------
    rig : Rig                       object frame
    mesh : TriangleMesh
    grey : sequence of c (rows, columns) float [grey levels]

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(_WIDTH * len(grey), _WIDTH + 0.3), layout="constrained")
    for c, (camera, picture) in enumerate(zip(rig.cameras, grey, strict=True)):
        axes = figure.add_subplot(1, len(grey), c + 1)
        axes.imshow(picture, cmap="gray", vmin=0.0, vmax=255.0)
        pixel = project(camera, mesh.vertices)
        lines = pixel[_drawn_edges(mesh, camera_centre(camera))]
        axes.add_collection(LineCollection(list(lines), colors=ORANGE, linewidths=0.8))
        low, high = np.nanmin(pixel, axis=0), np.nanmax(pixel, axis=0)
        half = 0.5 * (1.0 + _AROUND) * float((high - low).max())
        x, y = 0.5 * (low + high)
        axes.set(xlim=(x - half, x + half), ylim=(y + half, y - half), xticks=[], yticks=[])
        axes.set_title(camera.name, parse_math=False)
    return figure


def _drawn_edges(mesh: TriangleMesh, eye: Vector3) -> Int[np.ndarray, "k 2"]:
    """Edges between a triangle that turns to an eye and one that does not, or at a crease."""
    toward = np.einsum(
        "ma,ma->m", unit_normals(mesh), eye - mesh.vertices[mesh.triangles].mean(axis=1)
    )
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    owner = np.repeat(np.arange(len(mesh.triangles)), 3)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    twin = (edges[1:] == edges[:-1]).all(axis=1)
    first, second = owner[:-1][twin], owner[1:][twin]
    normal = unit_normals(mesh)
    sharp = np.einsum("ka,ka->k", normal[first], normal[second]) < np.cos(CREASE_ANGLE)
    seen = (toward[first] > 0.0) | (toward[second] > 0.0)
    outline = (toward[first] > 0.0) != (toward[second] > 0.0)
    return np.asarray(edges[:-1][twin][seen & (sharp | outline)])


def _board_lines(calibration: Calibration) -> list[Float[np.ndarray, "5 3"]]:
    """Rim of every board [m]."""
    corners, lines = calibration.corners, []
    for v, pose in enumerate(calibration.adjusted.bundle.view):
        low, high = (end(corners.point[corners.view == v], axis=0) for end in (np.min, np.max))
        x, y = np.array([low[0], high[0], high[0], low[0], low[0]]), low[[1, 1, 1, 1, 1]]
        rim = np.column_stack([x, np.where([0, 0, 1, 1, 0], high[1], y), np.zeros(5)])
        lines.append(rim @ pose[:3, :3].T + pose[:3, 3])
    return lines


def _camera_lines(camera: Camera, size: float) -> list[Float[np.ndarray, "k 3"]]:
    """Rays of the corners of a picture, `size` [mm] deep, and its rim."""
    centre, k = 1e3 * camera_centre(camera), camera.matrix
    half = np.array([k[0, 2] / k[0, 0], k[1, 2] / k[1, 1], 1.0])
    sides = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]) * half
    corner = centre + size * sides @ camera.T_camera_object[:3, :3]
    return [corner[[0, 1, 2, 3, 0]], *(np.stack([centre, point]) for point in corner)]


@styled
def board_figure(board: Charuco) -> Figure:
    """A board in true size with a ruler below, for a printer that does not scale.

    Parameters
    ----------
    board : Charuco

    Returns
    -------
    Figure                          its size in inches is that of the paper needed
    """
    width, height = board.columns * board.square / _INCH, board.rows * board.square / _INCH
    margin, foot = 0.4, 0.85
    total = (width + 2 * margin, height + margin + foot)
    figure = Figure(figsize=total)
    axes = figure.add_axes(
        (margin / total[0], foot / total[1], width / total[0], height / total[1])
    )
    axes.imshow(
        board.drawing(_PIXELS_PER_SQUARE), cmap="gray", vmin=0, vmax=255, interpolation="none"
    )
    axes.set_axis_off()
    length = 0.01 * int(100 * board.columns * board.square)
    ruler = figure.add_axes(
        (margin / total[0], 0.5 / total[1], length / _INCH / total[0], 0.12 / total[1])
    )
    ruler.set(xlim=(0, 100 * length), ylim=(0, 1), yticks=[])
    ruler.set_xticks(np.arange(0, 100 * length + 0.5))
    ruler.tick_params(labelsize=5.5, length=2)
    figure.text(
        margin / total[0], 0.08 / total[1],
        "cm: print at 100 % and measure this ruler\n"
        f"{board.columns} x {board.rows}, {1e3 * board.square:g} and {1e3 * board.marker:g} mm,"
        f" {board.dictionary}, first {board.first}",
        fontsize=5.5,
    )  # fmt: skip
    return figure


@styled
def save_page(figure: Figure, path: Path, *, kind: str) -> None:
    """Write a figure in its true size.

    Parameters
    ----------
    figure : Figure
    path : Path
    kind : str                      "pdf" or "png"

    Raises
    ------
    OSError                         the file cannot be written
    """
    figure.savefig(path, dpi=_DOTS_PER_INCH, format=kind)
