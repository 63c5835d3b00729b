"""Observations with a model on compliant supports, taken at the shear modulus that fits best."""

from collections.abc import Sequence

import numpy as np

from palpate.bem import DENSE_RESIDUAL
from palpate.errors import NotConvergedError
from palpate.estimation import (
    FitSettings,
    ProbeObservations,
    best_constants_of,
)
from palpate.geometry import bounding_diagonal
from palpate.pipeline.model import GRADED, GRADED_STD, ObjectModel
from palpate.pipeline.observations.mesh_steps import MeshStep, extrapolated
from palpate.pipeline.observations.session_observations import session_observations_at
from palpate.records import Session

# For compliant supports: largest number of iterations for the modulus at which the model is taken,
# the change of its logarithm that ends them (the error is of second order in it), and the longest
# step.
_MOST_ROUNDS, _STEP_TOLERANCE, _LONGEST_STEP = 12, 1e-3, 5.0

_GRADING = "mesh at rims and hollow edges (in steps from the given to the graded one)"


def converged_observations(
    session: Session,
    model: ObjectModel,
    *,
    settings: FitSettings = FitSettings(),
    coarser: Sequence[ProbeObservations] = (),
    steps: Sequence[Sequence[MeshStep]] = (),
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
    coarser : sequence of k ProbeObservations, or empty    with the model of the mesh before
                                          grading: adds the error of the mesh
    steps : sequence of k sequences of MeshStep    further ones, of each probing; with `coarser`
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
        return _with_mesh_errors(make(1.0), coarser, steps)
    length = bounding_diagonal(session.mesh)
    modulus = min(stiffnesses) * length
    if coarser and coarser[0].settlement is not None:
        modulus = coarser[0].settlement.shear_modulus
    for _ in range(_MOST_ROUNDS):
        observations = _with_mesh_errors(make(modulus), coarser, steps)
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
    observations: Sequence[ProbeObservations],
    coarser: Sequence[ProbeObservations],
    steps: Sequence[Sequence[MeshStep]],
) -> list[ProbeObservations]:
    """Observations with the error of the mesh from those on a coarser one, if there are any."""
    if not coarser:
        return list(observations)
    return [
        extrapolated(probe, (MeshStep(_GRADING, GRADED, GRADED_STD, coarse, probe), *further))
        for probe, coarse, further in zip(observations, coarser, steps, strict=True)
    ]
