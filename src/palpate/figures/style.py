"""Common style of all figures: colours, fonts, panels; figures as files and as pixels."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float, Shaped, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.ticker import MaxNLocator

Picture = UInt8[np.ndarray, "_ _ 4"]

# Okabe and Ito's palette: distinguishable for colour-blind readers, and in greyscale.
BLUE, ORANGE, GREY, INK = "#0072B2", "#D55E00", "#8a8f98", "#1c1f24"
PALE_BLUE, MIDDLE_BLUE = "#c9e2f2", "#5aa6d6"
# Direction to the light in the viewer's frame: right, up, toward the viewer.
LIGHT = (-0.45, 0.55, 0.70)
STYLE: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.0,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "savefig.dpi": 150.0,
    # Reproducible SVG files.
    "svg.hashsalt": "palpate",
}
# A decorator for functions that draw: it sets the style while they run.
styled = mpl.rc_context(STYLE)
_PANEL = 2.7  # width of one of three panels [inches]
# PNG compression at the default level, 6, takes as long as drawing.
_PNG = {"compress_level": 2}


@styled
def save_figure(figure: Figure, path: Path, *, kind: str | None = None) -> Path:
    """Write a figure to a file, bitmaps at 150 dpi.

    Parameters
    ----------
    figure : Figure
    path : Path                     in an existing folder; an existing file is replaced
    kind : str or None              "png", "svg" or "pdf"; None: by the suffix

    Returns
    -------
    Path                            `path`

    Raises
    ------
    OSError                         the file cannot be written
    """
    figure.savefig(path, format=kind, pil_kwargs=_PNG)
    return path


@styled
def save_drawing(figure: Figure, path: Path) -> list[Path]:
    """Write a line drawing as PNG, and as SVG with the same stem.

    Parameters
    ----------
    figure : Figure
    path : Path                     of the PNG, in an existing folder; existing files are replaced

    Returns
    -------
    list of two Path                PNG, SVG

    Raises
    ------
    OSError                         a file cannot be written
    """
    drawn = path.with_suffix(".svg")
    figure.savefig(drawn, metadata={"Date": None, "Creator": None})
    return [save_figure(figure, path), drawn]


@styled
def figure_pixels(figure: Figure) -> Picture:
    """Pixels of a figure, at the resolution of saved figures.

    Parameters
    ----------
    figure : Figure

    Returns
    -------
    (rows, columns, 4) uint8        red, green, blue, opacity
    """
    figure.set_dpi(STYLE["savefig.dpi"])
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba()).copy()


def save_pixels(picture: Picture, path: Path) -> None:
    """Write pixels as PNG.

    Parameters
    ----------
    picture : (rows, columns, 4) uint8
    path : Path                     in an existing folder

    Raises
    ------
    OSError                         the file cannot be written
    """
    imsave(path, picture, dpi=STYLE["savefig.dpi"], pil_kwargs=_PNG)


def three_panels(size: Shaped[np.ndarray, "2"]) -> tuple[Figure, list[Axes]]:
    """A figure with three panels side by side, with margins above and below.

    Parameters
    ----------
    size : (2,) float or int        width and height of a panel's content, in any unit: gives the
                                    panels' aspect ratio, within limits

    Returns
    -------
    Figure                          8.4 inches wide
    list of three Axes              from left to right, without ticks
    """
    panel_height = min(max(_PANEL * float(size[1] / size[0]), 0.6), 3.6)
    total = panel_height + 1.23
    figure = Figure(figsize=(3 * _PANEL + 0.3, total))
    grid = figure.add_gridspec(
        1, 3, left=0.01, right=0.99, top=1 - 0.50 / total, bottom=0.73 / total, wspace=0.025
    )
    panels = [figure.add_subplot(grid[0, column]) for column in range(3)]
    for axes in panels:
        axes.set_axis_off()
    return figure, panels


def title_panel(axes: Axes, title: str) -> None:
    """Write a title above a panel of `three_panels`.

    Parameters
    ----------
    axes : Axes
    title : str                     plain text; dollar signs are not mathematics
    """
    # Axes.set_title would search for space above the ticks, which takes 30 ms.
    axes.annotate(
        title, (0.5, 1.0), (0.0, 5.0), xycoords="axes fraction", textcoords="offset points",
        ha="center", fontsize=8.5, annotation_clip=False, parse_math=False,
    )  # fmt: skip


def place_below(figure: Figure, panels: Sequence[Axes]) -> tuple[float, float]:
    """Horizontal centre of some panels and width of one, as fractions of the figure's width.

    Parameters
    ----------
    figure : Figure
    panels : sequence of Axes       adjacent panels

    Returns
    -------
    tuple of two float              0 to 1
    """
    cells = [axes.get_position(original=True) for axes in panels]
    return 0.5 * (cells[0].x0 + cells[-1].x1), cells[0].width


def add_colour_bar(
    figure: Figure, panels: Sequence[Axes], cmap: str, norm: Normalize, label: str
) -> None:
    """Draw a horizontal colour bar, open at its upper end, centred below some panels.

    Parameters
    ----------
    figure : Figure                 of `three_panels`
    panels : sequence of Axes       adjacent panels
    cmap : str                      a colour map of matplotlib
    norm : Normalize                scale of the values
    label : str                     below the bar
    """
    total = figure.get_figheight()
    middle, panel_width = place_below(figure, panels)
    width = 0.62 * panel_width
    axes = figure.add_axes((middle - 0.5 * width, 0.61 / total, width, 0.075 / total))
    bar = figure.colorbar(
        ScalarMappable(norm, cmap), cax=axes, orientation="horizontal", extend="max",
        ticks=MaxNLocator(3),
    )  # fmt: skip
    bar.outline.set_linewidth(0.4)
    bar.set_label(label, labelpad=2)


def add_texts(figure: Figure, heading: str, left: str, right: str) -> None:
    """Write a heading, and two notes along the lower edge, on a figure of `three_panels`.

    Parameters
    ----------
    figure : Figure
    heading, left, right : str      plain text; dollar signs are not mathematics
    """
    total = figure.get_figheight()
    # Names may contain dollar signs.
    figure.text(
        0.5, 1 - 0.07 / total, heading, ha="center", va="top", fontsize=9, weight="bold",
        parse_math=False,
    )  # fmt: skip
    for x, side, text in ((0.01, "left", left), (0.99, "right", right)):
        figure.text(x, 0.05 / total, text, ha=side, va="bottom", fontsize=6.5, parse_math=False)


def add_arrows(
    axes: Axes,
    points: Float[np.ndarray, "n 2"],
    vector: Float[np.ndarray, "n 2"],
    *,
    pitch: float,
    shortest: float = 0.0,
    colour: str = INK,
) -> None:
    """Draw arrows at an evenly spaced subset of points.

    Parameters
    ----------
    axes : Axes
    points, vector : (n, 2) float   in the units of the axes; rows with NaN have no arrow
    pitch : float                   side of square cells, same unit: in each cell the point nearest
                                    to its centre has an arrow
    shortest : float                shorter arrows are left out beforehand
    colour : str                    of the arrows; they get a contrasting rim
    """
    known = np.flatnonzero(
        (np.linalg.norm(vector, axis=1) > shortest) & np.isfinite(points).all(axis=1)
    )
    cell = np.floor(points[known] / pitch)
    off_centre = np.linalg.norm(points[known] / pitch - cell - 0.5, axis=1)
    order = np.argsort(off_centre, kind="stable")
    _, first = np.unique(cell[order], axis=0, return_index=True)
    chosen = known[order[first]]
    width, rim, around = (0.016, 0.35, "white") if colour == INK else (0.022, 0.5, INK)
    axes.quiver(
        *points[chosen].T, *vector[chosen].T, angles="xy", scale_units="xy", scale=1.0,
        units="inches", width=width, headwidth=3.4, headlength=3.6, headaxislength=3.2,
        minlength=0.5, color=colour, edgecolor=around, linewidth=rim, zorder=3,
    )  # fmt: skip


def open_frame(axes: Axes) -> None:
    """Remove the upper and right line of the frame.

    Parameters
    ----------
    axes : Axes
    """
    axes.spines[["top", "right"]].set_visible(False)


def magnification_text(factor: float) -> str:
    """Magnification of arrows as text, to two digits or whole numbers: `3.2 times`.

    Parameters
    ----------
    factor : float                  > 0

    Returns
    -------
    str
    """
    return f"{factor:.2g} times" if factor < 10 else f"{factor:.0f} times"
