"""Estimation of the elastic constants.

Purpose    : shear modulus, Poisson's ratio and Young's modulus with intervals, from probings.
Takes      : `ProbeObservations` (measured displacements, force, a `ResponseModel`), `FitSettings`.
Gives      : `FitResult`: the `Estimate`, its likelihood, predictions and residuals per probing.
Depends on : `bem`, `records`, `geometry`.
Read first : `observations.py`, then `fit.py`.
"""

from palpate.estimation.fit import (
    FitResult as FitResult,
    best_constants_of as best_constants_of,
    fit as fit,
)
from palpate.estimation.fitted_model import (
    FittedModel as FittedModel,
    ModelState as ModelState,
    PredictedProbing as PredictedProbing,
)
from palpate.estimation.intervals import (
    Information as Information,
    IntervalSet as IntervalSet,
    LikelihoodMap as LikelihoodMap,
    ProbeFit as ProbeFit,
    cramer_rao_bound as cramer_rao_bound,
    fisher_information as fisher_information,
    predicted_surface as predicted_surface,
)
from palpate.estimation.nuisance import (
    ContactError as ContactError,
    CorrectionError as CorrectionError,
    Discretisation as Discretisation,
    ForceDirection as ForceDirection,
    ForceGain as ForceGain,
    LengthScale as LengthScale,
    LoadedResponse as LoadedResponse,
    ModelStep as ModelStep,
    Nuisance as Nuisance,
    NuisanceParameter as NuisanceParameter,
    Pose as Pose,
    SpaceStretch as SpaceStretch,
    SupportCompliance as SupportCompliance,
    ToolSlip as ToolSlip,
    contact_error as contact_error,
)
from palpate.estimation.observations import (
    ProbeObservations as ProbeObservations,
    ResponseModel as ResponseModel,
    Settlement as Settlement,
)
from palpate.estimation.responses import (
    CENTRE as CENTRE,
    DENSE_RESIDUAL as DENSE_RESIDUAL,
    PointRows as PointRows,
    ProbeMotions as ProbeMotions,
    ProbeResponse as ProbeResponse,
    ProbeRows as ProbeRows,
    ReducedModel as ReducedModel,
    SolutionModel as SolutionModel,
    SpringResponse as SpringResponse,
    full_responses as full_responses,
    full_spring_responses as full_spring_responses,
    make_reduced_model as make_reduced_model,
    make_spring_model as make_spring_model,
    reduced_response as reduced_response,
    reduced_spring_response as reduced_spring_response,
)
from palpate.estimation.settings import (
    FitMethod as FitMethod,
    FitSettings as FitSettings,
)
