"""Covariance of (nu, log G): information, noise of the scores, shared errors, and disagreement.

First a model-based covariance: Fisher information of the robust loss, with the noise level of the
residuals (never below the claim), their spatial correlation, and the priors of shared errors. Then
the disagreement of the probings enters as a random effect. The variance of what is independent
between them is the mean of the claim, counted as one observation of it, and of their scatter,
weighted by its degrees of freedom; the quantile is that of Student's t for both together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.estimation.intervals.scatter import Scatter, Variance
from palpate.estimation.intervals.score_noise import (
    ScoreNoise,
    common_noise,
    considered_score_changes,
    noise_of,
)
from palpate.estimation.intervals.spatial_correlation import block_scatter
from palpate.estimation.noise import gaussian_moments
from palpate.estimation.nuisance import NuisanceParameter
from palpate.estimation.search import LocalProbe, Misfit, diagonal_root

DIRECTIONS = ("poisson_ratio", "shear_modulus", "young_modulus")
FORCES, MOTIONS = "measured forces", "motions of supports"
_RIDGE = 1e-11
# Source of an uncertain quantity, and the change of the scores, (d,), per standard deviation of it.
ScoreChange = tuple[str, np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Score and information of every probing in (nu, log G) and m shared errors, true forces
    eliminated; d = 2 + m.

    Parameters
    ----------
    score : (k, d)
    information : (k, d, d)     expected slope of the score
    noise : (k, d, d)           model-based covariance of the part of the score that is independent
                                between probings
    curvature : (k, 2, 2)       second derivative of half the misfit at fixed weights and errors
    common_covariance : (k, k, d, d)    covariance between the scores of all pairs of probings, from
                                noise that they share and from considered errors
    own_changes, considered_changes : tuple of ScoreChange    one for each shift of each probing,
                                and one for each considered error
    shared : tuple of NuisanceParameter     the m shared errors
    """

    score: Float[np.ndarray, "k d"]
    information: Float[np.ndarray, "k d d"]
    noise: Float[np.ndarray, "k d d"]
    curvature: Float[np.ndarray, "k 2 2"]
    common_covariance: Float[np.ndarray, "k k d d"]
    own_changes: tuple[ScoreChange, ...] = ()
    considered_changes: tuple[ScoreChange, ...] = ()
    shared: tuple[NuisanceParameter, ...] = ()

    @property
    def _shared(self) -> Float[np.ndarray, "d d"]:
        """Covariance of the sum of the scores from shared errors and common noise."""
        return np.asarray(self._prior + self.common_covariance.sum(axis=(0, 1)))

    @property
    def _prior(self) -> Float[np.ndarray, "d d"]:
        """Prior information on the shared errors, which is also the covariance of its score."""
        return np.diag(np.append(np.zeros(2), np.ones(self.score.shape[1] - 2)))

    def subset(self, probings: Sequence[int]) -> "Scores":
        """Scores of some of the probings, by their indices."""
        chosen = list(probings)
        return Scores(
            self.score[chosen],
            self.information[chosen],
            self.noise[chosen],
            self.curvature[chosen],
            self.common_covariance[np.ix_(chosen, chosen)],
        )

    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Model-based covariance, (d, d): A^-1 B A^-1 with A the information and B the noise; very
        large but finite along a combination without information.

        Source
        ------
        Huber, The behavior of maximum likelihood estimates under nonstandard conditions, 5th
        Berkeley Symposium (1967).
        """
        inverse, ridge = self._inverse()
        return inverse @ (self.noise.sum(0) + self._shared + ridge) @ inverse

    def curvature_variance(self, direction: Float[np.ndarray, " 2"]) -> float:
        """Variance of a combination that follows from the curvature of the misfit alone.

        Parameters
        ----------
        direction : (2,) float      see `directions`

        Returns
        -------
        float [-]                   of that combination of (nu, log G)
        """
        return float(direction @ _inverse(self.curvature.sum(0))[0] @ direction)

    def influence(self, direction: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " d"]:
        """Change of a combination of the constants per unit of each score; from the third entry on
        also per prior standard deviation of each shared error.

        Parameters
        ----------
        direction : (2,) float      see `directions`

        Returns
        -------
        (d,) float
        """
        return np.asarray(self._inverse()[0][:, :2] @ direction)

    def step(self) -> Float[np.ndarray, " d"]:
        """Step, (d,), from the minimum to that without bounds on Poisson's ratio."""
        # At a minimum all scores vanish, except that of a Poisson's ratio at the end of its range.
        gradient = np.append(self.score.sum(0)[:2], np.zeros(self.score.shape[1] - 2))
        return np.asarray(
            np.linalg.lstsq(self.information.sum(0) + self._prior, gradient, rcond=1e-11)[0]
        )

    def variance(self, direction: Float[np.ndarray, " 2"], scatter: Scatter) -> Variance:
        """Variance of one combination of (nu, log G).

        Parameters
        ----------
        direction : (2,) float      see `directions`
        scatter : Scatter           of the probings of the session in that combination

        Returns
        -------
        Variance
        """
        _, ridge = self._inverse()
        influence = self.influence(direction)
        claimed = float(influence @ (self.noise.sum(0) + ridge) @ influence)
        shared = float(influence @ self._shared @ influence)
        return Variance(scatter.factor * claimed, shared, scatter.total_degrees)

    def scatter(self, direction: Float[np.ndarray, " 2"]) -> Scatter:
        """Disagreement of the probings about one combination of (nu, log G).

        The covariance of their contributions to it, each less its expected share of the sum, gives
        the mean and the degrees of freedom of their sum of squares (Satterthwaite).

        Parameters
        ----------
        direction : (2,) float      see `directions`

        Returns
        -------
        Scatter                     of ratio 1 without degrees of freedom for a single probing
        """
        inverse, _ = self._inverse()
        influence = self.influence(direction)
        share = np.einsum("i,kij,jl->kl", influence, self.information, inverse)
        common = self.common_covariance @ influence
        crossed = np.einsum("ki,lij,j->kl", share, self.noise, influence)
        crossed += share @ common.sum(axis=0).T
        own = np.diag(np.einsum("i,kij,j->k", influence, self.noise, influence))
        own += common @ influence
        total = share @ (self.noise.sum(0) + self._shared) @ share.T
        expected = own - crossed - crossed.T + total
        mean = float(np.trace(expected))
        if len(self.score) < 2 or mean <= 0.0:
            return Scatter(1.0, 0.0)
        contribution = (self.score - self.information @ self.step()) @ influence
        ratio = float((contribution**2).sum()) / mean
        return Scatter(ratio, mean**2 / float((expected**2).sum()))

    def _inverse(self) -> tuple[np.ndarray, np.ndarray]:
        return _inverse(self.information.sum(0) + self._prior)


