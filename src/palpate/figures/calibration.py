"""Figures of calibrations, rigs, boards to print, and a recording over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float, Int, Real
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from palpate.calibration import (
    REGIONS,
    Calibration,
    CameraQuality,
    Charuco,
    PictureError,
    camera_quality,
    picture_errors,
)
from palpate.errors import InputError
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
from palpate.geometry import CREASE_ANGLE, TriangleMesh, unit_normals
from palpate.recording import Recorded
from palpate.records import Camera, Rig, camera_centre
from palpate.shapes import Vector3
from palpate.vision import project

_INCH = 0.0254
# Resolution of a page for printing, as PNG.
_DOTS_PER_INCH = 600.0
# Along a side of a bitmap: larger ones take gigabytes, and no program shows them.
_MOST_PIXELS = 30_000
_WIDTH = 3.2  # of one camera's panel [inches]
# Margin of the picture around an object, as a fraction of its size.
_AROUND = 0.3
# Scale of the residuals' arrows: one standard deviation has this fraction of the picture's width.
_ARROW = 0.02
_MAX_ARROWS = 3000
# Height of the bar chart of the views [inches], and number of names that it has room for.
_VIEWS_HEIGHT, _MOST_NAMED = 0.75, 13
# From a camera's frame (y down, z forward) to that of a 3-D plot, whose third axis is up.
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
# Resolution of a printed board, such that a module of a marker is a whole number of pixels.
_PIXELS_PER_SQUARE = 240
# Largest number of points of a line: more than 8 inches show at 150 dpi.
_POINTS = 4000


@styled
def residual_figure(calibration: Calibration) -> Figure:
    """Residuals of the bundle adjustment at every corner, by region and by view of each camera.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    Figure                          for each camera a column of two panels
    """
    cameras = calibration.cameras
    ratio = max(rows / columns for columns, rows in calibration.sightings.sizes)
    heights = _WIDTH * ratio, _VIEWS_HEIGHT
    figure = Figure(figsize=(_WIDTH * len(cameras), sum(heights) + 0.85), layout="constrained")
    grid = figure.add_gridspec(2, len(cameras), height_ratios=heights)
    pictures = picture_errors(calibration)
    highest = max((picture.rms for picture in pictures if np.isfinite(picture.rms)), default=1.0)
    for c, quality in enumerate(camera_quality(calibration)):
        _draw_corners(figure.add_subplot(grid[0, c]), calibration, c, quality)
        mine = [picture for picture in pictures if picture.camera == quality.name]
        _draw_views(figure.add_subplot(grid[1, c]), mine, highest, first=c == 0)
    figure.supxlabel(
        "arrows: residuals of the corners, one standard deviation drawn 2 % of the width; orange:"
        " left out. Figures: rms of a ninth [px], and its corners",
        fontsize=7.0,
    )
    return figure


def _draw_corners(axes: Axes, calibration: Calibration, c: int, quality: CameraQuality) -> None:
    """Draw a camera's residuals as arrows, and the rms of each of its nine regions."""
    corners = calibration.corners
    columns, rows = calibration.sightings.sizes[c]
    for good, colour in ((True, BLUE), (False, ORANGE)):
        mine = np.flatnonzero((corners.camera == c) & (calibration.adjusted.good == good))
        mine = mine[:: len(mine) // _MAX_ARROWS + 1]
        away = _ARROW * columns / quality.noise * calibration.adjusted.residual[mine]
        axes.quiver(
            *corners.pixel[mine].T, *away.T, angles="xy", scale_units="xy", scale=1.0,
            color=colour, width=0.0022,
        )  # fmt: skip
    for k in range(1, REGIONS):
        axes.axvline(k * columns / REGIONS, color=GREY, linewidth=0.3)
        axes.axhline(k * rows / REGIONS, color=GREY, linewidth=0.3)
    for (row, column), seen in np.ndenumerate(quality.seen):
        rms = f"{quality.rms[row, column]:.3f}, {seen}" if seen else "no board"
        axes.annotate(
            rms, (column * columns / REGIONS, row * rows / REGIONS), (3.0, -3.0),
            textcoords="offset points", ha="left", va="top", fontsize=6.0,
            color=INK if seen else ORANGE,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8},
        )  # fmt: skip
    axes.set(xlim=(0, columns), ylim=(rows, 0), aspect="equal", xticks=[], yticks=[])
    axes.set_title(f"{quality.name}: noise {quality.noise:.3f} px", parse_math=False)


