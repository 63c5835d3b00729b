"""Creep compliance from the motion under known forces: its terms, and how many there are."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares, nnls
from scipy.special import stdtrit

from palpate.arrays import fix_fields
from palpate.errors import InputError
from palpate.relaxation.creep import CreepCompliance, memory

_MOST_TERMS = 3
# Instants that are left over for the noise.
_SPARE = 4
# Residuals count as correlated beyond so many standard deviations of independent ones.
_CORRELATED = 2.0
# Instants that count as independent, however smooth the residuals of a model that is wrong are.
_LEAST = 10.0
# Least and largest compliance of a term over all that moves, as logarithms.
_LOG_RANGE = (-18.0, 5.0)
# Time constants may leave their grid by a factor of three below and of ten above.
_BELOW, _ABOVE = np.log(3.0), np.log(10.0)
# Relative to the motion: what the search leaves, far below any measurement.
_ROUNDING = 1e-6
_STEP = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion under a force, as one number at each of some instants.

    Parameters
    ----------
    time : (n,) float [s]           knots of the piecewise linear force, increasing
    force : (n,) float              zero before the first knot; any unit
    instant : (k,) int              knots at which the motion was measured
    amplitude : (k,) float          motion there, in any unit: each `Motion` has a scale of its own
    std : (k,) float                its noise, up to a factor that is the same for all; > 0
    reference : int                 knot at which the static modulus was measured
    name : str                      for figures

    Raises
    ------
    InputError                      a wrong shape, times that do not increase, noise of zero
    """

    time: Float[np.ndarray, " n"]
    force: Float[np.ndarray, " n"]
    instant: Int[np.ndarray, " k"]
    amplitude: Float[np.ndarray, " k"]
    std: Float[np.ndarray, " k"]
    reference: int
    name: str = ""

    def __post_init__(self) -> None:
        fix_fields(self, time=(None,))
        fix_fields(self, force=(len(self.time),))
        fix_fields(self, integer=True, instant=(None,))
        fix_fields(self, amplitude=(len(self.instant),), std=(len(self.instant),))
        if not (np.diff(self.time) > 0.0).all() or not (self.std > 0.0).all():
            raise InputError("the times of a motion increase, and its standard deviations are > 0")


@dataclass(frozen=True, slots=True, eq=False)
class CreepFit:
    """A creep compliance with its covariance.

    Attributes
    ----------
    motions : tuple of Motion
    theta : (p,) float              logarithms of J_0, of the J_i, of the tau_i, of the scales of
                                    the second and further motions
    covariance : (p, p) float       with the noise as found
    terms : int                     m, 0 if the body is elastic
    log_evidence : tuple of float   of 0, 1, ... terms
    degrees : float                 effective number of instants less that of parameters
    noise : float                   standard deviation of the residuals over the given one
    """

    motions: tuple[Motion, ...]
    theta: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    terms: int
    log_evidence: tuple[float, ...]
    degrees: float
    noise: float

    @property
    def compliance(self) -> CreepCompliance:
        """In units of the static compliance: as a mean over the motions, the response at the
        instants of reference is what a static model gives of the force there."""
        return _normalised(self.theta, self.terms, self.motions)

    @property
    def quantile(self) -> float:
        """Half a 95 % interval over its standard deviation."""
        return float(stdtrit(max(self.degrees, 1.0), 0.975))

    def predicted(self, number: int) -> Float[np.ndarray, " n"]:
        """Motion at all knots of one of the motions, in its unit."""
        motion = self.motions[number]
        *_, scale = _split(self.theta, self.terms, len(self.motions))
        response = _compliance(self.theta, self.terms).response(motion.time, motion.force)
        return scale[number] * response

    def logarithm(
        self, quantity: Callable[[CreepCompliance], Float[np.ndarray, " q"]]
    ) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
        """Logarithm of something positive that follows from `compliance`, and its deviation.

        Parameters
        ----------
        quantity : callable         CreepCompliance -> (q,) float, > 0

        Returns
        -------
        value, std : (q,) float     of the natural logarithm
        """

        def at(theta: Float[np.ndarray, " p"]) -> Float[np.ndarray, " q"]:
            return np.log(quantity(_normalised(theta, self.terms, self.motions)))

        steps = _STEP * np.eye(len(self.theta))
        slope = np.array([at(self.theta + s) - at(self.theta - s) for s in steps]) / (2.0 * _STEP)
        variance = np.einsum("pq,pr,rq->q", slope, self.covariance, slope)
        return at(self.theta), np.sqrt(np.maximum(variance, 0.0))


