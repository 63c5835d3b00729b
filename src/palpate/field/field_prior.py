"""Gaussian prior of the logarithm of a body's shear modulus over its mean, and the choice of its
size and length by the evidence.

A field is m = Phi b, Phi the modes of the shortest length, which can be any longer field as well;
under a prior of standard deviation s and length l its coefficients are b = L(s, l) xi, xi normal.
About a field b0 the data say of b, everything else marginalised, exp(-b'H b / 2 + h'b), so that

    log evidence = y'A^-1 y / 2 - log det A / 2,    A = 1 + L'H L,    y = L'h,

up to a constant. It is 0 for s = 0: a body that is the same everywhere.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.shapes import Points

# Standard deviations of log G, and lengths over the cube root of the body's volume, that are tried.
_STDS = 0.05 * 2.0 ** np.arange(6)
_LENGTHS = 0.125 * 2.0 ** np.arange(4)
# Most modes, and the variance of a field over its prior's that may remain without them.
_MOST_MODES, _LEFT = 300, 0.01


@dataclass(frozen=True, slots=True)
class FieldPrior:
    """Prior of a field: Gaussian, of mean zero, its covariance a Matern function of order 3/2.

    Attributes
    ----------
    std : float [-]                 of the logarithm of the modulus
    length : float [m]              over which it varies
    log_evidence : float            over that of a body that is the same everywhere
    """

    std: float
    length: float
    log_evidence: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FieldModes:
    """Modes of fields on the elements of a body.

    Attributes
    ----------
    centre : (m, 3) float [m]       of every element
    volume : (m,) float [m^3]
    modes : (m, k) float [-]        Phi: of a prior of unit variance and the shortest length,
                                    without the mean over the volume, which is log G itself
    lengths : (l,) float [m]        that priors may have, ascending
    mixing : tuple of (k, j) float  L(1, l) of each length
    """

    centre: Points
    volume: Float[np.ndarray, " m"]
    modes: Float[np.ndarray, "m k"]
    lengths: Float[np.ndarray, " l"]
    mixing: tuple[Float[np.ndarray, "k _"], ...]

    def mixing_of(self, prior: FieldPrior) -> Float[np.ndarray, "k j"]:
        """L of a prior of one of the lengths."""
        return prior.std * self.mixing[int(np.abs(self.lengths - prior.length).argmin())]

    def best_prior(
        self, information: Float[np.ndarray, "k k"], score: Float[np.ndarray, " k"]
    ) -> FieldPrior:
        """The prior of most evidence.

        Parameters
        ----------
        information : (k, k) float      H
        score : (k,) float              h
        """
        # Rounding may leave a combination about which the data know nothing slightly negative.
        value, vector = np.linalg.eigh(information)
        information = (vector * np.maximum(value, 0.0)) @ vector.T
        priors = [
            FieldPrior(float(std), float(length), _log_evidence(std * mixing, information, score))
            for length, mixing in zip(self.lengths, self.mixing, strict=True)
            for std in _STDS
        ]
        return max(priors, key=lambda prior: prior.log_evidence)


def make_field_modes(centre: Points, volume: Float[np.ndarray, " m"]) -> FieldModes:
    """Modes of the fields that a body may have.

    Parameters
    ----------
    centre : (m, 3) float [m]       of every element
    volume : (m,) float [m^3]

    Returns
    -------
    FieldModes
    """
    lengths = float(volume.sum()) ** (1.0 / 3.0) * _LENGTHS
    modes = _modes(centre, volume, lengths[0])
    root = np.sqrt(volume)[:, None]
    mixing = [np.eye(modes.shape[1])]
    for length in lengths[1:]:
        longer = root * _modes(centre, volume, length)
        mixing.append(np.linalg.lstsq(root * modes, longer)[0])
    return FieldModes(centre, volume, modes, lengths, tuple(mixing))


def _modes(
    centre: Points, volume: Float[np.ndarray, " m"], length: float
) -> Float[np.ndarray, "m k"]:
    """Fields whose products add up to the covariance of a prior of unit variance, without the mean
    over the volume.

    Source
    ------
    Harbrecht, Peters and Schneider, On the low-rank approximation by the pivoted Cholesky
    decomposition, Applied Numerical Mathematics 62 (2012) 428, algorithm 1.
    """
    left, modes = np.ones(len(centre)), np.zeros((min(_MOST_MODES, len(centre)), len(centre)))
    for k in range(len(modes)):
        pivot = int(left.argmax())
        if left[pivot] < _LEFT:
            modes = modes[:k]
            break
        column = _matern(np.linalg.norm(centre - centre[pivot], axis=1) / length)
        column -= modes[:k, pivot] @ modes[:k]
        modes[k] = column / np.sqrt(left[pivot])
        left = np.maximum(left - modes[k] ** 2, 0.0)
    return (modes - (modes @ volume / volume.sum())[:, None]).T


def _matern(distance: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Correlation at a distance over the length."""
    scaled = np.sqrt(3.0) * distance
    return (1.0 + scaled) * np.exp(-scaled)


def _log_evidence(
    mixing: Float[np.ndarray, "k j"],
    information: Float[np.ndarray, "k k"],
    score: Float[np.ndarray, " k"],
) -> float:
    factor = np.linalg.cholesky(np.eye(mixing.shape[1]) + mixing.T @ information @ mixing)
    half = np.linalg.solve(factor, mixing.T @ score)
    return float(0.5 * half @ half - np.log(np.diag(factor)).sum())
