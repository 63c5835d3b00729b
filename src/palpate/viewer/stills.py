"""Picture and turntable video of the object, without a browser or a display."""

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from PIL import Image

from palpate.disk import atomic_replacement, write_errors
from palpate.errors import InputError
from palpate.figures import (
    GREY,
    HELD,
    INK,
    LENGTHS,
    ORANGE,
    figure_pixels,
    make_view,
    projected,
    styled,
)
from palpate.geometry import TriangleMesh, bounding_diagonal, closest_points, unit_normals
from palpate.pipeline import FittedProbing
from palpate.progress import Progress, silent
from palpate.shapes import Vector3, Vertices
from palpate.viewer.stage import (
    MEASURED,
    PREDICTED,
    ColouredField,
    coloured_field,
    colours_of,
    direction_of,
)
from palpate.viewer.subject import Subject, shown_probings

# Number of pictures of one revolution, and duration of each [s].
_VIEWS, _PACE = 72, 0.06
# Drawn length of the largest displacement, and of the force's arrow, as fractions of the object's
# size.
_SHOWN, _ARROW = 0.06, 0.22
# Size of the figure [inch], panel that shows the object, and fraction of the panel left free.
_FIGURE, _PART, _FREE = np.array([5.6, 5.2]), (0.02, 0.13, 0.96, 0.77), 0.1
_LINE = 60
_CLAY = "#d4d7db"
# A codec that browsers play, and one that every build of OpenCV has.
_CODECS = ("vp09", "mp4v")


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """The content of all views: one probing with its field and magnification."""

    subject: Subject
    probing: FittedProbing | None
    field: ColouredField | None
    magnification: float

    @property
    def surface(self) -> np.ndarray | None:
        """Displacement of the vertices predicted by the model, if known [m]."""
        return None if self.probing is None else self.probing.surface

    @property
    def drawn(self) -> TriangleMesh:
        """The surface with magnified displacement."""
        mesh = self.subject.session.mesh
        displacement = np.zeros_like(mesh.vertices) if self.surface is None else self.surface
        return TriangleMesh(mesh.vertices + self.magnification * displacement, mesh.triangles)

    @property
    def arrow(self) -> np.ndarray | None:
        """Tail and tip of the force's arrow, (2, 3) [m]; None without a force."""
        probing = self.probing
        newtons = 0.0 if probing is None else float(np.linalg.norm(probing.force))
        if probing is None or not newtons:
            return None
        size = bounding_diagonal(self.subject.session.mesh)
        return np.array(
            [probing.contact - _ARROW * size * probing.force / newtons, probing.contact]
        )

    @property
    def middle(self) -> Vector3:
        """Centre of every view: the middle of the object's bounding box [m]."""
        vertices = self.subject.session.mesh.vertices
        return np.asarray(0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))


def write_screenshot(subject: Subject, path: Path, *, probe: str | None = None) -> None:
    """Write a picture of an object: deformed by the fitted model, or with the measured points.

    Parameters
    ----------
    subject : Subject
    path : Path                     .png or .jpg; an existing file is replaced
    probe : str or None             probing that is shown; None: the first

    Raises
    ------
    InputError                      another suffix, no such probing
    RecordError                     the file cannot be written
    """
    _check_kind(path, (".png", ".jpg", ".jpeg"))
    shown = _shown(subject, probe)
    direction = direction_of(subject)
    pixels = _pixels(shown, direction, _reach(shown, [direction]))
    with atomic_replacement(path) as partial, write_errors(path):
        form = "PNG" if path.suffix.lower() == ".png" else "JPEG"
        Image.fromarray(pixels).save(partial, form)


def write_turntable(
    subject: Subject, path: Path, *, probe: str | None = None, progress: Progress = silent
) -> None:
    """Write a video in which the object turns once about the vertical.

    Parameters
    ----------
    subject : Subject
    path : Path                     .mp4 or .gif; an existing file is replaced
    probe : str or None             probing that is shown; None: the first
    progress : callable             called with the current step (text) and the fraction done, 0..1

    Raises
    ------
    InputError                      another suffix, no such probing
    RecordError                     the file cannot be written
    """
    _check_kind(path, (".mp4", ".gif"))
    shown = _shown(subject, probe)
    start = direction_of(subject)
    directions = [_turned(start, 2 * np.pi * number / _VIEWS) for number in range(_VIEWS)]
    reach, views = _reach(shown, directions), []
    for number, direction in enumerate(directions):
        progress("turntable", number / _VIEWS)
        views.append(_pixels(shown, direction, reach))
    with atomic_replacement(path) as partial, write_errors(path):
        write: Callable[[Path, list[np.ndarray]], None]
        write = _write_gif if path.suffix.lower() == ".gif" else _write_mp4
        write(partial, views)


