"""Colour coding: the quantity shown at the points of a probing."""

from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from jaxtyping import Float, UInt8

from palpate.figures import LENGTHS, MOST_SIGMAS, RESIDUALS
from palpate.pipeline import FittedProbing
from palpate.shapes import Points, PointScalars

MEASURED, PREDICTED, RESIDUAL, SIGMA = FIELDS = (
    "displacement, measured", "displacement, predicted", "residual, in sigmas", "sigma",
)  # fmt: skip
# Quantile of the values at the end of the scale, so that false matches do not determine it.
_TOP = 0.97

Colours = UInt8[np.ndarray, "n 3"]


@dataclass(frozen=True, slots=True, eq=False)
class ColouredField:
    """Points with one value each, for drawing.

    Attributes
    ----------
    points : (n, 3) float [m]           at rest
    displacement : (n, 3) float [m]     with which they are drawn
    values : (n,) float                 in `unit`
    top : float                         value at the end of the scale
    unit : str                          "mm" or "sigmas"
    cmap : str                          colour map of matplotlib
    """

    points: Points
    displacement: Points
    values: PointScalars
    top: float
    unit: str
    cmap: str


def coloured_field(probing: FittedProbing, what: str) -> ColouredField | None:
    """Values of one quantity at the points of a probing.

    Parameters
    ----------
    probing : FittedProbing
    what : str                          one of `FIELDS`

    Returns
    -------
    ColouredField or None               None if it is unknown at all points
    """
    displacement, cmap, unit = probing.displacement, LENGTHS, "mm"
    if what == PREDICTED:
        displacement = probing.predicted
    values = 1e3 * np.linalg.norm(displacement, axis=1)
    if what == RESIDUAL:
        scaled = (probing.displacement - probing.predicted) / probing.sigma
        values, cmap, unit = np.sqrt(np.mean(scaled**2, axis=1)), RESIDUALS, "sigmas"
    elif what == SIGMA:
        values = 1e3 * np.sqrt(np.mean(probing.sigma**2, axis=1))
    known = np.isfinite(values) & np.isfinite(displacement).all(axis=1)
    if not known.any():
        return None
    top = MOST_SIGMAS if what == RESIDUAL else float(np.quantile(values[known], _TOP))
    return ColouredField(
        probing.points[known], displacement[known], values[known], max(top, 1e-6), unit, cmap
    )


def colours_of(values: PointScalars, top: float, cmap: str) -> Colours:
    """RGB colours of values on a scale from zero.

    Parameters
    ----------
    values : (n,) float
    top : float                         > 0; end of the scale
    cmap : str                          colour map of matplotlib

    Returns
    -------
    (n, 3) uint8
    """
    share = np.clip(np.nan_to_num(values) / top, 0.0, 1.0)
    return np.asarray(np.rint(255 * mpl.colormaps[cmap](share)[:, :3]), dtype=np.uint8)


def linear_light(colours: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Convert sRGB colours to linear RGB, which glTF requires.

    Parameters
    ----------
    colours : (n, 3) float              0 to 1, sRGB

    Returns
    -------
    (n, 3) float                        0 to 1
    """
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
