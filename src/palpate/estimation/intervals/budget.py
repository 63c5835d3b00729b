"""Where the uncertainty of the constants comes from: their variance, source by source.

The estimate is linear in everything that is uncertain: in the noise of the points, in the shifts of
each probing (its force, motions of supports, errors of its own), in the errors that probings share
and in those that are considered only. All of these are independent, so the variance is the sum of
what each of them adds.
"""

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from palpate.estimation.intervals.sandwich import directions, force_moments, shift_projections
from palpate.estimation.intervals.score_noise import considered_pulls
from palpate.estimation.intervals.uncertainty import Uncertainty
from palpate.estimation.search import LocalProbe, Misfit
from palpate.records import CONSTANT_NAMES, BudgetEntry

POINTS, FORCES, MOTIONS = "noise of the points", "measured forces", "motions of supports"
SCATTER = "disagreement of the probings"


def uncertainty_budget(
    misfit: Misfit, joint: Uncertainty, identifiable: Mapping[str, bool]
) -> tuple[BudgetEntry, ...]:
    """What each source adds to the standard deviations of the constants.

    Parameters
    ----------
    misfit : Misfit
    joint : Uncertainty             of all its probings
    identifiable : mapping          constant's name -> whether the data determine it

    Returns
    -------
    tuple of BudgetEntry            the largest part of Young's modulus's first; the root of the sum
                                    of their squares is the standard deviation of each constant
                                    (`Uncertainty.error`); empty where nothing is determined

    Source
    ------
    JCGM 100, Guide to the expression of uncertainty in measurement (2008), 5.1
    """
    parts = {name: _variances(misfit, joint, name) for name in CONSTANT_NAMES if identifiable[name]}
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
    """Of the first constant that the data determine, Young's modulus before all."""
    values = (entry.young_modulus, entry.shear_modulus, entry.poisson_ratio)
    return next(value for value in values if not np.isnan(value))


def _variances(misfit: Misfit, joint: Uncertainty, name: str) -> dict[str, float]:
    """Variance of nu, log G or log E that each source adds."""
    scores, factor = joint.scores, joint.scatters[name].factor
    influence = scores.influence(directions(joint.minimum.poisson_ratio)[name])
    own, considered = _of_probings(misfit, joint, influence)
    # What is left of what is common to probings is the noise of their pictures at rest.
    common = 0.0 if scores.common is None else influence @ scores.common.sum((0, 1)) @ influence
    at_rest = float(common) - sum(considered.values())
    known = defaultdict(float, considered)
    for parameter, moved in zip(misfit.shared, influence[2:], strict=True):
        known[parameter.source] += float(moved**2)
    claimed = (joint.variance(name).total - at_rest - sum(known.values())) / factor
    own[POINTS] += claimed - sum(own.values())
    # Probings that agree better than claimed make all of it smaller.
    for source, value in own.items():
        known[source] += min(factor, 1.0) * value
    known[POINTS] += at_rest
    if factor > 1.0:
        known[SCATTER] = (factor - 1.0) * claimed
    return {source: max(value, 0.0) for source, value in known.items()}


def _of_probings(
    misfit: Misfit, joint: Uncertainty, influence: Float[np.ndarray, " d"]
) -> tuple[dict[str, float], dict[str, float]]:
    """Variance that the shifts of single probings add, and errors that are considered only."""
    local = joint.minimum.probes
    turns = shift_projections(misfit, local, joint.noise)
    own, considered = defaultdict[str, float](float), defaultdict[str, float](float)
    for probe, turn, (power, _) in zip(local, turns, force_moments(misfit, local), strict=True):
        added = probe.prior(power) * (turn[probe.common :] @ influence) ** 2
        for source, value in zip(_sources(misfit, probe), added.tolist(), strict=True):
            own[source] += value
    for parameter, pull in considered_pulls(local, turns, joint.noise).items():
        considered[parameter.source] += float((pull @ influence).sum() ** 2)
    return own, considered


def _sources(misfit: Misfit, probe: LocalProbe) -> list[str]:
    """What each shift of a probing belongs to."""
    motions = [MOTIONS] * len(probe.rows.motion)
    return [FORCES] * 3 + motions + [one.source for one in misfit.own(probe.rows)]
