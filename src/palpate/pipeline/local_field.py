"""The displacement around a place of the surface, from noisy measured points: a plane and a
Gaussian process (kriging), whose size, smoothness and noise make the measurement most likely."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg.lapack import dtrtrs
from scipy.optimize import minimize
from scipy.spatial.distance import cdist
from scipy.special import ndtri

from palpate.shapes import PointIndices, Points, Vector3

# Prior variance of the plane over that of the noise.
_PLANE = 1e6
# Logarithms of the length of correlation over the farthest point's distance, and of the variance of
# the process over that of the noise: start and limits.
_START, _LIMITS = (0.0, 4.0), ((-0.7, 3.0), (-9.0, 25.0))
# Chance that a sound place has a point left out, as of the checks of a fit; passes that leave out.
_FALSE_ALARM, _ROUNDS = 1 / 400, 4
# Fewest points: a plane has four coefficients.
_FEWEST = 12


@dataclass(frozen=True, slots=True, eq=False)
class LocalField:
    """The displacement around a place.

    Attributes
    ----------
    rows : (n,) int                 of the measured points that it follows
    origin : (3,) float [m]
    size : float [m]                farthest distance of a point from the origin
    place : (n, 3) float [-]        of the points, from the origin, over the size
    middle : (3,) float [m]         mean displacement
    moved : (n, 3) float [m]        less the mean
    apart : (n, n) float [-]        distances of the places
    shape : (float, float)          length of correlation over the size; variance of the process
                                    over that of the noise
    level : float [m]               standard deviation of the noise, of all components together
    claim : float                   the same as it was given
    inverse : (3, n, n) float       of the points' covariance over level^2, for each component
    """

    rows: PointIndices
    origin: Vector3
    size: float
    place: Points
    middle: Vector3
    moved: Points
    apart: Float[np.ndarray, "n n"]
    shape: tuple[float, float]
    level: float
    claim: float
    inverse: Float[np.ndarray, "3 n n"]

    def weights(self, points: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "3 q n"]:
        """Weights of the measured points in the displacement of others, for each component.

        Parameters
        ----------
        points : (q, 3) float [m]
        """
        return np.asarray(self._prior(points) @ self.inverse)

    def at(self, points: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "q 3"]:
        """Most likely displacement of points [m].

        Parameters
        ----------
        points : (q, 3) float [m]
        """
        off = np.einsum("anm,ma->na", self.inverse, self.moved)
        return np.asarray(self.middle + self._prior(points) @ off)

    def rest(
        self, points: Float[np.ndarray, "q 3"], share: Float[np.ndarray, "p q"]
    ) -> Float[np.ndarray, "3 p p"]:
        """Covariance [m^2] of averages over points beyond that of the noise in them: what the
        measured points leave open between them.

        Parameters
        ----------
        points : (q, 3) float [m]
        share : (p, q) float [-]        of the points in the averages
        """
        used = share.any(axis=0)
        points, share = points[used], share[:, used]
        here = (points - self.origin) / self.size
        across = share @ self._prior(points)
        prior = share @ _prior_covariance(cdist(here, here), here, here, self.shape) @ share.T
        among = _prior_covariance(self.apart, self.place, self.place, self.shape)
        # Of the process and the plane, seen through weights that the noise has no part in.
        weights = across @ self.inverse
        mixed = weights @ across.T
        left = prior - mixed - mixed.mT + weights @ among @ weights.mT
        return np.asarray(self.level**2 * left)

    def _prior(self, points: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "q n"]:
        here = (points - self.origin) / self.size
        return _prior_covariance(cdist(here, self.place), here, self.place, self.shape)


def _prior_covariance(
    distance: Float[np.ndarray, "n k"],
    here: Points,
    there: Float[np.ndarray, "k 3"],
    shape: tuple[float, float],
) -> Float[np.ndarray, "n k"]:
    """Covariance of plane and process between points, over the noise's variance: Matern's, of
    smoothness 5/2."""
    length, power = shape
    scaled = np.sqrt(5.0) / length * distance
    process = (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
    return np.asarray(power * process + _PLANE * (1.0 + here @ there.T))


def local_field(
    rows: PointIndices,
    points: Points,
    moved: Points,
    noise: Float[np.ndarray, "3 n n"],
    *,
    claimed: bool,
) -> LocalField | None:
    """The displacement around a place; points that are far off are left out.

    Parameters
    ----------
    rows : (n,) int                 numbers of the points
    points : (n, 3) float [m]
    moved : (n, 3) float [m]
    noise : (3, n, n) float         covariance of each component's noise, up to one factor, which is
                                    found
    claimed : bool                  whether it is in m^2, and the factor at least 1: what looks like
                                    less noise may be noise that neighbours share

    Returns
    -------
    LocalField or None              None where there are too few points
    """
    # In a unit that makes the noise about 1.
    claim = float(np.sqrt(np.einsum("ann->an", noise).mean()))
    noise = noise / claim**2
    for _ in range(_ROUNDS):
        if len(rows) < _FEWEST:
            return None
        found = _most_likely(rows, points, moved, noise, claim, claimed)
        # What each point is off from the prediction by all others, over its standard deviation.
        sharp = np.einsum("ann->na", found.inverse)
        scaled = np.einsum("anm,ma->na", found.inverse, found.moved)
        off = np.abs(scaled) / (np.sqrt(sharp) * found.level)
        kept = off.max(axis=1) < -float(ndtri(0.5 * _FALSE_ALARM / off.size))
        if kept.all():
            break
        rows, points, moved = rows[kept], points[kept], moved[kept]
        noise = noise[:, kept][:, :, kept]
    return found


def _most_likely(
    rows: PointIndices,
    points: Points,
    moved: Points,
    noise: Float[np.ndarray, "3 n n"],
    claim: float,
    claimed: bool,
) -> LocalField:
    origin = points.mean(axis=0)
    size = float(np.linalg.norm(points - origin, axis=1).max())
    middle, place = moved.mean(axis=0), (points - origin) / size
    around = moved - middle

    apart, least = cdist(place, place), claim**2 if claimed else np.finfo(float).tiny
    if (noise == noise[0]).all():
        noise = noise[:1]

    def factors(at: Float[np.ndarray, "2"]) -> Float[np.ndarray, "c n n"]:
        length, power = np.exp(at).tolist()
        return np.linalg.cholesky(_prior_covariance(apart, place, place, (length, power)) + noise)

    def variance(found: Float[np.ndarray, "c n n"]) -> float:
        parts = around.T[:, :, None] if len(found) == 3 else around[None]
        white = [dtrtrs(each, part, lower=1)[0] for each, part in zip(found, parts, strict=True)]
        return sum(float((each**2).sum()) for each in white) / moved.size

    def surprise(at: Float[np.ndarray, "2"]) -> float:
        try:
            found = factors(at)
        except np.linalg.LinAlgError:
            return np.inf
        volume = 2.0 * float(np.log(np.einsum("ann->an", found)).sum()) * 3.0 / len(found)
        square = variance(found)
        level = max(square, least)
        return moved.size * (float(np.log(level)) + square / level) + volume

    best = minimize(
        surprise, _START, method="Nelder-Mead", bounds=_LIMITS,
        options={"xatol": 0.05, "fatol": 0.05, "maxfev": 80, "initial_simplex":
                 [_START, (1.5, 4.0), (0.0, 9.0)]},
    ).x  # fmt: skip
    found = factors(best)
    sides = np.linalg.inv(found)
    inverse = np.broadcast_to(sides.mT @ sides, (3, *apart.shape))
    length, power = np.exp(best).tolist()
    level = float(np.sqrt(max(variance(found), least)))
    return LocalField(
        rows, origin, size, place, middle, around, apart, (length, power), level, claim, inverse
    )
