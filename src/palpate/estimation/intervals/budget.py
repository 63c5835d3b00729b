"""Uncertainty budget: the variance of the constants, source by source.

To first order the estimate is linear in every uncertain quantity: the noise of the points, the
shifts of each probing (its force, motions of supports, its own errors), the shared errors and the
considered ones. All of these are independent, so their contributions to the variance add up.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from palpate.estimation.intervals.sandwich import (
    Scores,
    directions,
    force_moments,
    shift_projections,
)
from palpate.estimation.intervals.score_noise import ScoreNoise, considered_score_changes
from palpate.estimation.search import LocalProbe, Misfit
from palpate.records import CONSTANT_NAMES, BudgetEntry

POINTS, FORCES, MOTIONS = "noise of the points", "measured forces", "motions of supports"
SCATTER = "disagreement of the probings"
# Source of a quantity, and the change of the scores, (d,), per standard deviation of it.
_ScoreChanges = list[tuple[str, np.ndarray]]


def uncertainty_budget(
    misfit: Misfit,
    local: Sequence[LocalProbe],
    scores: Scores,
    noise: ScoreNoise,
    *,
    poisson_ratio: float,
    factors: Mapping[str, float],
) -> tuple[BudgetEntry, ...]:
    """Contribution of each source to the standard deviations of nu, log G and log E.

    Parameters
    ----------
    misfit : Misfit
    local : sequence of LocalProbe      of its probings, at a minimum
    scores : Scores                     of these, with their noise
    noise : ScoreNoise
    poisson_ratio : float [-]           at the minimum
    factors : mapping                   constant's name -> factor on the claimed variance from the
                                        disagreement of the probings (`Scatter.factor`); only
                                        constants that are identifiable

    Returns
    -------
    tuple of BudgetEntry            sorted by the contribution to Young's modulus, largest first;
                                    their root sum of squares is the standard deviation of each
                                    constant (`Scores.variance`); empty where Poisson's ratio is not
                                    identifiable: moduli are then given for all of its range

    Source
    ------
    JCGM 100, Guide to the expression of uncertainty in measurement (2008), 5.1
    """
    if "poisson_ratio" not in factors:
        return ()
    direction_of = directions(poisson_ratio)
    own, considered = _of_probings(misfit, local, noise)
    parts = {
        name: _variances(misfit, scores, own, considered, direction_of[name], factor)
        for name, factor in factors.items()
    }
    sources = dict.fromkeys(source for part in parts.values() for source in part)
    entries = [
        BudgetEntry(
            source,
            *(
                float(np.sqrt(parts[name].get(source, 0.0))) if name in parts else np.nan
                for name in CONSTANT_NAMES
            ),
        )
        for source in sources
    ]
    return tuple(sorted(entries, key=_size, reverse=True))


def _size(entry: BudgetEntry) -> float:
    """Contribution to the first identifiable constant, in the order E, G, nu."""
    values = (entry.young_modulus, entry.shear_modulus, entry.poisson_ratio)
    return next(value for value in values if not np.isnan(value))


def _variances(
    misfit: Misfit,
    scores: Scores,
    own: _ScoreChanges,
    considered: _ScoreChanges,
    direction: np.ndarray,
    factor: float,
) -> dict[str, float]:
    """Contribution of each source to the variance of nu, log G or log E."""
    influence = scores.influence(direction)
    independent = _variance_by_source(own, influence)
    variance = _variance_by_source(considered, influence)
    # Common noise that is not from considered errors is from shared reference pictures.
    common = 0.0
    if scores.common_covariance is not None:
        common = float(influence @ scores.common_covariance.sum((0, 1)) @ influence)
    reference_pictures = common - sum(variance.values())
    for parameter, effect in zip(misfit.shared, influence[2:], strict=True):
        variance[parameter.source] += float(effect**2)
    claimed = float(direction @ scores.covariance()[:2, :2] @ direction)
    claimed -= reference_pictures + sum(variance.values())
    independent[POINTS] += claimed - sum(independent.values())
    # Where probings agree better than claimed, all independent contributions shrink.
    for source, value in independent.items():
        variance[source] += min(factor, 1.0) * value
    variance[POINTS] += reference_pictures
    if factor > 1.0:
        variance[SCATTER] = (factor - 1.0) * claimed
    return {source: max(value, 0.0) for source, value in variance.items()}


def _variance_by_source(
    changes: _ScoreChanges, influence: Float[np.ndarray, " d"]
) -> defaultdict[str, float]:
    """Contributions of some changes of the scores to the variance, by source."""
    variance = defaultdict[str, float](float)
    for source, change in changes:
        variance[source] += float(change @ influence) ** 2
    return variance


def _of_probings(
    misfit: Misfit, local: Sequence[LocalProbe], noise: ScoreNoise
) -> tuple[_ScoreChanges, _ScoreChanges]:
    """Change of the scores per standard deviation of each shift of a single probing, and of each
    considered error."""
    forces = force_moments(misfit, local)
    projections = shift_projections(local, noise, forces)
    own: _ScoreChanges = []
    for probe, projection, (power, _) in zip(local, projections, forces, strict=True):
        changes = np.sqrt(probe.prior(power))[:, None] * projection[probe.common :]
        own += zip(_sources(misfit, probe), changes, strict=True)
    considered = considered_score_changes(local, projections, noise)
    return own, [(error.source, changes.sum(axis=0)) for error, changes in considered.items()]


def _sources(misfit: Misfit, probe: LocalProbe) -> list[str]:
    """Source in the budget of each shift of a probing."""
    motions = [MOTIONS] * len(probe.rows.motion)
    return [FORCES] * 3 + motions + [error.source for error in misfit.own(probe.rows)]