def _check_kind(path: Path, kinds: tuple[str, ...]) -> None:
    if path.suffix.lower() not in kinds:
        raise InputError(f"{path}: must end in {' or '.join(kinds)}")


def _shown(subject: Subject, probe: str | None) -> _Shown:
    probings = shown_probings(subject)
    names = [probing.name for probing in probings]
    if probe is not None and probe not in names:
        raise InputError(f"there is no probing '{probe}'; there are: {', '.join(names) or 'none'}")
    if not probings:
        return _Shown(subject, None, None, 1.0)
    probing = probings[names.index(probe) if probe else 0]
    field = coloured_field(probing, MEASURED if probing.surface is None else PREDICTED)
    displacement = field.displacement if probing.surface is None and field else probing.surface
    largest = 0.0 if displacement is None else float(np.linalg.norm(displacement, axis=1).max())
    if probing.surface is not None and field is not None:
        # The scale ends at the largest drawn value, so that no colour is ambiguous.
        lengths = _face_lengths(subject.session.mesh, probing.surface)
        field = replace(field, top=max(float(lengths.max()), 1e-6))
    size = bounding_diagonal(subject.session.mesh)
    # Large deformation is drawn as it is.
    magnification = max(_SHOWN * size / largest, 1.0) if largest else 1.0
    return _Shown(subject, probing, field, magnification)


def _reach(shown: _Shown, directions: Sequence[Vector3]) -> Float[np.ndarray, "2"]:
    """Half width and half height of the pictures [mm], so that the object fits in all views."""
    drawn, room = shown.drawn, (1.0 - _FREE) * _FIGURE * _PART[2:]
    arrow = drawn.vertices[:0] if shown.arrow is None else shown.arrow
    points = np.concatenate([drawn.vertices, arrow]) - shown.middle
    seen = [projected(make_view(drawn, direction), points)[:, :2] for direction in directions]
    return np.asarray(1e3 * float((np.abs(seen) / room).max()) * _FIGURE * _PART[2:])


@styled
def _pixels(
    shown: _Shown, direction: Vector3, reach: Float[np.ndarray, "2"]
) -> UInt8[np.ndarray, "_ _ 3"]:
    """Pixels of one view."""
    drawn = shown.drawn
    figure = Figure(figsize=tuple(_FIGURE))
    axes = figure.add_axes(_PART)
    axes.set_axis_off()
    _surface(axes, shown, drawn, direction)
    _force(axes, shown, drawn, direction)
    x, y, _ = 1e3 * projected(make_view(drawn, direction), shown.middle)
    axes.set(xlim=(x - reach[0], x + reach[0]), ylim=(y - reach[1], y + reach[1]), aspect="equal")
    _texts(figure, shown)
    return figure_pixels(figure)[..., :3]


def _surface(axes: Axes, shown: _Shown, drawn: TriangleMesh, direction: Vector3) -> None:
    """Draw shaded triangles, coloured by the model's displacement, or grey with measured points."""
    view = make_view(drawn, direction)
    light = (0.62 + 0.38 * view.brightness)[:, None]
    colours = np.tile(np.array(to_rgb(_CLAY)), (len(view.triangle), 1))
    field = shown.field
    if shown.surface is not None and field is not None:
        lengths = _face_lengths(drawn, shown.surface)[view.triangle]
        colours = colours_of(lengths, field.top, LENGTHS) / 255
    colours[np.isin(view.triangle, shown.subject.session.held_triangles)] = to_rgb(HELD)
    polygons = cast(Any, 1e3 * view.polygons)
    axes.add_collection(
        PolyCollection(polygons, facecolors=colours * light, edgecolors=INK, linewidths=0.12)
    )
    if shown.surface is None and field is not None:
        _points(axes, shown, drawn, direction)


def _face_lengths(mesh: TriangleMesh, displacement: Vertices) -> Float[np.ndarray, " m"]:
    """Displacement length of each triangle, mean over its corners [mm]."""
    return np.asarray(1e3 * np.linalg.norm(displacement, axis=1)[mesh.triangles].mean(axis=1))


