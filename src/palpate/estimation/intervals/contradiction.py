"""Whether residuals contradict the model: unexplained motion with a spatial pattern unlike noise.

Noise levels are estimated from the residuals themselves, so the size of these proves nothing; their
spatial pattern does. Noise is independent from point to point, or shared by neighbours whose
windows overlap; a wrong model leaves residuals that are correlated across the body (a wrong
support, other material) or concentrated at one place (a wrong contact). Neither counts unless it
exceeds the share of the motion that an ordinary mesh leaves unexplained. Rates of false alarm and
of detection: benchmarks/model_contradicted.py.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from palpate.estimation.intervals.validation import ProbeFit
from palpate.estimation.observations import ProbeObservations
from palpate.geometry import morton_order
from palpate.shapes import Points, PointScalars, Vector3

# Fewer points show no pattern; more cost time and add no information.
_MIN_POINTS, _MAX_POINTS = 30, 1000
# Lengths below are fractions of the diagonal of the points' bounding box.
_BLOCK = 0.1
_DISTANT = (0.2, 0.4)
_NEAR = 0.15
# Correlation across the body: standard errors, and share of the motion.
_SIGNIFICANT, _LEAST_SHARED = 10.0, 0.02
# Concentrated residuals: energy over that of evenly spread noise, and share of the motion.
_CONCENTRATED, _LEAST_LOCAL = 4.0, 0.03
# Mean over median of the squared length of a three-component Gaussian vector.
_MEAN_OVER_MEDIAN = 1.27
# A median over so many neighbours tolerates three outliers.
_NEIGHBOURS, _NEIGHBOUR_SHARE = 7, 30
_LONGEST = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Contradiction:
    """Motion of one probing that the model leaves unexplained.

    Attributes
    ----------
    name : str                      of the probing
    share : float [-]               root mean square of the smoothed residuals over that of the
                                    displacements; points are weighted by their claimed precision
    place : (3,) float [m]          where they are largest
    landmark : str                  the probing's landmark near that place, empty where none is
    """

    name: str
    share: float
    place: Vector3
    landmark: str


def contradiction(probe: ProbeObservations, fit: ProbeFit) -> Contradiction | None:
    """Test whether one probing contradicts the model.

    Parameters
    ----------
    probe : ProbeObservations
    fit : ProbeFit                  of that probing

    Returns
    -------
    Contradiction or None           None if it does not, or with fewer than 30 points, which do not
                                    suffice to tell
    """
    measured = np.flatnonzero(np.isfinite(fit.residual).all(axis=1))
    if len(measured) < _MIN_POINTS or not probe.displacement[measured].any():
        return None
    measured = measured[morton_order(probe.position[measured])][:: -(-len(measured) // _MAX_POINTS)]
    relative_std = _relative_std(probe)[measured, None]
    place, residual = probe.position[measured], fit.residual[measured] / relative_std
    size = float(np.linalg.norm(np.ptp(place, axis=0)))
    motion = float(np.sqrt(((probe.displacement[measured] / relative_std) ** 2).sum(axis=1).mean()))
    count = max(_NEIGHBOURS, len(place) // _NEIGHBOUR_SHARE)
    smooth = np.median(residual[cKDTree(place).query(place, count)[1]], axis=1)
    square = (smooth**2).sum(axis=1)
    noise = _MEAN_OVER_MEDIAN * float(np.median(square))
    local = np.sqrt(max(float(square.mean()) - noise, 0.0)) / motion
    stands_out = square.mean() > _CONCENTRATED * noise and local > _LEAST_LOCAL
    errors, shared = _distant_correlation(place / size, residual)
    if not (stands_out or (errors > _SIGNIFICANT and shared > _LEAST_SHARED * motion)):
        return None
    worst = place[int(square.argmax())]
    share = float(np.sqrt(square.mean())) / motion
    return Contradiction(probe.name, share, worst, _landmark(probe, worst, _NEAR * size))


def _relative_std(probe: ProbeObservations) -> PointScalars:
    """Claimed standard deviation of every point over their median; 1 where none is claimed.

    Where the surface turns away from the cameras, displacements are ten times as uncertain, and
    errors of overlapping windows are correlated.
    """
    if probe.std is None:
        return np.ones(len(probe.position))
    claim = np.sqrt((probe.std**2).mean(axis=1))
    return claim / np.nanmedian(claim)


def _distant_correlation(place: Points, residual: Float[np.ndarray, "n 3"]) -> tuple[float, float]:
    """Correlation of residuals of distant blocks: in standard errors, and as a length [m].

    Residuals are summed over blocks; under the null hypothesis of noise the signs of the blocks'
    sums are random, which gives the variance of the sum over all pairs of blocks exactly. Single
    residuals are truncated to three times the median length.
    """
    length = np.linalg.norm(residual, axis=1)
    longest = _LONGEST * float(np.median(length))
    truncated = (
        residual * np.minimum(1.0, longest / np.maximum(length, np.finfo(float).tiny))[:, None]
    )
    cells = np.floor(place / _BLOCK).astype(np.int64)
    _, block, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = np.zeros((len(count), 6))
    np.add.at(sums, block.ravel(), np.hstack([place, truncated]))
    centre, total = sums[:, :3] / count[:, None], sums[:, 3:] / np.sqrt(count)[:, None]
    distance = np.linalg.norm(centre[:, None] - centre[None], axis=2)
    first, second = np.nonzero(np.triu((distance > _DISTANT[0]) & (distance < _DISTANT[1])))
    products = (total[first] * total[second]).sum(axis=1)
    spread = float(np.sqrt((products**2).sum()))
    if spread == 0.0:
        return 0.0, 0.0
    mean = products.sum() / np.sqrt(count[first] * count[second]).sum()
    return float(products.sum()) / spread, float(np.sqrt(max(mean, 0.0)))


def _landmark(probe: ProbeObservations, place: Vector3, reach: float) -> str:
    """The landmark nearest to a place, if one is within reach."""
    distance = {
        name: float(np.linalg.norm(points - place, axis=1).min())
        for name, points in probe.landmarks.items()
    }
    nearest = min(distance, key=lambda name: distance[name], default="")
    return nearest if nearest and distance[nearest] < reach else ""
