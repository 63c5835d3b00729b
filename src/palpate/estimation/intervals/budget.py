"""Uncertainty budget: the variance of the constants, source by source.

To first order the estimate is linear in every uncertain quantity: the noise of the points, the
shifts of each probing (its force, motions of supports, its own errors), the shared errors and the
considered ones. All of these are independent, so their contributions to the variance add up.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from palpate.estimation.intervals.sandwich import ScoreChange, Scores, directions
from palpate.records import CONSTANT_NAMES, BudgetEntry

POINTS, SCATTER = "noise of the points", "disagreement of the probings"


def uncertainty_budget(
    scores: Scores, *, poisson_ratio: float, factors: Mapping[str, float]
) -> tuple[BudgetEntry, ...]:
    """Contribution of each source to the standard deviations of nu, log G and log E.

    Parameters
    ----------
    scores : Scores                     of all probings, at a minimum
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
    parts = {
        name: _variances(scores, direction_of[name], factor) for name, factor in factors.items()
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


def _variances(scores: Scores, direction: np.ndarray, factor: float) -> dict[str, float]:
    """Contribution of each source to the variance of nu, log G or log E."""
    influence = scores.influence(direction)
    independent = _variance_by_source(scores.own_changes, influence)
    variance = _variance_by_source(scores.considered_changes, influence)
    # Common noise that is not from considered errors is from shared reference pictures.
    common = float(influence @ scores.common_covariance.sum((0, 1)) @ influence)
    reference_pictures = common - sum(variance.values())
    for parameter, effect in zip(scores.shared, influence[2:], strict=True):
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
    changes: Sequence[ScoreChange], influence: Float[np.ndarray, " d"]
) -> defaultdict[str, float]:
    """Contributions of some changes of the scores to the variance, by source."""
    variance = defaultdict[str, float](float)
    for source, change in changes:
        variance[source] += float(change @ influence) ** 2
    return variance
