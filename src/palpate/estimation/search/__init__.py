"""The search for the minimum of the misfit over Poisson's ratio and shear modulus.

Purpose    : a robust start over the whole range, then the exact minimum; a simplex as a check.
Takes      : `ObservedRows`, a `ResponseTable`, a `NoiseModel`.
Gives      : `Misfit`, `SearchState`, `Minimum` with the probings linearised there, `FixedWeights`.
Depends on : `estimation.noise`, `estimation.nuisance`, `estimation.responses`; the observations of
             its room.
Read first : `local_probe.py`, `misfit.py`, `variable_projection.py`, then `global_search.py`.
"""

from palpate.estimation.search.global_search import (
    fitted_parameters as fitted_parameters,
    global_start as global_start,
)
from palpate.estimation.search.local_probe import (
    LocalProbe as LocalProbe,
    SearchState as SearchState,
)
from palpate.estimation.search.misfit import Misfit as Misfit, total_loss as total_loss
from palpate.estimation.search.nelder_mead import nelder_mead_minimum as nelder_mead_minimum
from palpate.estimation.search.scoring import (
    Minimum as Minimum,
    diagonal_root as diagonal_root,
    scored_minimum as scored_minimum,
)
from palpate.estimation.search.settlement import without_settlement as without_settlement
from palpate.estimation.search.variable_projection import (
    FixedWeights as FixedWeights,
    ProjectedProbes as ProjectedProbes,
    best_compliance as best_compliance,
    best_constants as best_constants,
    deviance_of as deviance_of,
    fixed_weights as fixed_weights,
    refined_minimum as refined_minimum,
)