def _points(axes: Axes, shown: _Shown, drawn: TriangleMesh, direction: Vector3) -> None:
    """Draw the measured points on the near side."""
    field, view, mesh = shown.field, make_view(drawn, direction), shown.subject.session.mesh
    if field is None:
        return
    normals = unit_normals(mesh)[closest_points(mesh, field.points).triangle]
    near = normals @ direction > 0.05
    position = 1e3 * projected(view, field.points + shown.magnification * field.displacement)
    rest = 1e3 * projected(view, field.points)
    segments = np.stack([rest[near, :2], position[near, :2]], axis=1)
    axes.add_collection(LineCollection(cast(Any, segments), colors=GREY, linewidths=0.5))
    axes.scatter(
        position[near, 0], position[near, 1], c=field.values[near], cmap=field.cmap, s=9.0,
        zorder=3, norm=Normalize(0.0, field.top), edgecolors=INK, linewidths=0.15,
    )  # fmt: skip


def _force(axes: Axes, shown: _Shown, drawn: TriangleMesh, direction: Vector3) -> None:
    """Draw the arrow of the force with its magnitude; behind the object if that hides its tip."""
    if shown.arrow is None or shown.probing is None:
        return
    force = shown.probing.force
    text = f"{np.linalg.norm(force):.3g} N"
    tail, tip = 1e3 * projected(make_view(drawn, direction), shown.arrow)
    hidden = float(force @ direction) > 0.0
    style = {"arrowstyle": "-|>", "color": ORANGE, "lw": 1.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate(
        "", xy=tuple(tip[:2]), xytext=tuple(tail[:2]), arrowprops=style,
        zorder=-1 if hidden else 5, annotation_clip=False,
    )  # fmt: skip
    axes.annotate(
        text, tuple(tail[:2]), (4, 2), textcoords="offset points", zorder=6,
        path_effects=[Stroke(linewidth=2.0, foreground="white"), Normal()],
    )  # fmt: skip


def _texts(figure: Figure, shown: _Shown) -> None:
    """Write the title and draw the colour bar."""
    subject, field = shown.subject, shown.field
    name = subject.session.name + (f": {shown.probing.name}" if shown.probing else "")
    title = textwrap.fill(name, _LINE)
    figure.text(0.5, 0.985, title, ha="center", va="top", weight="bold", parse_math=False)
    if field is None:
        return
    axes = figure.add_axes((0.3, 0.075, 0.4, 0.016))
    scale = ScalarMappable(Normalize(0.0, field.top), field.cmap)
    beyond = "neither" if shown.surface is not None else "max"
    bar = figure.colorbar(scale, cax=axes, orientation="horizontal", extend=beyond)
    what = "as the fitted model says" if shown.surface is not None else "measured"
    times = shown.magnification
    drawn = "true to scale" if times == 1.0 else f"magnified {times:.2g} times"
    bar.set_label(f"displacement in mm, {what}; {drawn}", labelpad=2)
    bar.outline.set_linewidth(0.4)


def _turned(direction: Vector3, angle: float) -> Vector3:
    """A direction rotated about the vertical by an angle [rad]."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = direction
    return np.array([cos * x - sin * y, sin * x + cos * y, z])


def _write_gif(path: Path, views: list[np.ndarray]) -> None:
    """Write an animated GIF, with 255 colours per picture."""
    pictures = [Image.fromarray(view).quantize(255) for view in views]
    pictures[0].save(
        path, "GIF", save_all=True, append_images=pictures[1:], duration=round(1e3 * _PACE), loop=0
    )


def _write_mp4(path: Path, views: list[np.ndarray]) -> None:
    """Write an MP4 video, and count what can be read of it: OpenCV reports no full disk."""
    rows, columns = (2 * (n // 2) for n in views[0].shape[:2])
    # OpenCV chooses the container by the file name.
    film_path = path.with_name(path.name + ".mp4")
    try:
        for codec in _CODECS:
            code = cv2.VideoWriter.fourcc(*codec)
            film = cv2.VideoWriter(str(film_path), code, 1.0 / _PACE, (columns, rows))
            if film.isOpened():
                for view in views:
                    film.write(np.ascontiguousarray(view[:rows, :columns, ::-1]))
                film.release()
                written = _frame_count(film_path)
                if written != len(views):
                    raise OSError(f"{written} of the film's {len(views)} pictures were written")
                film_path.replace(path)
                return
        raise OSError("this OpenCV writes no film; a name that ends in .gif makes an animation")
    finally:
        film_path.unlink(missing_ok=True)


def _frame_count(path: Path) -> int:
    """Number of pictures that can be read from a film."""
    film, count = cv2.VideoCapture(str(path)), 0
    while film.grab():
        count += 1
    film.release()
    return count