def _draw_views(
    axes: Axes, pictures: Sequence[PictureError], highest: float, *, first: bool
) -> None:
    """Draw the rms of every view of a camera as a bar, with as many names as there is room for."""
    position = np.arange(len(pictures))
    axes.bar(position, [picture.rms for picture in pictures], color=BLUE, width=0.7)
    axes.set(xlim=(-0.7, len(pictures) - 0.3), ylim=(0.0, 1.1 * highest))
    step = -(-len(pictures) // _MOST_NAMED)
    axes.set_xticks(
        position[::step], [picture.view for picture in pictures[::step]], parse_math=False
    )
    axes.tick_params(axis="x", labelsize=6.0, length=2)
    axes.set_xlabel("view")
    if first:
        axes.set_ylabel("rms [px]")
    open_frame(axes)


@styled
def rig_figure(calibration: Calibration) -> Figure:
    """Cameras and boards in 3-D: in perspective, and from above.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    Figure                          lengths in mm, frame of the first camera
    """
    boards = [1e3 * line for line in _board_lines(calibration)]
    distance = float(np.linalg.norm(np.concatenate(boards).mean(axis=0)))
    cameras = [_camera_lines(camera, 0.15 * distance) for camera in calibration.cameras]
    names = [camera.name for camera in calibration.cameras]
    centres = [1e3 * camera_centre(camera) for camera in calibration.cameras]
    figure = Figure(figsize=(7.6, 3.9), layout="constrained")
    with mpl.rc_context({"grid.linewidth": 0.3, "grid.color": GREY}):
        space: Any = figure.add_subplot(1, 2, 1, projection="3d")
    above = figure.add_subplot(1, 2, 2)
    drawn = ((GREY, 0.5, boards), (BLUE, 1.0, [line for lines in cameras for line in lines]))
    for colour, width, lines in drawn:
        for line in lines:
            space.plot(*(line @ _UPRIGHT.T).T, color=colour, linewidth=width)
            above.plot(line[:, 0], line[:, 2], color=colour, linewidth=width)
    for name, centre in zip(names, centres, strict=True):
        space.text(*(_UPRIGHT @ centre - [0.0, 0.0, 0.07 * distance]), name, parse_math=False)
        above.annotate(
            name, (centre[0], centre[2]), (0.0, -9.0), textcoords="offset points", ha="center",
            parse_math=False,
        )  # fmt: skip
    _set_space(space)
    above.set(title="from above", xlabel="x mm", ylabel="z mm", aspect="equal")
    above.margins(0.08)
    open_frame(above)
    return figure


def _set_space(axes: Any) -> None:
    """Set 3-D axes to a perspective view from behind the cameras, with equal scales."""
    axes.set_proj_type("persp", focal_length=0.6)
    axes.view_init(elev=24.0, azim=-35.0)
    axes.set_aspect("equal")
    axes.set(title="in perspective", xlabel="x mm", ylabel="z mm", zlabel="- y mm")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(4))
        axis.set_tick_params(labelsize=6.0, pad=-2)
        axis.labelpad = -5


@styled
def object_figure(rig: Rig, mesh: TriangleMesh, grey: Sequence[Real[np.ndarray, "_ _"]]) -> Figure:
    """Silhouette and creases of a mesh over the pictures of the object, one panel per camera.

    Parameters
    ----------
    rig : Rig                       in the object frame
    mesh : TriangleMesh
    grey : sequence of c (rows, columns) [grey levels]    one picture for each camera

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(_WIDTH * len(grey), _WIDTH + 0.3), layout="constrained")
    for c, (camera, picture) in enumerate(zip(rig.cameras, grey, strict=True)):
        axes = figure.add_subplot(1, len(grey), c + 1)
        axes.imshow(picture, cmap="gray", vmin=0.0, vmax=255.0)
        pixel = project(camera, mesh.vertices)
        lines = pixel[drawn_edges(mesh, camera_centre(camera))]
        axes.add_collection(LineCollection(list(lines), colors=ORANGE, linewidths=0.8))
        low, high = np.nanmin(pixel, axis=0), np.nanmax(pixel, axis=0)
        half = 0.5 * (1.0 + _AROUND) * float((high - low).max())
        x, y = 0.5 * (low + high)
        axes.set(xlim=(x - half, x + half), ylim=(y + half, y - half), xticks=[], yticks=[])
        axes.set_title(camera.name, parse_math=False)
    return figure


def drawn_edges(mesh: TriangleMesh, eye: Vector3) -> Int[np.ndarray, "k 2"]:
    """Visible edges to draw: silhouette edges, between a front and a back face, and creases.

    Parameters
    ----------
    mesh : TriangleMesh
    eye : (3,) float [m]            from where it is seen

    Returns
    -------
    (k, 2) int                      vertices at their ends
    """
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
    """Outline of every board, in the frame of the first camera [m]."""
    corners, lines = calibration.corners, []
    for v, pose in enumerate(calibration.adjusted.bundle.view):
        low, high = (end(corners.point[corners.view == v], axis=0) for end in (np.min, np.max))
        x, y = np.array([low[0], high[0], high[0], low[0], low[0]]), low[[1, 1, 1, 1, 1]]
        rim = np.column_stack([x, np.where([0, 0, 1, 1, 0], high[1], y), np.zeros(5)])
        lines.append(rim @ pose[:3, :3].T + pose[:3, 3])
    return lines


def _camera_lines(camera: Camera, size: float) -> list[Float[np.ndarray, "k 3"]]:
    """Lines of a camera's viewing pyramid, `size` deep [mm]."""
    centre, k = 1e3 * camera_centre(camera), camera.matrix
    half = np.array([k[0, 2] / k[0, 0], k[1, 2] / k[1, 1], 1.0])
    sides = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]) * half
    corner = centre + size * sides @ camera.T_camera_object[:3, :3]
    return [corner[[0, 1, 2, 3, 0]], *(np.stack([centre, point]) for point in corner)]


