"""Uncertainty of the constants, and how well the model fits each probing.

Purpose    : intervals, identifiability, the likelihood map, and predictions of the probings.
Takes      : a `Misfit` and its `Minimum`.
Gives      : `IntervalSet`, the uncertainty budget, `LikelihoodMap`, `ProbeFit`, `Information`, the
             Cramer-Rao bound.
Depends on : `estimation.noise`, `estimation.nuisance`, `estimation.search`, `records`, `geometry`;
             files of its room.
Read first : `sandwich.py`, then `uncertainty.py`.
"""

from palpate.estimation.intervals.contradiction import (
    Contradiction as Contradiction,
    contradiction as contradiction,
)
from palpate.estimation.intervals.identifiability import (
    identifiable_combination as identifiable_combination,
    identifiable_constants as identifiable_constants,
    with_prior_ranges as with_prior_ranges,
    with_undetermined_ratio as with_undetermined_ratio,
)
from palpate.estimation.intervals.information import (
    Information as Information,
    cramer_rao_bound as cramer_rao_bound,
    fisher_information as fisher_information,
)
from palpate.estimation.intervals.likelihood import (
    LikelihoodMap as LikelihoodMap,
    likelihood_map as likelihood_map,
)
from palpate.estimation.intervals.sandwich import scores_of as scores_of
from palpate.estimation.intervals.uncertainty import (
    IntervalSet as IntervalSet,
    Uncertainty as Uncertainty,
    interval_set as interval_set,
    uncertainty_of as uncertainty_of,
)
from palpate.estimation.intervals.validation import (
    ProbeFit as ProbeFit,
    error_estimates as error_estimates,
    fitted_errors as fitted_errors,
    predicted_points as predicted_points,
    predicted_surface as predicted_surface,
    probe_estimate as probe_estimate,
    probe_fits as probe_fits,
)
