"""Displacement between two pictures of one camera, on a grid of points, without any seed."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from benchmarks.planar_field import planar_field
from palpate.shapes import Flags, PointScalars
from palpate.vision.matching.dense_flow import dense_start
from palpate.vision.spline import make_spline_picture
from palpate.vision.stereo.window_matches import PlanarMatch, refine_planar

# The gradient of the motion needs a window of this size; a smaller one takes it as known.
_GRADIENT_SUBSET = 21
_RETRIES = 2
# Standard deviations between a point and the field around it that are no chance.
_DISAGREEMENT = 6.0
# A displacement known no better than this, 1 sigma of its length, is not known [px].
_TEXTURE_LIMIT = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class PlanarFlow:
    """Displacement in the picture at grid points.

    Attributes
    ----------
    pixel : (n, 2) float [px]           column, row in the first picture
    displacement : (n, 2) float [px]    NaN where rejected
    covariance : (n, 2, 2) float [px^2]
    score : (n,) float                  normalised cross-correlation
    valid : (n,) bool
    """

    pixel: Float[np.ndarray, "n 2"]
    displacement: Float[np.ndarray, "n 2"]
    covariance: Float[np.ndarray, "n 2 2"]
    score: PointScalars
    valid: Flags


def planar_flow(
    first: Float[np.ndarray, "rows columns"],
    second: Float[np.ndarray, "rows columns"],
    pixel: Float[np.ndarray, "n 2"],
    *,
    subset: int = 21,
) -> PlanarFlow:
    """Follow windows of one picture into another one.

    Parameters
    ----------
    first, second : (rows, columns) float [grey levels]
    pixel : (n, 2) float [px]       column, row of the windows' centres, whole pixels
    subset : int [px]               side of the windows, odd, at least 5

    Returns
    -------
    PlanarFlow
    """
    start = dense_start(first, second)
    flow = cv2.remap(start.flow, pixel.astype(np.float32)[None], None, cv2.INTER_LINEAR)[0]
    reference, moved = make_spline_picture(first), make_spline_picture(second)
    wide = max(subset, _GRADIENT_SUBSET)
    match = refine_planar(reference, moved, pixel, flow, subset=wide)
    for _ in range(_RETRIES):
        value, gradient = _field(match, pixel, wide)
        lost = ~match.converged & np.isfinite(value).all(axis=1)
        if not lost.any():
            break
        tried = refine_planar(
            reference, moved, pixel[lost], value[lost],
            subset=wide, start_gradient=gradient[lost],
        )  # fmt: skip
        match = _replaced(match, tried, np.flatnonzero(lost))
    if subset < wide:
        value, gradient = _field(match, pixel, wide)
        match = refine_planar(
            reference, moved, pixel, value, subset=subset, shape="shift", start_gradient=gradient
        )
    return _judged(match, pixel, wide)


def _field(
    match: PlanarMatch, pixel: Float[np.ndarray, "n 2"], subset: int
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"]]:
    """Smooth displacement and its gradient at every point, from the points that were found."""
    return planar_field(
        pixel, match.displacement, match.converged, subset, covariance=match.covariance
    )


def _replaced(match: PlanarMatch, other: PlanarMatch, rows: np.ndarray) -> PlanarMatch:
    """A match whose rows are those of another one where that one converged."""
    good = other.converged
    arrays = {}
    for name in ("displacement", "gradient", "covariance", "score", "converged"):
        value = getattr(match, name).copy()
        value[rows[good]] = getattr(other, name)[good]
        arrays[name] = value
    return PlanarMatch(**arrays)


def _judged(match: PlanarMatch, pixel: Float[np.ndarray, "n 2"], subset: int) -> PlanarFlow:
    """Reject what contradicts the motion around it."""
    value, _ = _field(match, pixel, subset)
    sigma = np.sqrt(np.trace(match.covariance, axis1=1, axis2=2))
    with np.errstate(invalid="ignore"):
        away = np.linalg.norm(match.displacement - value, axis=1)
        typical = np.nanmedian(away / sigma) if match.converged.any() else 1.0
        valid = match.converged & ~(away > _DISAGREEMENT * max(1.0, float(typical)) * sigma)
        valid &= sigma < _TEXTURE_LIMIT
    return PlanarFlow(
        pixel,
        np.where(valid[:, None], match.displacement, np.nan),
        match.covariance,
        match.score,
        valid,
    )
