"""Gaussian prior of the logarithm of a body's shear modulus over its mean, and the choice of its
size and length by the evidence.

A field is m = Phi b. Its modes Phi are those of the shortest length, which can be any longer field
as well, and layers: fields that depend on the depth below the free surface alone. Under a prior of
standard deviations s and s_d and length l its coefficients are b = L(s, s_d, l) xi, xi normal.
About a field b0 the data say of b, everything else marginalised, exp(-b'H b / 2 + h'b), so that

    log evidence = y'A^-1 y / 2 - log det A / 2,    A = 1 + L'H L,    y = L'h,

up to a constant. It is 0 for s = 0: a body that is the same everywhere.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag, solve_triangular

from palpate.shapes import Points

# Standard deviations of log G, and lengths that are tried; the longest, and an edge of the
# elements, about, over the cube root of the body's volume. Layers, which are few unknowns, begin
# with one edge.
STDS = 0.05 * 2.0 ** np.arange(6)
_LONGEST, _EDGE = 1.0, 0.125
# Most modes, and the variance of a field over its prior's that may remain without them.
_MOST_MODES, _LEFT = 300, 0.01

# What the data say of some coefficients: H and h.
_Known = tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]


@dataclass(frozen=True, slots=True)
class FieldPrior:
    """Prior of a field: Gaussian, of mean zero, its covariance a sum of Matern functions of order
    3/2, of distance and of the difference in depth.

    Attributes
    ----------
    std : float [-]                 of the logarithm of the modulus
    length : float [m]              over which it varies
    layer_std : float [-]           of its part that depends on the depth alone
    log_evidence : float            over that of a body that is the same everywhere
    """

    std: float
    length: float
    layer_std: float = 0.0
    log_evidence: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FieldModes:
    """Modes of fields on a body.

    Attributes
    ----------
    modes : (m, k + d) float [-]    Phi: of a prior of unit variance and the shortest length, then d
                                    of layers; without the mean over the volume, which is log G
                                    itself
    lengths : (l,) float [m]        that priors may have, ascending
    mixing : tuple of (k, j) float  L(1, l) of each length
    depth : (m,) float [m]          of the points below the free surface
    """

    modes: Float[np.ndarray, "m kd"]
    lengths: Float[np.ndarray, " l"]
    mixing: tuple[Float[np.ndarray, "k _"], ...]
    depth: Float[np.ndarray, " m"]

    @property
    def layers(self) -> int:
        """Number of modes that depend on the depth alone."""
        return self.modes.shape[1] - len(self.mixing[0])

    def mixing_of(self, prior: FieldPrior) -> Float[np.ndarray, "kd j"]:
        """L of a prior of one of the lengths."""
        mixing = self.mixing[int(np.abs(self.lengths - prior.length).argmin())]
        if not prior.layer_std:
            return prior.std * np.pad(mixing, ((0, self.layers), (0, 0)))
        return block_diag(prior.std * mixing, prior.layer_std * np.eye(self.layers))

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
        best = FieldPrior(0.0, 0.0, log_evidence=-np.inf)
        for length in self.lengths:
            mixing = self.mixing_of(FieldPrior(1.0, float(length), 1.0))
            about, along = mixing.T @ information @ mixing, mixing.T @ score
            for std, evidence, of_layers in _marginalised(about, along, self.layers):
                for layer_std in (0.0, *STDS):
                    with_layers = evidence + _log_evidence(of_layers, layer_std)
                    if with_layers > best.log_evidence:
                        best = FieldPrior(std, float(length), float(layer_std), with_layers)
        return best


def make_field_modes(
    points: Points,
    volume: Float[np.ndarray, " m"],
    depth: Float[np.ndarray, " m"],
    *,
    edges: int = 2,
) -> FieldModes:
    """Modes of the fields that a body may have.

    Parameters
    ----------
    points : (m, 3) float [m]       at which they are given
    volume : (m,) float [m^3]       that belongs to each
    depth : (m,) float [m]          below the free surface
    edges : int                     shortest length, in edges of the elements. Two where points
                                    about a push are seen: with one the ball in an hourglass is
                                    placed 7 mm off, with two 2 mm. One where each push tells of
                                    its own place only: with two, inclusions between 40 or 80
                                    pokes are not found at all

    Returns
    -------
    FieldModes
    """
    size = float(volume.sum()) ** (1.0 / 3.0)
    lengths = size * edges * _EDGE * 2.0 ** np.arange(1 + int(np.log2(_LONGEST / (edges * _EDGE))))
    modes = _modes(points, volume, lengths[0])
    root = np.sqrt(volume)[:, None]
    mixing = [np.eye(modes.shape[1])]
    for length in lengths[1:]:
        longer = root * _modes(points, volume, length)
        mixing.append(np.linalg.lstsq(root * modes, longer)[0])
    layers = _modes(depth[:, None], volume, size * _EDGE)
    return FieldModes(np.hstack([modes, layers]), lengths, tuple(mixing), depth)


def _modes(
    points: Float[np.ndarray, "m n"], volume: Float[np.ndarray, " m"], length: float
) -> Float[np.ndarray, "m k"]:
    """Fields whose products add up to the covariance of a prior of unit variance, without the mean
    over the volume.

    Source
    ------
    Harbrecht, Peters and Schneider, On the low-rank approximation by the pivoted Cholesky
    decomposition, Applied Numerical Mathematics 62 (2012) 428, algorithm 1.
    """
    left, modes = np.ones(len(points)), np.zeros((min(_MOST_MODES, len(points)), len(points)))
    for k in range(len(modes)):
        pivot = int(left.argmax())
        if left[pivot] < _LEFT:
            modes = modes[:k]
            break
        column = _matern(np.linalg.norm(points - points[pivot], axis=1) / length)
        column -= modes[:k, pivot] @ modes[:k]
        modes[k] = column / np.sqrt(left[pivot])
        left = np.maximum(left - modes[k] ** 2, 0.0)
    return (modes - (modes @ volume / volume.sum())[:, None]).T


def _matern(distance: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Correlation at a distance over the length."""
    scaled = np.sqrt(3.0) * distance
    return (1.0 + scaled) * np.exp(-scaled)


