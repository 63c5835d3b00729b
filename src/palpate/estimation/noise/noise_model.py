"""Noise models: their interface, and the moments of the robust score.

A model is a distribution of the vector of a point's scaled residuals (one to three components, each
in units of its sigma), or of a probing's force. It depends on the squared length of that vector
alone: a wrong match spoils all components of a point. Everything that the fit and its intervals
need follows from three functions of the squared length.
"""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.special import roots_genlaguerre

_QUADRATURE_NODES = 40

Values = Float[np.ndarray, "..."]


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


def score_moments(
    noise: NoiseModel, squared: Float[np.ndarray, " p"], components: Float[np.ndarray, " p"]
) -> tuple[float, float]:
    """Mean square of the score and mean slope of the score per component, from residuals.

    Parameters
    ----------
    noise : NoiseModel
    squared : (p,) float [-]        squared length of each residual in sigmas, >= 0
    components : (p,) float         measured components of each point, 1 to 3

    Returns
    -------
    (float, float)                  E[psi^2] and E[psi'] in units where least squares has 1 and 1;
                                    the variance of an estimate is their ratio E[psi^2] / E[psi']^2
                                    times that of least squares

    Source
    ------
    Huber and Ronchetti, Robust Statistics, 2nd ed., chapter 7 (covariance of regression).
    """
    power, slope = _scores(noise, squared, components)
    count = components.sum()
    return float(power.sum() / count), float(slope.sum() / count)


def gaussian_moments(noise: NoiseModel, components: int) -> tuple[float, float]:
    """Expected `score_moments` for Gaussian noise of the claimed standard deviation.

    Parameters
    ----------
    noise : NoiseModel
    components : int                of each vector, 1 to 3

    Returns
    -------
    (float, float)                  E[psi^2] and E[psi'], both 1 for least squares

    Source
    ------
    Gauss-Laguerre quadrature over the chi-square distribution of the squared length.
    """
    node, share = roots_genlaguerre(_QUADRATURE_NODES, components / 2 - 1)
    power, slope = _scores(noise, 2 * node, np.full_like(node, components))
    share = share / (share.sum() * components)
    return float(share @ power), float(share @ slope)


def _scores(noise: NoiseModel, squared: Values, components: Values) -> tuple[Values, Values]:
    """Squared length of each vector's score, and the divergence of the score.

    The score of a vector e is psi = weight(e'e) e; its divergence is p weight + 2 e'e weight'.
    """
    weight = noise.weight(squared, components)
    power = weight**2 * squared
    return power, components * weight + 2 * squared * noise.weight_slope(squared, components)
