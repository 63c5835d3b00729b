"""Covariance of (nu, log G): information, noise of the scores, shared errors, and disagreement.

Model-based first: Fisher information of the robust loss, with the noise as the residuals show it
(never below the claim), the spatial correlation of residuals, and the priors of the errors that
points share. Then the probings are asked: what they disagree by is a random effect of its own. The
variance of what is independent between them is the claim, taken as one observation of it, and their
scatter as the others; the quantile is Student's for both together.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, stdtrit

from palpate.estimation.intervals.spatial_correlation import CorrelationFactor, correlation_factor
from palpate.estimation.noise import gaussian_moments, score_moments
from palpate.estimation.search import LocalProbe, Misfit, diagonal_root

DIRECTIONS = ("poisson_ratio", "shear_modulus", "young_modulus")
_RIDGE = 1e-11
# Degrees of freedom that a claimed uncertainty is worth beside the scatter of the probings: the
# fewest with which intervals hold where the claim is half of the truth (93 % of two to five
# probings, by simulation; 2 give 91 %, 3 give 88 %).
_CLAIM_DEGREES = 1.0
# Share of the variance of a match that is the first picture's noise, the same for every later one.
_REFERENCE_SHARE = 0.5
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


@dataclass(frozen=True, slots=True)
class Variance:
    """Variance of a combination of the constants.

    Parameters
    ----------
    independent : float         of what differs from probing to probing
    shared : float              of what all probings have in common
    degrees : float             degrees of freedom of `independent`
    """

    independent: float
    shared: float
    degrees: float

    @property
    def total(self) -> float:
        """Both together."""
        return self.independent + self.shared

    @property
    def quantile(self) -> float:
        """Half-width of a 95 % interval in standard deviations: Student's, 1.96 where the variance
        is known.

        Source
        ------
        Satterthwaite, An approximate distribution of estimates of variance components, Biometrics
        Bulletin 2 (1946).
        """
        known = self.degrees == np.inf or self.independent == 0.0
        if known:
            return float(ndtri(_UPPER_TAIL))
        degrees = self.degrees * (self.total / self.independent) ** 2
        return float(stdtrit(degrees, _UPPER_TAIL))


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Score and information of every probing in (nu, log G) and m shared errors, true forces
    eliminated; d = 2 + m.

    Parameters
    ----------
    score : (k, d)
    information : (k, d, d)     expected slope of the score
    noise : (k, d, d)           model-based covariance of the score, of what differs from probing to
                                probing
    curvature : (k, 2, 2)       second derivative of half the misfit at fixed weights and errors
    common : (k, r, d) or None  what each of r independent noises of variance 1 that probings share
                                adds to the score
    """

    score: Float[np.ndarray, "k d"]
    information: Float[np.ndarray, "k d d"]
    noise: Float[np.ndarray, "k d d"]
    curvature: Float[np.ndarray, "k 2 2"]
    common: Float[np.ndarray, "k r d"] | None = None

    @property
    def _common(self) -> Float[np.ndarray, "k r d"]:
        count, d = self.score.shape
        return np.zeros((count, 0, d)) if self.common is None else self.common

    @property
    def _shared(self) -> Float[np.ndarray, "d d"]:
        """Covariance of the sum of the scores from what probings share."""
        every = self._common.sum(axis=0)
        return self._prior + every.T @ every

    @property
    def _prior(self) -> Float[np.ndarray, "d d"]:
        """Information, and covariance of the score, of what was known before."""
        return np.diag(np.append(np.zeros(2), np.ones(self.score.shape[1] - 2)))

    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Model-based covariance, A^-1 B A^-1 with A the information and B the noise; huge, not
        infinite, along a combination without information.

        Source
        ------
        Huber, The behavior of maximum likelihood estimates under nonstandard conditions, 5th
        Berkeley Symposium (1967).
        """
        inverse, ridge = self._inverse()
        return inverse @ (self.noise.sum(0) + self._shared + ridge) @ inverse

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

    def step(self) -> Float[np.ndarray, " d"]:
        """Where the misfit's unbounded minimum lies, from the present one."""
        # At a minimum all but the score of a Poisson's ratio at the end of its range vanish.
        gradient = np.append(self.score.sum(0)[:2], np.zeros(self.score.shape[1] - 2))
        return np.asarray(
            np.linalg.lstsq(self.information.sum(0) + self._prior, gradient, rcond=1e-11)[0]
        )

    def variance(self, direction: Float[np.ndarray, " 2"], scatter: "Scatter") -> Variance:
        """Variance of one combination of (nu, log G).

        Parameters
        ----------
        direction : (2,) float      see `directions`
        scatter : Scatter           of the probings of the session in that combination

        Returns
        -------
        Variance
        """
        inverse, ridge = self._inverse()
        influence = inverse[:, :2] @ direction
        claimed = float(influence @ (self.noise.sum(0) + ridge) @ influence)
        shared = float(influence @ self._shared @ influence)
        return Variance(scatter.factor * claimed, shared, scatter.total_degrees)

    def scatter(self, direction: Float[np.ndarray, " 2"]) -> "Scatter":
        """Disagreement of the probings about one combination of (nu, log G).

        The covariance of their pulls on it, each less its expected share of the sum, gives the mean
        and the degrees of freedom of their sum of squares.

        Parameters
        ----------
        direction : (2,) float      see `directions`

        Returns
        -------
        Scatter                     of ratio 1 without degrees of freedom for a single probing
        """
        inverse, _ = self._inverse()
        influence = inverse[:, :2] @ direction
        share = np.einsum("i,kij,jl->kl", influence, self.information, inverse)
        together = self._common @ influence
        crossed = np.einsum("ki,lij,j->kl", share, self.noise, influence)
        crossed += share @ self._common.sum(axis=0).T @ together.T
        own = np.diag(np.einsum("i,kij,j->k", influence, self.noise, influence))
        own += together @ together.T
        total = share @ (self.noise.sum(0) + self._shared) @ share.T
        expected = own - crossed - crossed.T + total
        mean = float(np.trace(expected))
        if len(self.score) < 2 or mean <= 0.0:
            return Scatter(1.0, 0.0)
        pull = (self.score - self.information @ self.step()) @ influence
        ratio = float((pull**2).sum()) / mean
        return Scatter(ratio, mean**2 / float((expected**2).sum()))

    def _inverse(self) -> tuple[np.ndarray, np.ndarray]:
        return _inverse(self.information.sum(0) + self._prior)