def _marginalised(
    information: Float[np.ndarray, "k k"], score: Float[np.ndarray, " k"], layers: int
) -> Iterator[tuple[float, float, _Known]]:
    """For each standard deviation of the modes before the last ones, which are layers: their log
    evidence, and what the data say of the layers with these marginalised."""
    count = len(score) - layers
    value, vector = np.linalg.eigh(information[:count, :count])
    cross, along = vector.T @ information[:count, count:], vector.T @ score[:count]
    for std in STDS:
        variance = std**2 / (1.0 + std**2 * value)
        evidence = 0.5 * float(variance @ along**2 - np.log1p(std**2 * value).sum())
        rest = information[count:, count:] - (cross.T * variance) @ cross
        yield float(std), evidence, (rest, score[count:] - cross.T @ (variance * along))


def best_evidence(
    information: Float[np.ndarray, "k k"],
    score: Float[np.ndarray, " k"],
    stds: Float[np.ndarray, " s"],
) -> tuple[float, float]:
    """Most log evidence of coefficients that are independent and of one standard deviation, and
    that standard deviation.

    Parameters
    ----------
    information, score : (k, k), (k,) float     H and h
    stds : (s,) float               that are tried
    """
    return max((_log_evidence((information, score), std), float(std)) for std in stds)


def _log_evidence(known: _Known, std: float) -> float:
    """Log evidence of coefficients that are independent and of one standard deviation."""
    information, score = known
    factor = np.linalg.cholesky(np.eye(len(score)) + std**2 * information)
    half = solve_triangular(factor, std * score, lower=True)
    return float(0.5 * half @ half - np.log(np.diag(factor)).sum())
