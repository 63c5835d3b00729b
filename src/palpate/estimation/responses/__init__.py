"""Displacements that the boundary element model predicts for each probing.

Purpose    : displacements of observed points at every Poisson's ratio, from one factorisation.
Takes      : a `bem` system with its right-hand sides, and the displacements each probing observes.
Gives      : `ProbeResponse` (a `ResponseModel`), `ReducedModel`, `ResponseTable`.
Depends on : `bem`; the observations of its room.
Read first : `responses.py`, then `reduced_model.py`.
"""

from palpate.estimation.responses.reduced_model import (
    CENTRE as CENTRE,
    DENSE_RESIDUAL as DENSE_RESIDUAL,
    ReducedModel as ReducedModel,
    SolutionModel as SolutionModel,
    make_reduced_model as make_reduced_model,
    make_spring_model as make_spring_model,
)
from palpate.estimation.responses.responses import (
    PointRows as PointRows,
    ProbeMotions as ProbeMotions,
    ProbeResponse as ProbeResponse,
    ProbeRows as ProbeRows,
    SpringResponse as SpringResponse,
    full_responses as full_responses,
    full_spring_responses as full_spring_responses,
    reduced_response as reduced_response,
    reduced_spring_response as reduced_spring_response,
)
from palpate.estimation.responses.table import (
    ResponseTable as ResponseTable,
    interpolation_weights as interpolation_weights,
    response_table as response_table,
)
