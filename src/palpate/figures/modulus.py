"""Figure of a modulus that differs from place to place: three sections through the body."""

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from palpate.figures.style import GREY, INK, styled
from palpate.records import FieldEstimate, ModulusMap

_MM = 1e3
# Pixels along the longer side of a section.
_PIXELS = 240
# Horizontal and vertical axis of each section.
_PLANES = ((0, 1), (0, 2), (1, 2))
_NAMES = "xyz"
# Colour map of matplotlib: softer, mean, stiffer.
MODULI = "RdBu_r"
# Least range of the colours, as a factor from the mean: less than that is no difference to show.
_LEAST_RANGE = 1.5


@styled
def modulus_figure(modulus: ModulusMap, field: FieldEstimate | None) -> Figure:
    """Sections along the axes through the part that differs most, or the middle of the body.

    Parameters
    ----------
    modulus : ModulusMap
    field : FieldEstimate or None   None: of regions, through the middle of what differs from the
                                    rest

    Returns
    -------
    Figure                          7.6 by 3.1 inches; grey where the modulus is not known
    """
    corner = modulus.nodes[modulus.tetrahedra]
    low, high = modulus.nodes.min(axis=0), modulus.nodes.max(axis=0)
    through = 0.5 * (low + high)
    if field is None:
        through = corner.mean(axis=1)[modulus.log_modulus != 0.0].mean(axis=0)
    elif field.parts:
        through = np.array(field.parts[0].centre)
    size = high - low
    widths = [size[i] for i, _ in _PLANES]
    figure = Figure(figsize=(7.6, 3.1))
    grid = figure.add_gridspec(
        1, 3, width_ratios=widths, left=0.065, right=0.86, top=0.86, bottom=0.15, wspace=0.28
    )
    span = modulus_span(modulus)
    colours = LogNorm(1.0 / span, span)
    for k, (i, j) in enumerate(_PLANES):
        step = float(max(size[i], size[j])) / _PIXELS
        across, up = (np.arange(low[a] + 0.5 * step, high[a], step) for a in (i, j))
        points = np.tile(through, (len(up), len(across), 1))
        points[..., i], points[..., j] = np.meshgrid(across, up)
        element = modulus.element_at(points.reshape(-1, 3))
        inside = (element >= 0).reshape(points.shape[:2])
        shown = inside & modulus.is_known[element].reshape(inside.shape)
        ratio = np.exp(modulus.log_modulus[element]).reshape(inside.shape)
        axes = figure.add_subplot(grid[k])
        extent = tuple(_MM * x for x in (low[i], high[i], low[j], high[j]))
        axes.imshow(
            np.where(inside[..., None], [0.86, 0.87, 0.88, 1.0], 0.0), extent=extent, origin="lower"
        )
        image = axes.imshow(
            np.ma.masked_where(~shown, ratio), extent=extent, origin="lower", norm=colours,
            cmap=MODULI,
        )  # fmt: skip
        third = 3 - i - j
        axes.set_title(f"{_NAMES[third]} = {round(_MM * through[third])} mm", color=INK)
        axes.set_xlabel(f"{_NAMES[i]} (mm)")
        axes.set_ylabel(f"{_NAMES[j]} (mm)")
    bar = figure.colorbar(image, cax=figure.add_axes((0.89, 0.2, 0.015, 0.6)))
    of_rest = field is None or field.is_of_parts
    bar.set_label("modulus over that of the rest" if of_rest else "modulus over its mean")
    ticks = _ticks(span)
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.ax.minorticks_off()
    if not modulus.is_known.all():
        figure.text(0.065, 0.965, "Grey: the data do not tell the modulus", color=GREY, va="top")
    return figure


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
