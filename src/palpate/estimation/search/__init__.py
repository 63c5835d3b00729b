"""search."""

from palpate.estimation.search.global_search import (
    fitted_parameters as fitted_parameters,
    global_start as global_start,
    poisson_grid as poisson_grid,
    weighted_products as weighted_products,
)
from palpate.estimation.search.nelder_mead import nelder_mead_minimum as nelder_mead_minimum
from palpate.estimation.search.variable_projection import (
    ProjectedProbes as ProjectedProbes,
    best_compliance as best_compliance,
    deviance_of as deviance_of,
    parabola_minimum as parabola_minimum,
    projected as projected,
)
