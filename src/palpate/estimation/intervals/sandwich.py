"""Covariance of (nu, log G): information, noise of the scores, and disagreement of the probings.

Model-based first: Fisher information of the robust loss, with the noise as the residuals show it
(never below the claim) and the spatial correlation of residuals. Then the probings are asked: if
their scores scatter more than that explains (a force sensor that is off, a model error that is
common to all points of a probing), the variance of the constant concerned is raised to the scatter,
with Student's quantile for their number. Scatter that chance explains changes nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, ndtri, stdtrit

from palpate.errors import InputError
from palpate.estimation.intervals.spatial_correlation import CorrelationFactor, correlation_factor
from palpate.estimation.noise import Gaussian, gaussian_moments, score_moments
from palpate.estimation.observations import GROUP_COUNT, ProbeObservations, observed_rows_of
from palpate.estimation.search import LocalProbe, Misfit, diagonal_root

DIRECTIONS = ("poisson_ratio", "shear_modulus", "young_modulus")
_RIDGE = 1e-11
# Share of the sessions whose probings scatter less by chance.
_SURPRISING_SHARE = 0.90
# Degrees of freedom that a claimed uncertainty is worth beside the scatter of the probings.
_PRIOR_DEGREES = 3.0
_UPPER_TAIL = 0.975


@dataclass(frozen=True, slots=True)
class ScoreNoise:
    """Noise of the robust scores, pooled over the probings of a session.

    Parameters
    ----------
    power, slope : float        mean square and mean slope of the score per component
    degrees : float             degrees of freedom of the noise, infinite where it was claimed
    correlation : CorrelationFactor
    """

    power: float
    slope: float
    degrees: float
    correlation: CorrelationFactor


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Score and information of every probing in (nu, log G), true forces eliminated.

    Parameters
    ----------
    score : (k, 2)
    information : (k, 2, 2)     expected slope of the score
    noise : (k, 2, 2)           model-based covariance of the score
    curvature : (k, 2, 2)       second derivative of half the misfit at fixed weights
    """

    score: Float[np.ndarray, "k 2"]
    information: Float[np.ndarray, "k 2 2"]
    noise: Float[np.ndarray, "k 2 2"]
    curvature: Float[np.ndarray, "k 2 2"]

    def covariance(self) -> Float[np.ndarray, "2 2"]:
        """Model-based covariance of (nu, log G), A^-1 B A^-1 with A the information and B the
        noise; huge, not infinite, along a combination without information.

        Source
        ------
        Huber, The behavior of maximum likelihood estimates under nonstandard conditions, 5th
        Berkeley Symposium (1967).
        """
        inverse, ridge = _inverse(self.information.sum(0))
        return inverse @ (self.noise.sum(0) + ridge) @ inverse

    def curvature_variance(self, direction: Float[np.ndarray, " 2"]) -> float:
        """Variance of a combination that the curvature of the misfit alone would claim.

        Parameters
        ----------
        direction : (2,) float      see `directions`

        Returns
        -------
        float [-]                   of that combination of (nu, log G)
        """
        return float(direction @ _inverse(self.curvature.sum(0))[0] @ direction)

    def scatter(self, direction: Float[np.ndarray, " 2"]) -> "Scatter":
        """Disagreement of the probings about one combination of (nu, log G).

        Parameters
        ----------
        direction : (2,) float      see `directions`

        Returns
        -------
        Scatter                     of ratio 1 without degrees of freedom for a single probing
        """
        if len(self.score) < 2:
            return Scatter(1.0, 0.0)
        total = self.information.sum(0)
        inverse, _ = _inverse(total)
        influence = inverse @ direction
        centred = self.score - self.information @ (inverse @ self.score.sum(0))
        share = self.information @ inverse
        crossed = share @ self.noise
        common = share @ self.noise.sum(0) @ share.swapaxes(1, 2)
        expected = self.noise - crossed - crossed.swapaxes(1, 2) + common
        want = np.einsum("i,kij,j->k", influence, expected, influence)
        want = np.maximum(want, 0.0)
        if want.sum() <= 0:
            return Scatter(1.0, 0.0)
        ratio = float(((centred @ influence) ** 2).sum() / want.sum())
        return Scatter(ratio, float(want.sum() ** 2 / (want**2).sum()))