def directions(poisson_ratio: float) -> dict[str, Float[np.ndarray, " 2"]]:
    """Gradients of nu, log G and log E with respect to (nu, log G).

    Parameters
    ----------
    poisson_ratio : float [-]       > -1

    Returns
    -------
    constant's name -> (2,) float   in the order of `DIRECTIONS`
    """
    young = np.array([1.0 / (1.0 + poisson_ratio), 1.0])
    return dict(zip(DIRECTIONS, (np.array([1.0, 0.0]), np.array([0.0, 1.0]), young), strict=True))


def scores_of(
    misfit: Misfit, local: Sequence[LocalProbe], *, noise: ScoreNoise | None = None
) -> tuple[Scores, ScoreNoise]:
    """Scores of all probings at a minimum, and their noise.

    Parameters
    ----------
    misfit : Misfit
    local : sequence of LocalProbe      at the minimum
    noise : ScoreNoise or None          from a joint fit; None: estimated from these probings

    Returns
    -------
    (Scores, ScoreNoise)
    """
    # Of each probing's force, for Gaussian errors of the claimed size.
    moments = {count: gaussian_moments(misfit.noise, max(count, 1)) for count in range(4)}
    forces = [moments[probe.rows.force_components] for probe in local]
    is_estimated = noise is None
    if noise is None:
        noise = noise_of(misfit, local)
    projections = [
        _projection(probe, noise.slope, slope)
        for probe, (_, slope) in zip(local, forces, strict=True)
    ]
    if is_estimated:
        constants = [projection[:, :2] for projection in projections]
        blocks = block_scatter(local, constants, score_variance=noise.power, sharing=noise.sharing)
        noise = replace(noise, blocks=blocks)
    parts = [
        _scores(probe, projection, noise, *force)
        for probe, projection, force in zip(local, projections, forces, strict=True)
    ]
    score, information, own_noise, curvature = map(np.stack, zip(*parts, strict=True))
    common = common_noise(local, projections, noise)
    own_noise -= np.einsum("kkij->kij", common)
    considered = considered_score_changes(local, projections, noise)
    for changes in considered.values():
        common = common + np.einsum("ki,mj->kmij", changes, changes)
    own_changes: list[ScoreChange] = []
    for probe, projection, (power, _) in zip(local, projections, forces, strict=True):
        changes = np.sqrt(probe.prior(power))[:, None] * projection[probe.common :]
        own_changes += zip(_sources(misfit, probe), changes, strict=True)
    considered_changes = ((error.source, change.sum(0)) for error, change in considered.items())
    scores = Scores(
        score,
        information,
        own_noise,
        curvature,
        common,
        tuple(own_changes),
        tuple(considered_changes),
        misfit.shared,
    )
    return scores, noise


