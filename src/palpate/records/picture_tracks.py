"""Matches that another program found in the pictures of a pair of cameras, not yet in space."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.shapes import PointScalars


@dataclass(frozen=True, slots=True, eq=False)
class PictureTracks:
    """Pixels at which cameras see the same points, at rest and under load.

    Parameters
    ----------
    rest, loaded : (c, n, 2) float [px]     column, row; the first pixel's centre is (0, 0); NaN
                                    where a point was not found
    cameras : tuple of str          names of the c cameras, as far as the program knows them
    score : (n,) float or None      zero-mean normalised correlation of each point's worst match
    notes : tuple of str            what was assumed, in sentences about the file
    """

    rest: Float[np.ndarray, "c n 2"]
    loaded: Float[np.ndarray, "c n 2"]
    cameras: tuple[str, ...]
    score: PointScalars | None
    notes: tuple[str, ...]
