"""What the page of a live measurement is made of: texts as HTML, small plots as SVG, pictures.

A browser takes HTML as it is: every text that a device or a file may have had a say in is escaped.
"""

from collections.abc import Sequence
from html import escape

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from palpate.bench.questions import STEPS, Dots, Pictures
from palpate.figures import BLUE, GREY, INK, ORANGE, PALE_BLUE, drawn_edges
from palpate.geometry import TriangleMesh
from palpate.pipeline import COARSEST_TEXTURE, DARK_LEVEL, MOST_SATURATED, texture_length
from palpate.records import MODULUS_UNITS, Camera, Estimate, Rig, camera_centre, constant_row
from palpate.shapes import Vector3
from palpate.vision import project

GOOD, BAD = "#00794f", "#b3261e"
_NAMES = {"young_modulus": "E", "shear_modulus": "G", "poisson_ratio": "nu"}
_TITLES = {"young_modulus": "Young's modulus E", "poisson_ratio": "Poisson's ratio nu"}
_STYLE = "padding:0 .8em .6em;font-size:.875rem;line-height:1.4;overflow-wrap:anywhere"
# Contrast about a pixel that is more than noise [grey levels], within so many pixels; and the
# share of a picture that must have it.
_CONTRAST, _WITHIN, _LEAST_TEXTURED = 5.0, 5.0, 0.03
# A plot of forces reaches so many standard deviations of those at rest.
_NOISE = 30.0
# A motion is not drawn as large as a push that is smaller [m].
_STILL = 1e-4
# Time that it shows [s].
_SHOWN = 8.0
# Width of a camera's picture in the page, and a plot's size [px].
_WIDTH, _PLOT, _MARGIN = 640, (320, 110), (52, 16, 8, 20)


def block(content: str) -> str:
    """A part of the page, of HTML."""
    return f'<div style="{_STYLE}">{content}</div>'


def steps_html(current: str) -> str:
    """Where the measurement is on its way; at its end where that is none of `STEPS`."""
    at = STEPS.index(current) if current in STEPS else len(STEPS)
    parts = []
    for k, name in enumerate(STEPS):
        colour = (GREY, BLUE, GREY)[1 + (k > at) - (k < at)]
        mark = "✓" if k < at else str(k + 1)
        weight = 700 if k == at else 400
        parts.append(
            f'<span style="color:{colour};font-weight:{weight};white-space:nowrap">{mark} {name}'
            "</span>"
        )
    row = "display:flex;flex-wrap:wrap;gap:.2em 1em"
    return block(f'<div style="{row}">{"".join(parts)}</div>')


def question_html(text: str) -> str:
    """Question or instruction for the person, as HTML."""
    return block(
        f'<div style="font-size:1.05rem;font-weight:600;white-space:pre-line">{escape(text)}</div>'
    )


def state_html(text: str) -> str:
    """What the cameras are seeing."""
    return block(f'<b style="color:{BAD}">●</b> {escape(text)}')


def said_html(texts: Sequence[str]) -> str:
    """What was said, the newest first and in ink."""
    lines = [
        f'<div style="color:{INK if k == 0 else GREY};padding-top:.5em">{escape(text)}</div>'
        for k, text in enumerate(reversed(texts))
    ]
    return block("".join(lines))


def constants_html(estimate: Estimate) -> str:
    """The constants with their intervals."""
    rows = [("", "± 1 sigma", "95 % interval")]
    for key, name in _NAMES.items():
        value, interval, unit = constant_row(estimate, key)
        rows.append((name, f"{value} {unit}", interval))
    cells = (
        "".join(f'<td style="padding-right:1em">{escape(x)}</td>' for x in row) for row in rows
    )
    table = "".join(f"<tr>{row}</tr>" for row in cells)
    return block(f'<table style="font-variant-numeric:tabular-nums">{table}</table>')


def intervals_svg(estimates: Sequence[Estimate]) -> str:
    """E and nu with their 95 % intervals over the pushes, where they were determined."""
    return "".join(_interval_svg(estimates, key) for key in _TITLES)


def _interval_svg(estimates: Sequence[Estimate], key: str) -> str:
    known = [estimate for estimate in estimates if estimate.identifiable[key]]
    known = [estimate for estimate in known if np.isfinite(getattr(estimate, key).ci95).all()]
    if not known:
        return ""
    _, _, unit = constant_row(known[-1], key)
    x = np.array([len(estimate.probes) for estimate in known], dtype=float)
    rows = np.array(
        [(getattr(estimate, key).value, *getattr(estimate, key).ci95) for estimate in known]
    )
    if unit:
        rows = rows / MODULUS_UNITS[unit]
    plot = _Plot(x, rows, whole=True)
    band = plot.line(np.concatenate([x, x[::-1]]), np.concatenate([rows[:, 1], rows[::-1, 2]]))
    dots = "".join(
        f'<circle cx="{plot.across(a):.1f}" cy="{plot.up(b):.1f}" r="3.5" fill="{BLUE}"/>'
        f'<path d="M{plot.across(a):.1f},{plot.up(c):.1f}V{plot.up(d):.1f}" stroke="{BLUE}"/>'
        for a, (b, c, d) in zip(x, rows, strict=True)
    )
    title = f"{_TITLES[key]}{unit and ', ' + unit}, after each push"
    return plot.svg(title, f'<path d="{band}Z" fill="{PALE_BLUE}"/>{dots}')


