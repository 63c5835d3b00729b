"""noise."""

from palpate.estimation.noise.misfit import (
    Misfit as Misfit,
    force_components as force_components,
    scaled_rows as scaled_rows,
    with_levels as with_levels,
)
from palpate.estimation.noise.noise import (
    claimed_only as claimed_only,
    noise_levels as noise_levels,
)
from palpate.estimation.noise.scoring import (
    LocalProbe as LocalProbe,
    ScoredMinimum as ScoredMinimum,
    scored_minimum as scored_minimum,
)
from palpate.estimation.noise.spatial_correlation import (
    CorrelationFactor as CorrelationFactor,
    correlation_factor as correlation_factor,
)
from palpate.estimation.noise.student_t import (
    cut_factor as cut_factor,
    gaussian_moments as gaussian_moments,
    score_moments as score_moments,
    weight_of as weight_of,
)