@dataclass(frozen=True, slots=True)
class Scatter:
    """Scatter of the probings over what their claimed uncertainties explain.

    Parameters
    ----------
    ratio : float [-]           of variances, >= 0
    degrees : float             degrees of freedom, about the number of probings
    """

    ratio: float
    degrees: float

    @property
    def is_surprising(self) -> bool:
        """Whether chance gives so large a ratio in less than one of ten sessions."""
        if self.degrees <= 0:
            return False
        return self.ratio > float(chdtri(self.degrees, 1 - _SURPRISING_SHARE)) / self.degrees

    @property
    def factor(self) -> float:
        """Factor on the variance, 1 where the probings agree."""
        return self.ratio if self.is_surprising else 1.0


def directions(poisson_ratio: float) -> dict[str, Float[np.ndarray, " 2"]]:
    """Slopes of nu, log G and log E with respect to (nu, log G).

    Parameters
    ----------
    poisson_ratio : float [-]       > -1

    Returns
    -------
    constant's name -> (2,) float   in the order of `DIRECTIONS`
    """
    young = np.array([1.0 / (1.0 + poisson_ratio), 1.0])
    return dict(zip(DIRECTIONS, (np.array([1.0, 0.0]), np.array([0.0, 1.0]), young), strict=True))


def quantile_of(noise: ScoreNoise, scatter: Scatter) -> float:
    """Half-width of a 95 % interval in standard deviations.

    Parameters
    ----------
    noise : ScoreNoise
    scatter : Scatter               of the constant concerned

    Returns
    -------
    float [-]                       1.96 where all noise is claimed, else Student's for the fewest
                                    degrees of freedom among noise, correlation and scatter
    """
    degrees = min(noise.degrees, noise.correlation.degrees)
    if scatter.is_surprising:
        degrees = min(degrees, scatter.degrees + _PRIOR_DEGREES)
    return float(ndtri(_UPPER_TAIL) if np.isinf(degrees) else stdtrit(degrees, _UPPER_TAIL))


def scores_of(
    misfit: Misfit, local: Sequence[LocalProbe], *, noise: ScoreNoise | None = None
) -> tuple[Scores, ScoreNoise]:
    """Scores of all probings at a minimum, and their noise.

    Parameters
    ----------
    misfit : Misfit
    local : sequence of LocalProbe      at the minimum
    noise : ScoreNoise or None          known from a joint fit, or to be measured here

    Returns
    -------
    (Scores, ScoreNoise)
    """
    # Moments of a force's score by its uncertain components, for forces as uncertain as claimed.
    moments = {count: gaussian_moments(misfit.noise, max(count, 1)) for count in range(4)}
    forces = [moments[probe.rows.force_components] for probe in local]
    if noise is None:
        noise = _noise_of(misfit, local)
        turns = [
            _projection(probe, noise.slope, slope)
            for probe, (_, slope) in zip(local, forces, strict=True)
        ]
        noise = replace(
            noise, correlation=correlation_factor(local, turns, score_variance=noise.power)
        )
    parts = [_scores(probe, noise, *force) for probe, force in zip(local, forces, strict=True)]
    return Scores(*(np.stack(column) for column in zip(*parts, strict=True))), noise


def cramer_rao_bound(
    probes: Sequence[ProbeObservations], *, poisson_ratio: float, shear_modulus: float
) -> dict[str, float]:
    """Cramer-Rao bound: the smallest standard deviations that any unbiased estimate can have.

    For Gaussian noise of the claimed size. Uncertain forces are nuisance parameters, known to their
    claimed uncertainty.

    Parameters
    ----------
    probes : sequence of ProbeObservations  all with standard deviations
    poisson_ratio : float [-]
    shear_modulus : float [Pa]              > 0

    Returns
    -------
    constant's name -> float                nu [-], G and E [Pa]; infinite where not identifiable

    Raises
    ------
    InputError                              a probing has no standard deviations
    """
    for probe in probes:
        if probe.std is None:
            raise InputError(
                f"probing {probe.name!r} has no std; the bound needs the noise of every point"
            )
    rows = tuple(observed_rows_of(probe) for probe in probes)
    misfit = Misfit(rows, np.ones(GROUP_COUNT), Gaussian())
    shifts = [np.zeros(3 + len(probe.motion)) for probe in rows]
    information = np.zeros((2, 2))
    for local in misfit.linearised(misfit.scaled(poisson_ratio), 0.0, shear_modulus, shifts):
        turn = _projection(local, 1.0, 1.0)
        information += local.design[:, :2].T @ local.design @ turn
    covariance = np.linalg.pinv(information, hermitian=True)
    young = 2 * shear_modulus * (1 + poisson_ratio)
    bound = {}
    for (name, turn), value in zip(
        directions(poisson_ratio).items(), (1.0, shear_modulus, young), strict=True
    ):
        identifiable = np.allclose(information @ covariance @ turn, turn, atol=1e-6)
        spread = float(np.sqrt(turn @ covariance @ turn)) if identifiable else np.inf
        bound[name] = value * spread
    return bound


