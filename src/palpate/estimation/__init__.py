"""Estimation of the elastic constants.

Purpose    : shear modulus, Poisson's ratio and Young's modulus with intervals, from probings.
Takes      : `ProbeObservations` (measured displacements, force, a `ResponseModel`), `FitSettings`.
Gives      : `FitResult`: the `Estimate`, its likelihood, predictions and residuals per probing.
Depends on : `bem`, `records`, `geometry`.
Read first : `problem.py`, `gauss_newton.py`, `posterior.py`, then `fit.py`.
"""

from palpate.estimation.contact_errors import (
    ContactError as ContactError,
    ToolSlip as ToolSlip,
    contact_error as contact_error,
)
from palpate.estimation.fit import (
    FitMethod as FitMethod,
    FitResult as FitResult,
    FitSettings as FitSettings,
    best_constants_of as best_constants_of,
    fit as fit,
)
from palpate.estimation.information import (
    Information as Information,
    cramer_rao_bound as cramer_rao_bound,
    fisher_information as fisher_information,
)
from palpate.estimation.measurement_errors import (
    ForceDirection as ForceDirection,
    ForceGain as ForceGain,
    LengthScale as LengthScale,
    Pose as Pose,
    SpaceStretch as SpaceStretch,
)
from palpate.estimation.model_errors import (
    CorrectionError as CorrectionError,
    ModelStep as ModelStep,
    SupportCompliance as SupportCompliance,
)
from palpate.estimation.nuisance import (
    Nuisance as Nuisance,
    NuisanceParameter as NuisanceParameter,
    ResponseTerms as ResponseTerms,
)
from palpate.estimation.observations import (
    ProbeObservations as ProbeObservations,
    ResponseModel as ResponseModel,
    Settlement as Settlement,
)
from palpate.estimation.posterior import (
    IntervalSet as IntervalSet,
    LikelihoodMap as LikelihoodMap,
)
from palpate.estimation.predictions import (
    FittedModel as FittedModel,
    ModelState as ModelState,
    PredictedProbing as PredictedProbing,
    ProbeFit as ProbeFit,
    predicted_surface as predicted_surface,
)
from palpate.estimation.reduced_model import (
    CENTRE as CENTRE,
    DENSE_RESIDUAL as DENSE_RESIDUAL,
    ReducedModel as ReducedModel,
    SolutionModel as SolutionModel,
    make_reduced_model as make_reduced_model,
    make_spring_model as make_spring_model,
)
from palpate.estimation.responses import (
    PointRows as PointRows,
    ProbeMotions as ProbeMotions,
    ProbeResponse as ProbeResponse,
    ProbeRows as ProbeRows,
    SpringResponse as SpringResponse,
    full_responses as full_responses,
    full_spring_responses as full_spring_responses,
    reduced_responses as reduced_responses,
    reduced_spring_responses as reduced_spring_responses,
)
