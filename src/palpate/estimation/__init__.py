"""Estimation of the elastic constants.

Purpose    : shear modulus, Poisson's ratio and Young's modulus with intervals, from probings.
Takes      : `ProbeObservations` (measured displacements, force, a `ResponseModel`), `FitSettings`.
Gives      : `FitResult`: the `Estimate`, its likelihood, predictions and residuals per probing.
Depends on : `relaxation`, `records`, `geometry`.
Read first : `problem.py`, `gauss_newton.py`, `posterior.py`, then `fit.py`.
"""

from palpate.estimation.checks import FALSE_ALARM as FALSE_ALARM
from palpate.estimation.fit import (
    FitMethod as FitMethod,
    FitResult as FitResult,
    FitSettings as FitSettings,
    contradicted as contradicted,
    fit as fit,
    joint_minimum as joint_minimum,
)
from palpate.estimation.gauss_newton import (
    at_constants as at_constants,
    gauss_newton as gauss_newton,
    with_noise as with_noise,
)
from palpate.estimation.information import (
    Information as Information,
    fisher_information as fisher_information,
)
from palpate.estimation.measured_components import (
    MeasuredComponents as MeasuredComponents,
    observed_rows_of as observed_rows_of,
)
from palpate.estimation.normal_equations import (
    Evaluation as Evaluation,
    information_of_common as information_of_common,
)
from palpate.estimation.observations import (
    PLACES as PLACES,
    Nuisance as Nuisance,
    NuisanceParameter as NuisanceParameter,
    ProbeObservations as ProbeObservations,
    ResponseModel as ResponseModel,
    ResponseTerms as ResponseTerms,
    Settlement as Settlement,
    fixed_displacement as fixed_displacement,
    padded as padded,
)
from palpate.estimation.posterior import (
    IntervalSet as IntervalSet,
    LikelihoodMap as LikelihoodMap,
)
from palpate.estimation.predictions import (
    Prediction as Prediction,
    ProbeFit as ProbeFit,
    predictions_of as predictions_of,
)
from palpate.estimation.unknown_error import UnknownRows as UnknownRows