@styled
def board_figure(board: Charuco) -> Figure:
    """A board in true size with a ruler below, to be printed without scaling.

    Parameters
    ----------
    board : Charuco

    Returns
    -------
    Figure                          of the size of the paper needed
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
    """Write a figure in true size, a bitmap at 600 dpi.

    Parameters
    ----------
    figure : Figure
    path : Path                     an existing file is replaced
    kind : str                      "pdf" or "png"

    Raises
    ------
    InputError                      a bitmap of too many pixels
    OSError                         the file cannot be written
    """
    pixels = figure.get_size_inches() * _DOTS_PER_INCH
    if kind == "png" and pixels.max() > _MOST_PIXELS:
        raise InputError(
            f"at {_DOTS_PER_INCH:g} dpi the page has {pixels[0]:.0f} x {pixels[1]:.0f} pixels; must"
            f" have {_MOST_PIXELS} a side at most: write a .pdf, or make the squares smaller"
        )
    figure.savefig(path, dpi=_DOTS_PER_INCH, format=kind)


@styled
def recording_figure(recorded: Recorded, name: str) -> Figure:
    """Force and motion over the whole recording, with plateaus and moments at rest.

    Parameters
    ----------
    recorded : Recorded
    name : str                      of the session, for the heading

    Returns
    -------
    Figure
    """
    rows = 1 + len(recorded.motions)
    figure = Figure(figsize=(8.4, 2.3 + 0.85 * len(recorded.motions)), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=True, height_ratios=[2.2, *[1.0] * (rows - 1)])
    axes = np.atleast_1d(axes)
    _draw_force(axes[0], recorded)
    for panel, motion, clock in zip(axes[1:], recorded.motions, recorded.clocks, strict=True):
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
        _draw_moments(panel, recorded)
        open_frame(panel)
    axes[-1].set_xlabel("time of the force log [s]")
    axes[-1].set_xlim(recorded.resampled.time[0], recorded.resampled.time[-1])
    figure.legend(handles=_keys(recorded), loc="outside lower center", ncols=4)
    used, all_of = len(recorded.presses), len(recorded.touches)
    figure.suptitle(
        f"{name}: {used} of {all_of} presses", fontsize=9, weight="bold", parse_math=False
    )
    return figure


def _keys(recorded: Recorded) -> list[Artist]:
    """Legend of the colours."""
    keys: list[Artist] = [
        Patch(color=MIDDLE_BLUE, alpha=0.7, label="picture at rest"),
        Patch(color=PALE_BLUE, label="plateau: nothing moves"),
        Line2D([], [], color=ORANGE, linewidth=2.0, label="force that is read"),
    ]
    if len(recorded.presses) < len(recorded.touches):
        keys.append(Patch(color=GREY, alpha=0.35, label="left out"))
    return keys


def _draw_force(axes: Axes, recorded: Recorded) -> None:
    """Draw the magnitude of the force without weight and drift, and the reading of each press."""
    even = recorded.resampled
    size = np.linalg.norm(even.force - recorded.zero.at(even.time), axis=1)
    every = max(1, len(size) // _POINTS)
    axes.plot(even.time[::every], size[::every], color=INK, linewidth=0.7)
    for press in recorded.presses:
        reading = press.reading
        force = float(np.linalg.norm(reading.force))
        axes.plot([reading.begin, reading.end], [force, force], color=ORANGE, linewidth=2.0)
        axes.annotate(
            press.name, (reading.time, force), (0.0, 4.0), textcoords="offset points",
            ha="center", fontsize=6.5, parse_math=False,
        )  # fmt: skip
    axes.set_ylim(0.0, 1.15 * float(np.nanmax(size)))
    axes.set_ylabel("force [N]")


def _draw_moments(axes: Axes, recorded: Recorded) -> None:
    """Draw plateaus and moments at rest as bands, and touches that are left out in grey."""
    used = {press.number for press in recorded.presses}
    for number, touch in enumerate(recorded.touches, start=1):
        if number not in used:
            axes.axvspan(touch.begin, touch.end, color=GREY, alpha=0.35, linewidth=0)
    for press in recorded.presses:
        axes.axvspan(press.reading.begin, press.reading.end, color=PALE_BLUE, linewidth=0, zorder=0)
        axes.axvspan(*press.rest, color=MIDDLE_BLUE, alpha=0.7, linewidth=0, zorder=0)