def fit_creep(motions: Sequence[Motion], *, shortest: float, longest: float) -> CreepFit:
    """The creep compliance that motions share, with as many terms as the data ask for.

    Every number of terms starts at the best times on a grid of half decades, with amplitudes that
    are not negative, and leaves the grid by Gauss-Newton steps. The noise level is free: the
    logarithm of the marginal likelihood of a model is, to Schwarz's order,

        -(n_eff log RSS + p log n) / 2,

    with the number n_eff of n instants that are independent by the residuals of the largest model;
    the penalty of the p parameters counts all, which is on the side of fewer terms.

    Parameters
    ----------
    motions : sequence of Motion    at least one
    shortest, longest : float [s]   ends of the grid of time constants

    Returns
    -------
    CreepFit

    Raises
    ------
    InputError                      too few instants

    Source
    ------
    Schwarz, Ann. Stat. 6 (1978) 461; McQuarrie, Stat. Probab. Lett. 44 (1999) 79; n_eff of a
    first-order autoregression: Bartlett, J. R. Stat. Soc. Suppl. 8 (1946) 27.
    """
    motions = tuple(motions)
    count = sum(len(motion.instant) for motion in motions)
    most = min(_MOST_TERMS, (count - len(motions) - _SPARE) // 2)
    if most < 1:
        raise InputError(
            f"creep was measured at {count} instants; at least {len(motions) + _SPARE + 2} are"
            " needed, most of them while the force is held"
        )
    grid = shortest * 10.0 ** np.arange(0.0, np.log10(max(longest / shortest, 1.0)) + 0.25, 0.5)
    columns = _grid_columns(motions, grid)
    thetas = [_best(motions, grid, columns, m) for m in range(min(most, len(grid)) + 1)]
    residuals = [_residual(theta, m, motions) for m, theta in enumerate(thetas)]
    independent = count * _independent_share(residuals[-1], motions)
    floor = sum(
        float(np.square(_ROUNDING * motion.amplitude / motion.std).sum()) for motion in motions
    )
    square = [float(r @ r) + floor for r in residuals]
    sizes = np.array([len(theta) for theta in thetas])
    penalty = sizes * np.log(count) * count / (count - sizes - 2)
    evidence = -0.5 * (independent * np.log(square) + penalty)
    terms = int(np.argmax(evidence))
    theta = thetas[terms]
    slope = _derivative(theta, terms, motions)
    degrees = max(independent - len(theta), 1.0)
    covariance = square[terms] / degrees * np.linalg.pinv(slope.T @ slope, rcond=1e-12)
    noise = float(np.sqrt(square[terms] / degrees * independent / count))
    return CreepFit(motions, theta, covariance, terms, tuple(evidence.tolist()), degrees, noise)


def _split(
    theta: np.ndarray, terms: int, motions: int
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """J_0, J_i, tau_i, and the scale of every motion."""
    value = np.exp(theta)
    scale = np.append(1.0, value[1 + 2 * terms :])[:motions]
    return float(value[0]), value[1 : 1 + terms], value[1 + terms : 1 + 2 * terms], scale


def _compliance(theta: np.ndarray, terms: int) -> CreepCompliance:
    return CreepCompliance(*_split(theta, terms, 0)[:3])


def _normalised(theta: np.ndarray, terms: int, motions: Sequence[Motion]) -> CreepCompliance:
    """`CreepFit.compliance`."""
    raw = _compliance(theta, terms)
    ratio = [
        raw.response(motion.time, motion.force)[motion.reference] / motion.force[motion.reference]
        for motion in motions
    ]
    unit = float(np.exp(np.mean(np.log(ratio))))
    return CreepCompliance(raw.instantaneous / unit, raw.terms / unit, raw.times)


def _grid_columns(motions: Sequence[Motion], grid: np.ndarray) -> np.ndarray:
    """Weighted responses of all instants to a unit J_0 and to a unit term of each time constant,
    (count, 1 + grid)."""
    parts = []
    for motion in motions:
        terms = [motion.force - memory(motion.time, motion.force, tau)[0] for tau in grid]
        rows = np.stack([motion.force, *terms], axis=1)[motion.instant]
        parts.append(rows / motion.std[:, None])
    return np.concatenate(parts)


def _best(
    motions: Sequence[Motion], grid: np.ndarray, columns: np.ndarray, terms: int
) -> np.ndarray:
    """The parameters that fit best with some number of terms."""
    target = np.concatenate([motion.amplitude / motion.std for motion in motions])
    best = [
        (*nnls(columns[:, (0, *(1 + k for k in chosen))], target)[::-1], list(chosen))
        for chosen in combinations(range(len(grid)), terms)
    ]
    _, amplitude, chosen = min(best, key=lambda solution: solution[0])
    total = float(np.log(max(amplitude.sum(), np.finfo(float).tiny)))
    low = np.full(1 + 2 * terms + len(motions) - 1, total + _LOG_RANGE[0])
    high = low + _LOG_RANGE[1] - _LOG_RANGE[0]
    times = slice(1 + terms, 1 + 2 * terms)
    low[times], high[times] = np.log(grid[0]) - _BELOW, np.log(grid[-1]) + _ABOVE
    low[times.stop :], high[times.stop :] = _LOG_RANGE
    start = np.zeros_like(low)
    # A term that starts at nothing would have no slope to grow along.
    start[: 1 + terms] = np.log(np.maximum(amplitude, 1e-3 * amplitude.sum()))
    start[times] = np.log(grid[chosen])
    best = least_squares(
        _residual, start, _derivative, bounds=(low, high), args=(terms, motions), xtol=1e-8,
        ftol=1e-9, max_nfev=60,
    )  # fmt: skip
    return np.asarray(best.x)


def _residual(theta: np.ndarray, terms: int, motions: Sequence[Motion]) -> np.ndarray:
    """Predicted minus measured motion at all instants, in standard deviations."""
    compliance = _compliance(theta, terms)
    *_, scale = _split(theta, terms, len(motions))
    parts = []
    for s, motion in zip(scale, motions, strict=True):
        predicted = s * compliance.response(motion.time, motion.force)[motion.instant]
        parts.append((predicted - motion.amplitude) / motion.std)
    return np.concatenate(parts)


def _derivative(theta: np.ndarray, terms: int, motions: Sequence[Motion]) -> np.ndarray:
    """Derivative of `_residual` to theta, (count, p)."""
    first, amplitude, times, scale = _split(theta, terms, len(motions))
    parts = []
    for k, motion in enumerate(motions):
        columns = np.zeros((len(motion.time), len(theta)))
        columns[:, 0] = first * motion.force
        for i, (j, tau) in enumerate(zip(amplitude, times, strict=True), start=1):
            left, change = memory(motion.time, motion.force, tau)
            columns[:, i] = j * (motion.force - left)
            columns[:, terms + i] = -j * change
        if k > 0:
            columns[:, 2 * terms + k] = columns[:, : 1 + terms].sum(axis=1)
        parts.append(scale[k] * columns[motion.instant] / motion.std[:, None])
    return np.concatenate(parts)


def _independent_share(residual: np.ndarray, motions: Sequence[Motion]) -> float:
    """Effective over actual number of instants, from the correlation of successive residuals."""
    ends = np.cumsum([len(motion.instant) for motion in motions])
    parts = np.split(residual, ends[:-1])
    total = float(residual @ residual)
    if total == 0.0:
        return 1.0
    correlation = sum(float(part[1:] @ part[:-1]) for part in parts) / total
    if correlation * np.sqrt(len(residual)) < _CORRELATED:
        return 1.0
    return max((1.0 - correlation) / (1.0 + correlation), min(_LEAST / len(residual), 1.0))
