"""Posterior of the constants: intervals, their budget by source, and the likelihood over (nu, G).

The posterior is that of the objective itself, with priors and the model's error in it, so no
parameter is less certain than its prior. Intervals are projections of the region in which the
objective, at its minimum over all else, is less than the square of a quantile above its minimum.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BarycentricInterpolator
from scipy.special import chdtri, stdtrit

from palpate.arrays import fix_fields
from palpate.estimation.measured_components import MeasuredComponents
from palpate.estimation.normal_equations import Evaluation, gram
from palpate.records import CONSTANT_NAMES, BudgetEntry, Constant

POINTS = "noise of the points"
_UPPER_TAIL = 0.975
# Nodes of the responses over the interval, and points of the curve drawn through them.
_NODES, _POINTS = 13, 401
# Half-width, in standard errors, over which the curve is computed first.
_REACH = 8.0
# nu is determined where its interval leaves out at least a fifth of its range.
_MAX_SHARE_OF_RANGE = 0.8
# A modulus is determined where the ends of its interval differ by less than this factor; without nu
# it is so where it changes by less than the second along the valley of the objective.
_MAX_FACTOR, _MAX_VALLEY_FACTOR = 2.0, 1.25
# Standard errors: chance alone leads farther beyond the range of nu in one session of forty.
_CLEARLY = 2.0
_TINY = 1e-12
_MAP_SIZE, _MAP_MARGIN, _MAP_LARGEST_FACTOR = 51, 0.75, 30.0


@dataclass(frozen=True, slots=True)
class IntervalSet:
    """The three constants with their intervals.

    Parameters
    ----------
    poisson_ratio, shear_modulus, young_modulus : Constant      [-], [Pa], [Pa]
    """

    poisson_ratio: Constant
    shear_modulus: Constant
    young_modulus: Constant


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodMap:
    """Minus twice the log likelihood ratio over the constants, 0 at the best.

    `height(0.5)` and `height(0.95)` bound the joint regions.

    Parameters
    ----------
    poisson_ratio : (k,) float [-]      ascending
    shear_modulus : (l,) float [Pa]     ascending, evenly spaced in the logarithm
    deviance : (k, l) float

    Raises
    ------
    InputError                          arrays that do not belong together
    """

    poisson_ratio: Float[np.ndarray, " k"]
    shear_modulus: Float[np.ndarray, " l"]
    deviance: Float[np.ndarray, "k l"]

    def __post_init__(self) -> None:
        fix_fields(self, poisson_ratio=(None,), shear_modulus=(None,))
        fix_fields(self, deviance=(len(self.poisson_ratio), len(self.shear_modulus)))

    @staticmethod
    def height(probability: float) -> float:
        """Deviance at the edge of the joint confidence region of a given probability.

        Parameters
        ----------
        probability : float [-]     between 0 and 1

        Returns
        -------
        float [-]                   quantile of chi-squared with two degrees of freedom
        """
        return float(chdtri(2, 1 - probability))


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """The objective over (nu, G), at its minimum over everything else, with robust weights and
    effects of errors as at the minimum: with z = G0 / G - 1 it is a z^2 - 2 b z + c, where a, b and
    c depend on nu.

    Parameters
    ----------
    poisson_ratio : (p,) float [-]      ascending
    a, b, c : (p,) float                a > 0
    reference : float [Pa]              G0
    """

    poisson_ratio: Float[np.ndarray, " p"]
    a: Float[np.ndarray, " p"]
    b: Float[np.ndarray, " p"]
    c: Float[np.ndarray, " p"]
    reference: float

    @property
    def lowest(self) -> Float[np.ndarray, " p"]:
        """Objective at the best shear modulus for each Poisson's ratio; only positive moduli are
        allowed."""
        best = np.maximum(self.b / self.a, -1.0)
        return self.a * best**2 - 2 * self.b * best + self.c

    @property
    def best_modulus(self) -> Float[np.ndarray, " p"]:
        """Best shear modulus for each Poisson's ratio [Pa]."""
        return self.reference / np.maximum(1.0 + self.b / self.a, _TINY)

    def deviance(self, shear_modulus: Float[np.ndarray, " l"]) -> Float[np.ndarray, "p l"]:
        """Objective above its lowest value, (p, l)."""
        z = self.reference / shear_modulus - 1.0
        value = self.a[:, None] * z**2 - 2 * self.b[:, None] * z + self.c[:, None]
        return np.maximum(value - self.lowest.min(), 0.0)

    def moduli(
        self, height: Float[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """Shear moduli between which the objective is below a height, for each Poisson's ratio; NaN
        where it is nowhere so; the upper end may be infinite."""
        square = np.maximum((height - self.c) / self.a + (self.b / self.a) ** 2, 0.0)
        root = np.sqrt(np.where(height >= self.lowest, square, np.nan))
        with np.errstate(divide="ignore"):
            high = self.reference / np.maximum(1.0 + self.b / self.a - root, 0.0)
        return self.reference / (1.0 + self.b / self.a + root), high


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Posterior of the constants from a set of probings.

    Attributes
    ----------
    minimum : Evaluation
    poisson_range : (float, float)
    quantile : float                half-width of a 95 % interval in standard errors
    profile : Profile               over the interval of nu and a margin; over all of its range
                                    where the data do not determine it
    determines_ratio : bool         whether they do
    """

    minimum: Evaluation
    poisson_range: tuple[float, float]
    quantile: float
    profile: Profile
    determines_ratio: bool

    def error(self, name: str) -> float:
        """Standard error of nu, log G or log E."""
        direction = directions(self.minimum.poisson_ratio)[name]
        return float(np.sqrt(direction @ self.minimum.normal.covariance[:2, :2] @ direction))

    def is_beyond_range(self) -> bool:
        """Whether the data lead clearly beyond the range of nu."""
        return _leads_beyond(self.minimum, self.error("poisson_ratio"))


def directions(poisson_ratio: float) -> dict[str, Float[np.ndarray, "2"]]:
    """Constant's name -> derivative of nu, log G or log E by (nu, log G)."""
    return {
        "poisson_ratio": np.array([1.0, 0.0]),
        "shear_modulus": np.array([0.0, 1.0]),
        "young_modulus": np.array([1.0 / (1.0 + poisson_ratio), 1.0]),
    }


def posterior_of(
    minimum: Evaluation, poisson_range: tuple[float, float], degrees: float
) -> Posterior:
    """Posterior of the constants at a minimum.

    Parameters
    ----------
    minimum : Evaluation
    poisson_range : (float, float)
    degrees : float                 of freedom of the noise levels; infinite where they were claimed

    Returns
    -------
    Posterior
    """
    error = float(np.sqrt(minimum.normal.covariance[0, 0]))
    nu, reach = minimum.poisson_ratio, _REACH * error
    ends = (max(poisson_range[0], nu - reach), min(poisson_range[1], nu + reach))
    quantile = float(stdtrit(degrees, _UPPER_TAIL)) if np.isfinite(degrees) else 1.959963984540054
    profile = profile_of(minimum, ends)
    height = profile.lowest.min() + quantile**2
    low, high = _crossings(profile.poisson_ratio, profile.lowest - height)
    known = high - low < _MAX_SHARE_OF_RANGE * (poisson_range[1] - poisson_range[0])
    known = known and not _leads_beyond(minimum, error)
    known = known and bool(np.isfinite(np.nanmax(profile.moduli(np.full(_POINTS, height))[1])))
    if not known:
        profile = profile_of(minimum, poisson_range)
    return Posterior(minimum, poisson_range, quantile, profile, known)


def _leads_beyond(minimum: Evaluation, error: float) -> bool:
    free = np.linalg.lstsq(minimum.normal.common, minimum.normal.gradient, rcond=None)[0]
    return bool(abs(free[0]) > _CLEARLY * error)


def degrees_of_freedom(minimum: Evaluation, determined: float) -> float:
    """Degrees of freedom of the noise levels: infinite where every row came with a standard
    deviation."""
    probes = minimum.problem.probes
    if all(probe.has_claims for probe in probes):
        return np.inf
    rows = sum(len(probe.measured) for probe in probes)
    return max(rows - determined, 0.5)


def profile_of(minimum: Evaluation, ends: tuple[float, float]) -> Profile:
    """The objective over an interval of Poisson's ratio and all shear moduli.

    Parameters
    ----------
    minimum : Evaluation
    ends : (float, float)           of the interval

    Returns
    -------
    Profile
    """
    angle = np.pi * (np.arange(_NODES) + 0.5) / _NODES
    node = 0.5 * (ends[0] + ends[1]) - 0.5 * (ends[1] - ends[0]) * np.cos(angle)
    products = _eliminated(minimum, node)
    # Columns: changes of the displacement from the minimum to every node, displacement there,
    # residual.
    change, here, left = products[:_NODES, :_NODES], products[-2], products[-1]
    square, nu = np.diag(change), np.arange(_NODES)
    a = here[-2] + 2 * here[nu] + square
    b = here[-1] + left[nu] - here[nu] - square
    c = left[-1] - 2 * left[nu] + square
    fine = np.linspace(*ends, _POINTS)
    factor = np.sin(angle) * (-1.0) ** np.arange(_NODES)
    curve = BarycentricInterpolator(node, np.stack([a, b, c], axis=1), wi=factor)(fine)
    a, b, c = curve.T
    return Profile(fine, a, b, c, minimum.shear_modulus)


def _eliminated(
    minimum: Evaluation, nodes: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k+2 k+2"]:
    """Weighted products, with all errors eliminated, of the change of the displacement from the
    minimum to every node, of what of the displacement scales with 1 / G, and of the residual,
    (k + 2, k + 2)."""
    problem, theta, layout = minimum.problem, minimum.theta, minimum.problem.layout
    precision, factor = problem.precision(), minimum.curvature_factor()
    m, k = layout.common - 2, len(nodes)
    size = m + k + 2
    shared = np.zeros((size, size))
    # Priors: errors are counted from where they are at the minimum, so they come with the measured.
    shared[:m, :m] = np.eye(m)
    at = theta[layout.errors]
    shared[:m, -1] = shared[-1, :m] = -at
    shared[-1, -1] = at @ at
    variances = problem.variance()
    for index, (probe, block, table, row) in enumerate(
        zip(problem.probes, layout.blocks, minimum.jacobian, minimum.residual, strict=True)
    ):
        load = problem.load(index, theta)
        here = _scaling(probe, float(theta[0]), load)
        moved = np.stack([_scaling(probe, float(nu), load) - here for nu in nodes])
        columns = np.vstack(
            [table[2 : layout.common], moved, -table[1:2],
             problem.information / factor * row[None], table[layout.common :]]
        )  # fmt: skip
        products = factor * gram(problem, index, columns, minimum.weights[index] / variances[index])
        prior, at = precision[block.whole], theta[block.whole]
        information = products[size:, size:] + np.diag(prior)
        cross = products[size:, :size].copy()
        cross[:, -1] -= prior * at
        shared += products[:size, :size] - cross.T @ np.linalg.solve(information, cross)
        shared[-1, -1] += float(prior @ at**2)
    if not m:
        return shared
    explained_by = shared[m:, :m] @ np.linalg.solve(shared[:m, :m], shared[:m, m:])
    return shared[m:, m:] - explained_by


def _scaling(
    probe: MeasuredComponents, poisson_ratio: float, load: Float[np.ndarray, " c"]
) -> Float[np.ndarray, " r"]:
    """Displacement that scales with 1 / G under a load."""
    terms = probe.observations.response_terms(poisson_ratio)[probe.rows, 0]
    return probe.whitened(terms[:, :4] @ load[:4])


def interval_set(posterior: Posterior) -> IntervalSet:
    """The constants with their 95 % intervals, from the data alone.

    Parameters
    ----------
    posterior : Posterior

    Returns
    -------
    IntervalSet                     std is the half-width over the quantile; every interval contains
                                    its estimate
    """
    lowest = posterior.profile.lowest
    return _constants(posterior, np.full_like(lowest, lowest.min() + posterior.quantile**2))


def reported_intervals(posterior: Posterior) -> tuple[IntervalSet, dict[str, bool]]:
    """Intervals to report, and which constants the data determine.

    Where the data do not determine Poisson's ratio, its interval is its range, and those of the
    moduli hold for all of it.

    Parameters
    ----------
    posterior : Posterior

    Returns
    -------
    IntervalSet
    constant's name -> bool
    """
    intervals = interval_set(posterior)
    determined = {
        name: bool(_ratio(getattr(intervals, name)) < _MAX_FACTOR) for name in CONSTANT_NAMES
    }
    determined["poisson_ratio"] = posterior.determines_ratio
    if posterior.determines_ratio:
        return intervals, determined
    profile = posterior.profile
    ranged = _constants(posterior, profile.lowest + posterior.quantile**2)
    valley = profile.best_modulus
    for name, line in (
        ("shear_modulus", valley),
        ("young_modulus", valley * (1 + profile.poisson_ratio)),
    ):
        along = bool(np.ptp(np.log(line)) < np.log(_MAX_VALLEY_FACTOR))
        determined[name] = along and _ratio(getattr(ranged, name)) < _MAX_FACTOR
    return ranged, determined


def _ratio(constant: Constant) -> float:
    """Upper over lower end of an interval."""
    low, high = constant.ci95
    return high / low if low > 0.0 else np.inf


def _constants(posterior: Posterior, height: Float[np.ndarray, " p"]) -> IntervalSet:
    """Projections of the profile's region below some heights on the three constants."""
    profile, best = posterior.profile, posterior.minimum
    low, high = profile.moduli(height)
    inside = np.isfinite(low)
    nu, young = profile.poisson_ratio, 2.0 * (1.0 + profile.poisson_ratio)
    ends = {
        "poisson_ratio": _crossings(nu, profile.lowest - height),
        "shear_modulus": (low[inside].min(), high[inside].max()),
        "young_modulus": ((young * low)[inside].min(), (young * high)[inside].max()),
    }
    values = {
        "poisson_ratio": best.poisson_ratio,
        "shear_modulus": best.shear_modulus,
        "young_modulus": 2.0 * best.shear_modulus * (1.0 + best.poisson_ratio),
    }
    constants = {}
    for name, value in values.items():
        first, last = min(ends[name][0], value), max(ends[name][1], value)
        std = (last - first) / (2.0 * posterior.quantile)
        constants[name] = Constant(value, float(std), (float(first), float(last)))
    return IntervalSet(**constants)


def _crossings(nu: Float[np.ndarray, " p"], above: Float[np.ndarray, " p"]) -> tuple[float, float]:
    """First and last place where a curve is not above zero, interpolated."""
    inside = np.flatnonzero(above <= 0.0)
    first, last = int(inside[0]), int(inside[-1])
    low, high = float(nu[first]), float(nu[last])
    if first > 0:
        low = float(np.interp(0.0, -above[first - 1 : first + 1], nu[first - 1 : first + 1]))
    if last < len(nu) - 1:
        high = float(np.interp(0.0, above[last : last + 2], nu[last : last + 2]))
    return low, high


def likelihood_map(posterior: Posterior, intervals: IntervalSet) -> LikelihoodMap:
    """Tabulate the objective about the reported intervals.

    Parameters
    ----------
    posterior : Posterior
    intervals : IntervalSet         the map covers them with a margin

    Returns
    -------
    LikelihoodMap                   51 x 51
    """
    low, high = intervals.poisson_ratio.ci95
    margin = _MAP_MARGIN * (high - low)
    ends = (
        max(posterior.poisson_range[0], low - margin),
        min(posterior.poisson_range[1], high + margin),
    )
    profile = profile_of(posterior.minimum, ends)
    best = intervals.shear_modulus.value
    soft, stiff = intervals.shear_modulus.ci95
    soft, stiff = max(soft, best / _MAP_LARGEST_FACTOR), min(stiff, best * _MAP_LARGEST_FACTOR)
    log_margin = _MAP_MARGIN * np.log(stiff / soft)
    modulus = np.exp(np.linspace(np.log(soft) - log_margin, np.log(stiff) + log_margin, _MAP_SIZE))
    chosen = np.linspace(0, _POINTS - 1, _MAP_SIZE).astype(int)
    return LikelihoodMap(profile.poisson_ratio[chosen], modulus, profile.deviance(modulus)[chosen])


def valley_text(posterior: Posterior) -> str:
    """The combination of G and nu that the data determine where they do not determine nu, in words.

    Parameters
    ----------
    posterior : Posterior           that does not determine nu

    Returns
    -------
    str                             formula, and by how much it changes over the range of nu
    """
    profile = posterior.profile
    nu, modulus = profile.poisson_ratio, profile.best_modulus
    combinations = {
        "E = 2 G (1 + nu)": modulus * (1 + nu),
        "G": modulus,
        "G / (1 - nu)": modulus / (1 - nu),
        "G / (1 - 2 nu)": modulus / (1 - 2 * nu),
    }
    change = {name: float(np.ptp(np.log(values))) for name, values in combinations.items()}
    best = min(change, key=lambda name: change[name])
    return f"{best} (it changes by {100 * change[best]:.1f} % over all of nu)"


def uncertainty_budget(
    posterior: Posterior, determined: dict[str, bool]
) -> tuple[BudgetEntry, ...]:
    """Contribution of each source to the standard deviations of nu, log G and log E.

    The estimate is linear, to first order, in the noise and in every error, whose prior has unit
    variance, so the contributions to the variance add up.

    Parameters
    ----------
    posterior : Posterior
    determined : constant's name -> bool

    Returns
    -------
    tuple of BudgetEntry            sorted by the contribution to Young's modulus, largest first;
                                    empty where Poisson's ratio is not determined: moduli are then
                                    given for all of its range

    Source
    ------
    JCGM 100, Guide to the expression of uncertainty in measurement (2008), 5.1
    """
    if not determined["poisson_ratio"]:
        return ()
    problem, normal = posterior.minimum.problem, posterior.minimum.normal
    sources, precision = problem.sources, problem.precision()
    parts = {}
    for name, direction in directions(posterior.minimum.poisson_ratio).items():
        variance = dict.fromkeys(sources[2:], 0.0)
        contribution = precision * normal.covariance_with(direction) ** 2
        for source, share in zip(sources[2:], contribution[2:].tolist(), strict=True):
            variance[source] += share
        total = posterior.error(name) ** 2
        variance[POINTS] = max(total - sum(variance.values()), 0.0)
        parts[name] = variance
    entries = [
        BudgetEntry(
            source,
            *(
                float(np.sqrt(parts[name][source])) if determined[name] else np.nan
                for name in CONSTANT_NAMES
            ),
        )
        for source in parts["poisson_ratio"]
    ]
    return tuple(sorted(entries, key=_size, reverse=True))


def _size(entry: BudgetEntry) -> float:
    """Contribution to the first constant that is determined, in the order E, G, nu."""
    values = (entry.young_modulus, entry.shear_modulus, entry.poisson_ratio)
    return next(value for value in values if not np.isnan(value))
