"""Estimation of the elastic constants.

Purpose    : shear modulus, Poisson's ratio and Young's modulus with intervals, from probings.
Takes      : `ProbeObservations` (measured displacements, force, a `ResponseModel`), `FitSettings`.
Gives      : `FitResult`: the `Estimate`, its likelihood, predictions and residuals per probing.
Depends on : `records`, `geometry`, `errors`, `shapes`; `reduced_model` also on `bem`.
Read first : `observations.py`, `misfit.py`, then `fit.py`.
"""

from palpate.estimation.cramer_rao import cramer_rao_bound
from palpate.estimation.fit import FitResult, fit
from palpate.estimation.likelihood_map import LikelihoodMap
from palpate.estimation.observations import ProbeObservations, ResponseModel
from palpate.estimation.reduced_model import ReducedModel, make_reduced_model
from palpate.estimation.responses import (
    FullModel,
    FullResponse,
    PointRows,
    ProbeRows,
    ReducedResponse,
    reduced_response,
)
from palpate.estimation.settings import FitMethod, FitSettings, IntervalMethod
from palpate.estimation.uncertainty import IntervalSet
from palpate.estimation.validation import ProbeFit

__all__ = [
    "FitMethod",
    "FitResult",
    "FitSettings",
    "FullModel",
    "FullResponse",
    "IntervalMethod",
    "IntervalSet",
    "LikelihoodMap",
    "PointRows",
    "ProbeFit",
    "ProbeObservations",
    "ProbeRows",
    "ReducedModel",
    "ReducedResponse",
    "ResponseModel",
    "cramer_rao_bound",
    "fit",
    "make_reduced_model",
    "reduced_response",
]
