"""Estimation of the elastic constants.

Purpose    : shear modulus, Poisson's ratio and Young's modulus with intervals, from probings.
Takes      : `ProbeObservations` (measured displacements, force, a `ResponseModel`), `FitSettings`.
Gives      : `FitResult`: the `Estimate`, its likelihood, predictions and residuals per probing.
Depends on : `bem`, `records`, `geometry`.
Read first : `observations.py`, then `fit.py`.
"""

from palpate.estimation.fit import FitResult as FitResult, fit as fit
from palpate.estimation.intervals import (
    IntervalSet as IntervalSet,
    LikelihoodMap as LikelihoodMap,
    ProbeFit as ProbeFit,
    cramer_rao_bound as cramer_rao_bound,
)
from palpate.estimation.nuisance import (
    ContactError as ContactError,
    Discretisation as Discretisation,
    ForceDirection as ForceDirection,
    ForceGain as ForceGain,
    LengthScale as LengthScale,
    Nuisance as Nuisance,
    NuisanceParameter as NuisanceParameter,
    Pose as Pose,
    SpaceStretch as SpaceStretch,
)
from palpate.estimation.observations import (
    ProbeObservations as ProbeObservations,
    ResponseModel as ResponseModel,
)
from palpate.estimation.responses import (
    PointRows as PointRows,
    ProbeMotions as ProbeMotions,
    ProbeResponse as ProbeResponse,
    ProbeRows as ProbeRows,
    ReducedModel as ReducedModel,
    full_responses as full_responses,
    make_reduced_model as make_reduced_model,
    reduced_response as reduced_response,
)
from palpate.estimation.settings import (
    FitMethod as FitMethod,
    FitSettings as FitSettings,
)
