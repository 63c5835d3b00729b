"""intervals."""

from palpate.estimation.intervals.cramer_rao import cramer_rao_bound as cramer_rao_bound
from palpate.estimation.intervals.identifiability import (
    identifiable_constants as identifiable_constants,
    told_combination as told_combination,
    with_prior_ranges as with_prior_ranges,
)
from palpate.estimation.intervals.likelihood_map import (
    LikelihoodMap as LikelihoodMap,
    likelihood_map as likelihood_map,
)
from palpate.estimation.intervals.model_error import (
    with_displacement_error as with_displacement_error,
    with_model_error as with_model_error,
)
from palpate.estimation.intervals.profile_likelihood import FixedWeights as FixedWeights
from palpate.estimation.intervals.sandwich import (
    Scatter as Scatter,
    ScoreNoise as ScoreNoise,
    Scores as Scores,
    scores_of as scores_of,
)
from palpate.estimation.intervals.uncertainty import (
    IntervalSet as IntervalSet,
    interval_sets as interval_sets,
    scatters_of as scatters_of,
)
from palpate.estimation.intervals.validation import (
    ProbeFit as ProbeFit,
    left_out_constants as left_out_constants,
    probe_fits as probe_fits,
)
