"""Observations with a model on compliant supports, taken at the shear modulus that fits best."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from palpate.bem import DENSE_RESIDUAL
from palpate.errors import NotConvergedError
from palpate.estimation import (
    FitSettings,
    Nuisance,
    NuisanceParameter,
    ProbeObservations,
    ResponseTerms,
    best_constants_of,
    padded,
)
from palpate.geometry import bounding_diagonal
from palpate.pipeline.model.grading import REMAINING_FRACTION
from palpate.pipeline.model.object_model import ObjectModel
from palpate.pipeline.observations.session_observations import session_observations_at
from palpate.records import Session

# For compliant supports: largest number of iterations for the modulus at which the model is taken,
# the change of its logarithm that ends them (the error is of second order in it), and the longest
# step.
_MOST_ROUNDS, _STEP_TOLERANCE, _LONGEST_STEP = 12, 1e-3, 5.0

Terms = Callable[[float], Float[np.ndarray, "n_rows t c"]]

_GRADING = "mesh at rims and hollow edges (in steps from the given to the graded one)"


def converged_observations(
    session: Session,
    model: ObjectModel,
    *,
    settings: FitSettings = FitSettings(),
    coarser: Sequence[ProbeObservations] = (),
    with_surface: bool = False,
    residual: float = DENSE_RESIDUAL,
) -> list[ProbeObservations]:
    """Observations with the model at the best-fit shear modulus, on which it depends where supports
    are compliant.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    model : ObjectModel                   of this session
    settings : FitSettings
    coarser : sequence of k ProbeObservations, or empty    the same on a coarser mesh: adds the
                                          error of the mesh and the errors that it has there
    with_surface : bool                   True: with responses of all vertices
    residual : float                      as `session_observations_at`

    Returns
    -------
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `session_observations`; or the modulus
                                          does not converge, as the springs alone explain the motion
    """
    make = session_observations_at(
        session, model, settings=settings, with_surface=with_surface, residual=residual
    )
    stiffnesses = [each.stiffness for each in session.supports if each.stiffness is not None]
    if not stiffnesses:
        return _with_mesh_errors(make(1.0), coarser)
    length = bounding_diagonal(session.mesh)
    modulus = min(stiffnesses) * length
    if coarser and coarser[0].settlement is not None:
        modulus = coarser[0].settlement.shear_modulus
    for _ in range(_MOST_ROUNDS):
        observations = _with_mesh_errors(make(modulus), coarser)
        _, best = best_constants_of(observations, settings=settings)
        step = float(np.log(best / modulus))
        if abs(step) < _STEP_TOLERANCE:
            return observations
        modulus *= float(np.exp(np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)))
    raise NotConvergedError(
        f"the shear modulus did not settle (last {best:.3g} Pa): under supports of stiffness"
        f" {min(stiffnesses):.3g} N/m^3 the object would hardly deform, or not at all; check the"
        " stiffness and the forces, and measure points that move against each other"
    )


def _with_mesh_errors(
    observations: Sequence[ProbeObservations], coarser: Sequence[ProbeObservations]
) -> list[ProbeObservations]:
    """Observations with the error of the mesh from those on a coarser one, if there are any."""
    if not coarser:
        return list(observations)
    with_errors = []
    for probe, coarse in zip(observations, coarser, strict=True):
        error = model_step(
            _GRADING, REMAINING_FRACTION, coarse.response_terms, probe.response_terms
        )
        steps = (each for each in coarse.nuisances if each.parameters[0].is_model_error)
        with_errors.append(replace(probe, nuisances=(*probe.nuisances, error, *steps)))
    return with_errors


def model_step(name: str, std: float, model: Terms, alternative: Terms) -> Nuisance:
    """An error as large as the difference of two models of the same body, the same in all probings.

    Parameters
    ----------
    name : str                      of the error, worded so that it can end a sentence
    std : float [-]                 standard deviation as a fraction of the step, > 0
    model, alternative : function   Poisson's ratio -> (n_rows, t, c) float: responses of both
                                    (`ProbeObservations.response_terms`); the step leads from the
                                    first to the second

    Returns
    -------
    Nuisance
    """

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r t c 1"]:
        steps = [side(at.poisson_ratio)[at.rows] for side in (model, alternative)]
        count = max(step.shape[1] for step in steps)
        first, second = (padded(step[..., None], count) for step in steps)
        return std * (second - first)

    return Nuisance((NuisanceParameter(name, std, of="mesh", is_model_error=True),), effects)
