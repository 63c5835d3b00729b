"""How measured displacements scatter about the truth: loss, robust weights, and noise levels.

A noise model is a distribution of the vector of a point's scaled residuals (one to three
components, each in units of its sigma). It depends on the squared length of that vector alone: a
wrong match spoils all components of a point.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.special import roots_genlaguerre

from palpate.estimation.measured_components import (
    FIRST_CLAIMED,
    GROUP_COUNT,
    TIP_GROUP,
    MeasuredComponents,
)

Values = Float[np.ndarray, "..."]

_QUADRATURE_NODES = 40
# A claim stands unless residuals exceed it by so many standard errors: that of a variance from the
# median of n Gaussian squares, over its value, is the second of these over the root of n.
_SIGNIFICANT, _MEDIAN_ERROR = 2.5, 2.33
# Rows that the mean level of the field counts for as that of the tip.
_TIP_ROWS = 3.0
# Of the largest displacement: no field is measured better, and sums of squares must not lose more
# than half of their digits.
FINEST = 1e-5
# Of a Gaussian variable of variance 1.
_MEDIAN_SQUARE = 0.4549364231195727
# Groups with a level of their own.
_POOLED = ([0], [1], [2], [TIP_GROUP], [4, 5, 6], [FIRST_CLAIMED + TIP_GROUP])


@runtime_checkable
class NoiseModel(Protocol):
    """Distribution of a vector of p components, each of sigma 1, by its squared length.

    Takes arrays of equal shape: the squared length (>= 0) and the number of components p (0 to 3;
    with p = 0 the length is 0 as well). A frozen dataclass; its fields are its own parameters.
    """

    def loss(self, squared: Values, components: Values) -> Values:
        """Minus twice the logarithm of the density [-], without its constant: 0 at length 0."""
        ...

    def weight(self, squared: Values, components: Values) -> Values:
        """Derivative of the loss with respect to the squared length, > 0: the weight in iteratively
        reweighted least squares."""
        ...

    def weight_slope(self, squared: Values, components: Values) -> Values:
        """Derivative of the weight with respect to the squared length, <= 0."""
        ...


@dataclass(frozen=True, slots=True)
class StudentT:
    """Student's t distribution of a whole vector (`NoiseModel`): robust to gross outliers.

    Measured asymptotic RMSE relative to a scheme that knows the outliers, p = 3, gross errors of 10
    to 40 sigma at 0 / 3 / 10 / 25 % of the points: with 4 degrees of freedom 1.05 / 1.05 / 1.05 /
    1.05, with 8 degrees 1.02 / 1.02 / 1.03 / 1.04, with 16 degrees 1.01 / 1.01 / 1.02 / 1.05; soft
    L1 (best of three tuning constants) 1.00 / 1.05 / 1.13 / 1.32. Hence 8 degrees.

    Parameters
    ----------
    degrees : float                 degrees of freedom nu, > 0; small values give heavy tails

    Source
    ------
    Lange, Little and Taylor, Robust statistical modeling using the t distribution, J. Am. Stat.
    Assoc. 84 (1989): density of p components ~ (1 + d2 / nu)^(-(nu + p) / 2) and the weight
    (nu + p) / (nu + d2) that follows, with p the number of random components (not always three).
    """

    degrees: float = 8.0

    def loss(self, squared: Values, components: Values) -> Values:
        """(nu + p) log(1 + d2 / nu) [-]."""
        return (self.degrees + components) * np.log1p(squared / self.degrees)

    def weight(self, squared: Values, components: Values) -> Values:
        """(nu + p) / (nu + d2): (nu + p) / nu at length 0, falling to 0."""
        return (self.degrees + components) / (self.degrees + squared)

    def weight_slope(self, squared: Values, components: Values) -> Values:
        """-(nu + p) / (nu + d2)^2."""
        return -(self.degrees + components) / (self.degrees + squared) ** 2


@dataclass(frozen=True, slots=True)
class Gaussian:
    """Independent Gaussian components (`NoiseModel`); one gross error spoils the fit."""

    def loss(self, squared: Values, components: Values) -> Values:
        """d2, whatever the number of components."""
        return squared + np.zeros_like(components)

    def weight(self, squared: Values, components: Values) -> Values:
        """1 everywhere."""
        return np.ones_like(squared + components)

    def weight_slope(self, squared: Values, components: Values) -> Values:
        """0 everywhere."""
        return np.zeros_like(squared + components)


NOISE_MODELS: dict[str, NoiseModel] = {"student-t": StudentT(), "gaussian": Gaussian()}


def relative_weight(
    noise: NoiseModel, squared: Float[np.ndarray, " p"], components: Float[np.ndarray, " p"]
) -> Float[np.ndarray, " p"]:
    """Robust weight of each point relative to that of a zero residual, in (0, 1].

    Parameters
    ----------
    noise : NoiseModel
    squared : (p,) float [-]        squared length of each residual in sigmas, >= 0
    components : (p,) float         measured components of each point, 1 to 3

    Returns
    -------
    (p,) float [-]
    """
    whole = noise.weight(np.zeros_like(squared), components)
    return noise.weight(squared, components) / whole


@dataclass(frozen=True, slots=True)
class Moments:
    """Means per component over the points, each 1 for least squares and Gaussian noise.

    Attributes
    ----------
    power : float                   squared score, E[psi^2]
    slope : float                   slope of the score, E[psi']

    Source
    ------
    Huber and Ronchetti, Robust Statistics, 2nd ed., chapter 7 (covariance of regression)
    """

    power: float
    slope: float

    @property
    def information(self) -> float:
        """Factor on the loss for which its curvature is the inverse variance of the estimate."""
        return self.slope / self.power


def moments_of(
    noise: NoiseModel, squared: Float[np.ndarray, " p"], components: Float[np.ndarray, " p"]
) -> Moments:
    """Moments of the robust score from residuals.

    Parameters
    ----------
    noise : NoiseModel
    squared : (p,) float [-]        squared length of each residual in sigmas, >= 0
    components : (p,) float         measured components of each point, 1 to 3

    Returns
    -------
    Moments
    """
    return _moments(noise, squared, components, np.full(len(squared), 1.0 / components.sum()))


def gaussian_moments(noise: NoiseModel, components: int) -> Moments:
    """Moments of the robust score for Gaussian noise of the claimed standard deviation.

    Parameters
    ----------
    noise : NoiseModel
    components : int                of each vector, 1 to 3

    Returns
    -------
    Moments

    Source
    ------
    Gauss-Laguerre quadrature over the chi-square distribution of the squared length.
    """
    node, share = roots_genlaguerre(_QUADRATURE_NODES, components / 2 - 1)
    count = np.full_like(node, components)
    return _moments(noise, 2 * node, count, share / (share.sum() * components))


def _moments(noise: NoiseModel, squared: Values, components: Values, share: Values) -> Moments:
    """The score of a vector e is weight(e'e) e; its divergence is p weight + 2 e'e weight'."""
    weight = noise.weight(squared, components)
    slope = components * weight + 2 * squared * noise.weight_slope(squared, components)
    return Moments(float(share @ (weight**2 * squared)), float(share @ slope))


def noise_levels(
    probes: Sequence[MeasuredComponents],
    squares: Sequence[Float[np.ndarray, " _"]],
    model_variance: Sequence[Float[np.ndarray, " _"]],
) -> Float[np.ndarray, " 8"]:
    """Noise level of each group, pooled over all probings, from medians: half of all rows may be
    outliers.

    Where no standard deviation was claimed: the standard deviation of the component [m] beyond the
    model's own error. With a claim: the factor by which the residuals exceed the claim and that
    error together, the same along x, y and z; 1 unless that is more than chance.

    Parameters
    ----------
    probes : sequence of MeasuredComponents
    squares : one (r,) float [m^2] for each     squared residuals, corrected for lost degrees of
                                                freedom
    model_variance : one (r,) float [m^2] for each    of what varies of the model's error

    Returns
    -------
    (8,) float                                  to be multiplied by `MeasuredComponents.unit`
    """
    group = np.concatenate([probe.group for probe in probes])
    unit = np.concatenate([probe.unit for probe in probes]) ** 2
    square, known = np.concatenate(squares) / unit, np.concatenate(model_variance) / unit
    measured = np.concatenate([probe.measured for probe in probes]) ** 2 / unit
    level = np.ones(GROUP_COUNT)
    for members in _POOLED:
        chosen = np.isin(group, members)
        if chosen.any():
            least = FINEST**2 * float(measured[chosen].max()) + np.finfo(float).tiny
            excess = _excess_variance(square[chosen], known[chosen], least)
            if members[0] >= FIRST_CLAIMED:
                chance = _SIGNIFICANT * _MEDIAN_ERROR / np.sqrt(np.count_nonzero(chosen))
                excess = excess if excess > 1.0 + chance else 1.0
            level[members] = excess
    _settle_tip(level, np.bincount(group, minlength=GROUP_COUNT))
    return np.sqrt(level)


def _excess_variance(
    square: Float[np.ndarray, " n"], known: Float[np.ndarray, " n"], least: float
) -> float:
    """Variance that, added to what is known of each value's, makes the median of their squares that
    of Gaussian ones; at least `least`."""

    def excess(variance: float) -> float:
        return float(np.median(square / (variance + known))) - _MEDIAN_SQUARE

    most = float(square.max()) / _MEDIAN_SQUARE + least
    if excess(least) <= 0.0:
        return least
    return float(brentq(excess, least, most, xtol=1e-3 * least, rtol=1e-6))


def _settle_tip(level: np.ndarray, count: np.ndarray) -> None:
    """Shrink the estimated variance of the tip, which has few rows, towards that of the field."""
    has_field = count[:TIP_GROUP] > 0
    if count[TIP_GROUP] and has_field.any():
        prior = float(np.mean(level[:TIP_GROUP][has_field])) * _TIP_ROWS
        total = prior + count[TIP_GROUP] * level[TIP_GROUP]
        level[TIP_GROUP] = total / (count[TIP_GROUP] + _TIP_ROWS)