def _scores(
    probe: LocalProbe, noise: ScoreNoise, force_power: float, force_slope: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Score, information, covariance of the score and curvature of one probing."""
    gram = probe.design.T @ probe.design
    turn = _projection(probe, noise.slope, force_slope)
    prior_slope, prior_power = probe.rows.prior(force_slope), probe.rows.prior(force_power)
    projected = turn.T @ gram @ turn
    information = noise.slope * projected + (turn[2:].T * prior_slope) @ turn[2:]
    spread = noise.power * noise.correlation.variance * projected
    spread += (turn[2:].T * prior_power) @ turn[2:]
    weighted = probe.weighted_products()
    weighted[2:-1, 2:-1] += np.diag(probe.prior)
    solved = np.linalg.solve(weighted[2:-1, 2:-1], weighted[2:-1, :2])
    curvature = weighted[:2, :2] - weighted[:2, 2:-1] @ solved
    return weighted[:2, -1], information, spread, curvature


def _projection(probe: LocalProbe, slope: float, force_slope: float) -> np.ndarray:
    """(2 + n, 2) matrix that takes the n shifts out of the design of the constants."""
    gram = slope * (probe.design.T @ probe.design)
    force = gram[2:, 2:] + np.diag(probe.rows.prior(force_slope))
    return np.vstack([np.eye(2), -np.linalg.solve(force, gram[2:, :2])])


def _noise_of(misfit: Misfit, local: Sequence[LocalProbe]) -> ScoreNoise:
    """Moments of the robust score, as the residuals show them and never below a claim."""
    squared = np.concatenate([probe.squared for probe in local])
    components = np.concatenate([probe.rows.components for probe in local])
    power, slope = score_moments(misfit.noise, squared, components)
    rows, lost = float(components.sum()), 2 + _absorbed(local)
    spare = rows - lost
    power *= rows / max(spare, 1.0)
    # No spare rows: the noise cannot be estimated, and the quantile becomes very large.
    degrees = max(spare, 0.5)
    independent = CorrelationFactor(1.0, np.inf, 1.0)
    if not all(probe.rows.has_claims for probe in local):
        return ScoreNoise(power, slope, degrees, independent)
    count = round(float(components.mean()))
    claimed_power, claimed_slope = gaussian_moments(misfit.noise, count)
    excess = power > claimed_power * (1 + 2 * np.sqrt(2 / max(spare, 1.0)))
    raised = excess or bool((misfit.level > 1).any())
    return ScoreNoise(
        max(power, claimed_power) if raised else claimed_power,
        min(slope, claimed_slope),
        degrees if raised else np.inf,
        independent,
    )


def _absorbed(local: Sequence[LocalProbe]) -> float:
    """Degrees of freedom of the displacements that the free forces and motions take up."""
    total = 0.0
    for probe in local:
        gram = probe.design[:, 2:].T @ probe.design[:, 2:]
        total += float(np.trace(np.linalg.solve(gram + np.diag(probe.prior), gram)))
    return total


def _inverse(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse with a ridge far below any information that counts, and the ridge."""
    scale = diagonal_root(matrix)
    unit = matrix / np.outer(scale, scale) + _RIDGE * np.eye(2)
    return np.linalg.inv(unit) / np.outer(scale, scale), _RIDGE * np.diag(scale**2)