def _sources(misfit: Misfit, probe: LocalProbe) -> list[str]:
    """Source in the budget of each shift of a probing."""
    motions = [MOTIONS] * (probe.rows.load_shifts - 3)
    return [FORCES] * 3 + motions + [error.source for error in misfit.own(probe.rows)]


def _scores(
    probe: LocalProbe,
    projection: np.ndarray,
    noise: ScoreNoise,
    force_power: float,
    force_slope: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Score, information, covariance of the score and curvature of one probing."""
    d = probe.common
    projected = probe.design @ projection
    shifts = projection[d:]
    information = noise.slope * (projected.T @ projected)
    information += (shifts.T * probe.prior(force_slope)) @ shifts
    correlated = probe.rows.correlated(projected, noise.sharing)
    covariance = noise.power * noise.excess * (projected.T @ correlated)
    covariance += (shifts.T * probe.prior(force_power)) @ shifts
    weighted = probe.weighted_products()
    # Only force and motions are eliminated: in the misfit's profile all errors are held fixed.
    own = slice(d, d + probe.rows.load_shifts)
    inner = weighted[own, own] + np.diag(probe.prior()[: own.stop - d])
    curvature = weighted[:2, :2] - weighted[:2, own] @ np.linalg.solve(inner, weighted[own, :2])
    return weighted[:d, -1], information, covariance, curvature


def _projection(probe: LocalProbe, slope: float, force_slope: float) -> np.ndarray:
    """(d + n, d) matrix that projects the n shifts out of the design of the d common parameters."""
    d = probe.common
    gram = slope * (probe.design.T @ probe.design)
    own = gram[d:, d:] + np.diag(probe.prior(force_slope))
    return np.vstack([np.eye(d), -np.linalg.solve(own, gram[d:, :d])])


def _inverse(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse with a ridge far below any relevant information, and the ridge."""
    scale = diagonal_root(matrix)
    unit = matrix / np.outer(scale, scale) + _RIDGE * np.eye(len(matrix))
    return np.linalg.inv(unit) / np.outer(scale, scale), _RIDGE * np.diag(scale**2)