def trace_svg(
    time: Sequence[float], force: Sequence[float], moved: Sequence[tuple[float, float]] = ()
) -> str:
    """The latest readings of a gauge, from what it shows at rest; empty where there are none. With
    them the motion of the surface [s, m], drawn as high: of an elastic body both lines are one."""
    t, f = np.array(time), np.array(force)
    late = np.flatnonzero(t >= t[-1:] - _SHOWN)
    # One reading is no line.
    if not len(late) or t[late[0]] == t[-1]:
        return ""
    rest = f[: max(2, len(f) // 10)]
    f = f - np.median(rest)
    late = late[:: max(1, len(late) // _PLOT[0])]
    first, t, f = t[late[0]], t[late] - t[late[0]], f[late]
    f = (f if f.max() >= -f.min() else -f) + 0.0
    # At rest there is noise alone: it is not drawn as large as a push.
    plot = _Plot(t, np.append(f, _NOISE * rest.std()))
    title, lines = "force, N, over seconds", [(plot.line(t, f), ORANGE)]
    then = np.array([sample for sample in moved if sample[0] >= first]).reshape(-1, 2)
    if len(then):
        most = max(then[:, 1].max(), _STILL)
        line = plot.line(then[:, 0] - first, then[:, 1] / most * max(f.max(), 0.0))
        lines.append((line, BLUE))
        title = f"force, N (orange), and motion there, of {1e3 * most:.2g} mm (blue), over seconds"
    drawn = (f'<path d="{d}" fill="none" stroke="{c}" stroke-width="2"/>' for d, c in lines)
    return plot.svg(title, "".join(drawn))


class _Plot:
    """Axes of a small plot that hold some values."""

    def __init__(self, x: np.ndarray, y: np.ndarray, *, whole: bool = False) -> None:
        low, high = float(y.min()), float(y.max())
        room = 0.08 * (high - low) or 0.05 * abs(high) or 1.0
        self.bottom, self.top = low - room, high + room
        self.first, self.last = (x[0] - 0.4, x[-1] + 0.4) if whole else (x[0], x[-1])
        self.ticks = x if whole and len(x) <= 10 else np.array([x[0], x[-1]])
        self.levels = (low, high)

    def across(self, x: float) -> float:
        left, right = _MARGIN[0], _PLOT[0] - _MARGIN[1]
        return float(left + (right - left) * (x - self.first) / (self.last - self.first))

    def up(self, y: float) -> float:
        low, high = _PLOT[1] - _MARGIN[3], _MARGIN[2]
        return float(low + (high - low) * (y - self.bottom) / (self.top - self.bottom))

    def line(self, x: np.ndarray, y: np.ndarray) -> str:
        points = (f"{self.across(a):.1f},{self.up(b):.1f}" for a, b in zip(x, y, strict=True))
        return "M" + "L".join(points)

    def svg(self, title: str, content: str) -> str:
        """The plot under its title, as HTML."""
        base = _PLOT[1] - _MARGIN[3]
        axes = (
            f'<path d="M{_MARGIN[0]},{_MARGIN[2]}V{base}H{_PLOT[0]}" fill="none" stroke="{GREY}"/>'
        )
        for level in self.levels:
            axes += (
                f'<text x="{_MARGIN[0] - 5}" y="{self.up(level) + 4:.1f}" text-anchor="end">'
                f"{level:.3g}</text>"
            )
        for tick in self.ticks:
            axes += (
                f'<text x="{self.across(tick):.1f}" y="{_PLOT[1] - 5}" text-anchor="middle">'
                f"{tick:.3g}</text>"
            )
        return block(
            f'<div style="color:{GREY}">{escape(title)}</div>'
            f'<svg viewBox="0 0 {_PLOT[0]} {_PLOT[1]}" style="width:100%;display:block"'
            f' font-size="11" fill="{INK}">{content}{axes}</svg>'
        )


def verdicts(picture: UInt8[np.ndarray, "_ _"]) -> tuple[tuple[str, bool], ...]:
    """What a camera's picture is like in a few words, each with whether it is good.

    Parameters
    ----------
    picture : (rows, columns) uint8

    Returns
    -------
    tuple of (str, bool)            exposure, texture and focus
    """
    white = float((picture == 255).mean())
    if white > MOST_SATURATED:
        light = f"{100 * white:.0f} % white: less light, or move the lamp", False
    elif np.percentile(picture[::4, ::4], 99.0) < DARK_LEVEL:
        light = "dark: more light", False
    else:
        light = "light good", True
    grey = picture.astype(np.float32)
    mean, square = (cv2.GaussianBlur(x, (0, 0), _WITHIN) for x in (grey, grey**2))
    textured = (square - mean**2 > _CONTRAST**2).astype(np.float32)
    if textured.mean() < _LEAST_TEXTURED:
        return light, ("no texture: speckle the object", False)
    length = texture_length(grey, textured)
    if length > COARSEST_TEXTURE:
        return light, ("blurred, or coarse speckle: focus", False)
    return light, ("texture good", True), ("focus good", True)


def verdicts_html(names: Sequence[str], pictures: Pictures) -> str:
    """The verdicts on all cameras' pictures."""
    lines = []
    for name, picture in zip(names, pictures, strict=True):
        words = "".join(
            f'<span style="color:{GOOD if good else BAD};white-space:nowrap;padding-left:.9em">'
            f"{'●' if good else '▲'} {text}</span>"
            for text, good in verdicts(picture)
        )
        lines.append(f"<div><b>{escape(name)}</b>{words}</div>")
    return block("".join(lines))


def montage(
    names: Sequence[str],
    pictures: Pictures,
    rig: Rig | None = None,
    *,
    target: tuple[Vector3, Vector3] | None = None,
    way: Sequence[Vector3] = (),
    outline: TriangleMesh | None = None,
    dots: Dots = (),
) -> UInt8[np.ndarray, "_ _ 3"]:
    """The cameras' pictures below each other, two in a row where there are more than two; with
    their names, and a ring where to press, grey where that is on the far side.

    Parameters
    ----------
    names : sequence of str         of the cameras
    pictures : Pictures             of them
    rig : Rig or None               of them; without one there is neither ring nor outline
    target : (3,) and (3,) float    point [m] and direction of the push; None: no ring
    way : sequence of (3,) float [m]    of an arm's tool
    outline : TriangleMesh or None  the object as the rig has it [m]
    dots : sequence of (k, 2) float [px]    in the picture of each camera
    """
    columns = 1 if len(pictures) <= 2 else 2
    tiles: list[np.ndarray] = []
    for k, (name, picture) in enumerate(zip(names, pictures, strict=True)):
        drawn = _Tile(name, picture, _WIDTH // columns)
        if dots:
            drawn.dots(dots[k])
        if rig is not None and target is not None:
            drawn.ring(rig.cameras[k], *target)
        if rig is not None and len(way):
            drawn.lines(rig.cameras[k], np.stack([way[:-1], way[1:]], axis=1), BLUE)
        if rig is not None and outline is not None:
            drawn.outline(rig.cameras[k], outline)
        tiles.append(np.asarray(drawn.picture))
    height = max(len(tile) for tile in tiles)
    rows = -(-len(tiles) // columns)
    sheet = np.full((rows * height, _WIDTH, 3), 255, dtype=np.uint8)
    for k, tile in enumerate(tiles):
        row, column = divmod(k, columns)
        left = column * (_WIDTH // columns)
        sheet[row * height : row * height + len(tile), left : left + tile.shape[1]] = tile
    return sheet


class _Tile:
    """A camera's picture of some width, with its name, and what is drawn over it."""

    def __init__(self, name: str, picture: np.ndarray, width: int) -> None:
        self.scale = width / picture.shape[1]
        size = width, round(self.scale * picture.shape[0])
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        self.picture = Image.fromarray(small).convert("RGB")
        self.draw = ImageDraw.Draw(self.picture)
        font = ImageFont.load_default(size=26)
        self.draw.text((10, 6), name, fill="white", font=font, stroke_width=2, stroke_fill="black")

    def place(self, pixels: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
        """Pixels of the camera in this picture."""
        return self.scale * (pixels + 0.5)

    def dots(self, pixels: Float[np.ndarray, "_ 2"]) -> None:
        for x, y in self.place(pixels):
            self.draw.ellipse((x - 2, y - 2, x + 2, y + 2), fill=ORANGE)

    def ring(self, camera: Camera, point: Vector3, inward: Vector3) -> None:
        x, y = self.place(project(camera, point[None])[0])
        faces = (camera_centre(camera) - point) @ inward < 0.0
        for radius, colour, thick in ((25, "black", 9), (23, ORANGE if faces else GREY, 5)):
            box = (x - radius, y - radius, x + radius, y + radius)
            self.draw.ellipse(box, outline=colour, width=thick)

    def outline(self, camera: Camera, mesh: TriangleMesh) -> None:
        edges = mesh.vertices[drawn_edges(mesh, camera_centre(camera))]
        self.lines(camera, edges, ORANGE)

    def lines(self, camera: Camera, ends: Float[np.ndarray, "m 2 3"], colour: str) -> None:
        pixels = self.place(project(camera, ends.reshape(-1, 3))).reshape(-1, 2, 2)
        for line in pixels[np.isfinite(pixels).all(axis=(1, 2))]:
            self.draw.line([*map(tuple, line)], fill=colour, width=2)
