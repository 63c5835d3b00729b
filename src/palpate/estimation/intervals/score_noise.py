"""Noise of the robust scores: its size, its correlation between points and between probings, and
the contribution of considered errors."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.intervals.scatter import NO_SCATTER, Scatter
from palpate.estimation.intervals.spatial_correlation import neighbours_sharing
from palpate.estimation.noise import gaussian_moments, score_moments
from palpate.estimation.nuisance import NuisanceParameter
from palpate.estimation.search import LocalProbe, Misfit

# Share of a match's variance that is due to the reference picture, and common to all later ones.
_REFERENCE_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class ScoreNoise:
    """Noise of the robust scores, pooled over the probings of a session.

    Parameters
    ----------
    power, slope : float        mean square and mean slope of the score per component
    degrees : float             degrees of freedom of the noise, infinite where it was claimed
    sharing : float             factor on the nominal correlation of neighbours, 0 to 1
    blocks : Scatter            of blocks of points, relative to what all of the above explains
    """

    power: float
    slope: float
    degrees: float
    sharing: float
    blocks: Scatter

    @property
    def excess(self) -> float:
        """Factor on the variance for further correlation of neighbouring points, at least 1."""
        return max(1.0, self.blocks.factor)


def noise_of(misfit: Misfit, local: Sequence[LocalProbe]) -> ScoreNoise:
    """Moments of the robust score from the residuals, never more optimistic than a claim.

    Parameters
    ----------
    misfit : Misfit
    local : sequence of LocalProbe      at a minimum

    Returns
    -------
    ScoreNoise                          without scatter of blocks
    """
    squared = np.concatenate([probe.squared for probe in local])
    components = np.concatenate([probe.rows.components for probe in local])
    power, slope = score_moments(misfit.noise, squared, components)
    rows, lost = float(components.sum()), 2 + _absorbed(local)
    spare = rows - lost
    power *= rows / max(spare, 1.0)
    # No spare rows: the noise cannot be estimated, and the quantile becomes very large.
    degrees = max(spare, 0.5)
    sharing = neighbours_sharing(local, power)
    if not all(probe.rows.has_claims for probe in local):
        return ScoreNoise(power, slope, degrees, sharing, NO_SCATTER)
    count = round(float(components.mean()))
    claimed_power, claimed_slope = gaussian_moments(misfit.noise, count)
    excess = power > claimed_power * (1 + 2 * np.sqrt(2 / max(spare, 1.0)))
    raised = excess or bool((misfit.level > 1).any())
    return ScoreNoise(
        max(power, claimed_power) if raised else claimed_power,
        min(slope, claimed_slope),
        degrees if raised else np.inf,
        sharing,
        NO_SCATTER,
    )


def _absorbed(local: Sequence[LocalProbe]) -> float:
    """Effective degrees of freedom that the shifts of single probings absorb."""
    total = 0.0
    for probe in local:
        own = probe.design[:, probe.common :]
        gram = own.T @ own
        total += float(np.trace(np.linalg.solve(gram + np.diag(probe.prior()), gram)))
    return total


def common_noise(
    local: Sequence[LocalProbe], projections: Sequence[np.ndarray], noise: ScoreNoise
) -> Float[np.ndarray, "k k d d"]:
    """Covariance between the scores of all pairs of probings from the noise of reference pictures
    that they share: half of the noise of each point that several probings have.

    Parameters
    ----------
    local : sequence of k LocalProbe    at a minimum
    projections : (d + n, d) for each   projects the n shifts out of the design of the d common
                                        parameters
    noise : ScoreNoise

    Returns
    -------
    (k, k, d, d) float                  zero for probings that share nothing
    """
    names = [_reference_points(probe) for probe in local]
    counts = Counter(name for own in names for name in own)
    number = {name: k for k, name in enumerate(name for name in counts if counts[name] > 1)}
    count, d = len(local), local[0].common
    covariance = np.zeros((count, count, d, d))
    if not number:
        return covariance
    plain, mixed = np.zeros((2, count, 3 * len(number), d))
    for k, (probe, projection) in enumerate(zip(local, projections, strict=True)):
        rows = probe.design @ projection
        neighbours = probe.rows.correlated(rows, noise.sharing)
        for name, start in names[k].items():
            if name in number:
                at = slice(3 * number[name], 3 * number[name] + 3)
                plain[k, at], mixed[k, at] = rows[start : start + 3], neighbours[start : start + 3]
    for k in range(count):
        for m in range(count):
            covariance[k, m] = 0.5 * (mixed[k].T @ plain[m] + plain[k].T @ mixed[m])
    return _REFERENCE_SHARE * noise.power * noise.excess * covariance


def considered_score_changes(
    local: Sequence[LocalProbe], projections: Sequence[np.ndarray], noise: ScoreNoise
) -> dict[NuisanceParameter, Float[np.ndarray, "k d"]]:
    """Change of each probing's score per prior standard deviation of each considered error: these
    are not fitted, so that they contribute with their whole prior variance.

    Parameters
    ----------
    local, projections, noise           as `common_noise`

    Returns
    -------
    parameter -> (k, d) float           zero for probings that do not have it

    Source
    ------
    Schmidt, Application of state-space methods to navigation problems, Advances in Control Systems
    3 (1966): consider parameters
    """
    by_parameter: dict[NuisanceParameter, np.ndarray] = {}
    for k, (probe, projection) in enumerate(zip(local, projections, strict=True)):
        changes = noise.slope * (probe.considered.T @ probe.design @ projection)
        errors = probe.rows.observations.considered
        own = (parameter for nuisance in errors for parameter in nuisance.parameters)
        for parameter, change in zip(own, changes, strict=True):
            by_parameter.setdefault(parameter, np.zeros((len(local), probe.common)))[k] = change
    return by_parameter


def _reference_points(probe: LocalProbe) -> dict[tuple[str, bytes], int]:
    """First row of each point with all components and a reference, by reference and position."""
    rows, reference = probe.rows, probe.rows.observations.reference
    if reference is None:
        return {}
    return {
        (reference, place.tobytes()): int(start)
        for place, start, count in zip(rows.position, rows.start, rows.components, strict=True)
        if count == 3 and np.isfinite(place[0])
    }