@dataclass(frozen=True, slots=True)
class Scatter:
    """Scatter of the probings over what their claimed uncertainties explain.

    Parameters
    ----------
    ratio : float [-]           of variances, >= 0
    degrees : float             degrees of freedom: one less than probings, where all say as much
    """

    ratio: float
    degrees: float

    @property
    def factor(self) -> float:
        """Factor on the claimed variance: the mean of the claim and of the scatter, each by its
        degrees of freedom."""
        return (_CLAIM_DEGREES + self.degrees * self.ratio) / (_CLAIM_DEGREES + self.degrees)

    @property
    def total_degrees(self) -> float:
        """Degrees of freedom of that mean; infinite where only the claim speaks."""
        return _CLAIM_DEGREES + self.degrees if self.degrees > 0.0 else np.inf


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
    to_be_measured = noise is None
    if noise is None:
        noise = _noise_of(misfit, local)
    turns = [
        projection(probe, noise.slope, slope)
        for probe, (_, slope) in zip(local, forces, strict=True)
    ]
    if to_be_measured:
        constants = [turn[:, :2] for turn in turns]
        correlation = correlation_factor(local, constants, score_variance=noise.power)
        noise = replace(noise, correlation=correlation)
    parts = [
        _scores(probe, turn, noise, *force)
        for probe, turn, force in zip(local, turns, forces, strict=True)
    ]
    scores = Scores(*(np.stack(column) for column in zip(*parts, strict=True)))
    common = _common_noise(local, turns, noise)
    own = scores.noise - common.swapaxes(1, 2) @ common
    return replace(scores, noise=own, common=common), noise


def _common_noise(
    local: Sequence[LocalProbe], turns: Sequence[np.ndarray], noise: ScoreNoise
) -> Float[np.ndarray, "k r d"]:
    """What the noise of pictures at rest that several probings were measured from adds to their
    scores: three noises for each point that more than one of them has."""
    points = [_reference_points(probe) for probe in local]
    seen = Counter(name for names in points for name in names)
    number = {name: k for k, name in enumerate(name for name in seen if seen[name] > 1)}
    common = np.zeros((len(local), 3 * len(number), local[0].common))
    size = np.sqrt(_REFERENCE_SHARE * noise.power * noise.correlation.variance)
    for probe, turn, names, found in zip(local, turns, points, common, strict=True):
        rows = probe.design @ turn
        for name, start in names.items():
            if name in number:
                at = 3 * number[name]
                found[at : at + 3] = size * rows[start : start + 3]
    return common


def _reference_points(probe: LocalProbe) -> dict[tuple[str, bytes], int]:
    """First row of each point measured whole from pictures at rest, by these and by its place."""
    rows = probe.rows
    if rows.reference is None:
        return {}
    return {
        (rows.reference, place.tobytes()): int(start)
        for place, start, count in zip(rows.position, rows.start, rows.components, strict=True)
        if count == 3 and np.isfinite(place[0])
    }


def _scores(
    probe: LocalProbe,
    turn: np.ndarray,
    noise: ScoreNoise,
    force_power: float,
    force_slope: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Score, information, covariance of the score and curvature of one probing."""
    d = probe.common
    gram = probe.design.T @ probe.design
    projected = turn.T @ gram @ turn
    information = noise.slope * projected + (turn[d:].T * probe.prior(force_slope)) @ turn[d:]
    spread = noise.power * noise.correlation.variance * projected
    spread += (turn[d:].T * probe.prior(force_power)) @ turn[d:]
    weighted = probe.weighted_products()
    # Errors stay where they are, those of this probing alone, too: as in the misfit's profile.
    own = slice(d, d + 3 + len(probe.rows.motion))
    inner = weighted[own, own] + np.diag(probe.prior()[: own.stop - d])
    curvature = weighted[:2, :2] - weighted[:2, own] @ np.linalg.solve(inner, weighted[own, :2])
    return weighted[:d, -1], information, spread, curvature


def projection(probe: LocalProbe, slope: float, force_slope: float) -> np.ndarray:
    """(d + n, d) matrix that takes the n shifts out of the design of the d common parameters."""
    d = probe.common
    gram = slope * (probe.design.T @ probe.design)
    own = gram[d:, d:] + np.diag(probe.prior(force_slope))
    return np.vstack([np.eye(d), -np.linalg.solve(own, gram[d:, :d])])


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
    """Degrees of freedom of the displacements that the shifts of single probings take up."""
    total = 0.0
    for probe in local:
        own = probe.design[:, probe.common :]
        gram = own.T @ own
        total += float(np.trace(np.linalg.solve(gram + np.diag(probe.prior()), gram)))
    return total


def _inverse(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse with a ridge far below any information that counts, and the ridge."""
    scale = diagonal_root(matrix)
    unit = matrix / np.outer(scale, scale) + _RIDGE * np.eye(len(matrix))
    return np.linalg.inv(unit) / np.outer(scale, scale), _RIDGE * np.diag(scale**2)
