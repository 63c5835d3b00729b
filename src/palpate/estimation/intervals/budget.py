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
from palpate.estimation.intervals.score_noise import ScoreNoise, considered_pulls
from palpate.estimation.search import LocalProbe, Misfit
from palpate.records import CONSTANT_NAMES, BudgetEntry

POINTS, FORCES, MOTIONS = "noise of the points", "measured forces", "motions of supports"
SCATTER = "disagreement of the probings"
# Source of a quantity, and the change of the scores, (d,), per standard deviation of it.
_Pulls = list[tuple[str, np.ndarray]]


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
    turns = directions(poisson_ratio)
    own, considered = _of_probings(misfit, local, noise)
    parts = {
        name: _variances(misfit, scores, own, considered, turns[name], factor)
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
    misfit: Misfit, scores: Scores, own: _Pulls, considered: _Pulls, turn: np.ndarray, factor: float
) -> dict[str, float]:
    """Contribution of each source to the variance of nu, log G or log E."""
    influence = scores.influence(turn)
    alone, known = _added(own, influence), _added(considered, influence)
    # Common noise that is not from considered errors is from shared reference pictures.
    common = 0.0 if scores.common is None else influence @ scores.common.sum((0, 1)) @ influence
    at_rest = float(common) - sum(known.values())
    for parameter, moved in zip(misfit.shared, influence[2:], strict=True):
        known[parameter.source] += float(moved**2)
    claimed = float(turn @ scores.covariance()[:2, :2] @ turn)
    claimed -= at_rest + sum(known.values())
    alone[POINTS] += claimed - sum(alone.values())
    # Where probings agree better than claimed, all independent contributions shrink.
    for source, value in alone.items():
        known[source] += min(factor, 1.0) * value
    known[POINTS] += at_rest
    if factor > 1.0:
        known[SCATTER] = (factor - 1.0) * claimed
    return {source: max(value, 0.0) for source, value in known.items()}


def _added(pulls: _Pulls, influence: Float[np.ndarray, " d"]) -> defaultdict[str, float]:
    """Contributions of some pulls to the variance, by source."""
    found = defaultdict[str, float](float)
    for source, pull in pulls:
        found[source] += float(pull @ influence) ** 2
    return found


def _of_probings(
    misfit: Misfit, local: Sequence[LocalProbe], noise: ScoreNoise
) -> tuple[_Pulls, _Pulls]:
    """Change of the scores per standard deviation of each shift of a single probing, and of each
    considered error."""
    forces = force_moments(misfit, local)
    turns = shift_projections(local, noise, forces)
    own: _Pulls = []
    for probe, turn, (power, _) in zip(local, turns, forces, strict=True):
        pulls = np.sqrt(probe.prior(power))[:, None] * turn[probe.common :]
        own += zip(_sources(misfit, probe), pulls, strict=True)
    considered = considered_pulls(local, turns, noise)
    return own, [(one.source, pulls.sum(axis=0)) for one, pulls in considered.items()]


def _sources(misfit: Misfit, probe: LocalProbe) -> list[str]:
    """Source in the budget of each shift of a probing."""
    motions = [MOTIONS] * len(probe.rows.motion)
    return [FORCES] * 3 + motions + [one.source for one in misfit.own(probe.rows)]
