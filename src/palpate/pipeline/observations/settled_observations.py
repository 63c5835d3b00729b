"""Observations beside a model whose supports give: about the modulus that fits them best."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palpate.errors import NotConvergedError
from palpate.estimation import (
    SNAPSHOT_RESIDUAL,
    Discretisation,
    FitSettings,
    ProbeObservations,
    best_constants_of,
)
from palpate.geometry import bounding_diagonal
from palpate.pipeline.model import LEFT_OF_STEP, ObjectModel
from palpate.pipeline.observations.session_observations import session_observations_at
from palpate.records import Session

# Where supports give: how often the modulus about which the model is taken is found anew, the
# change of its logarithm that ends this (what it leaves is of its square), and the longest step.
_SETTLING_ROUNDS, _SETTLED, _LONGEST_STEP = 12, 1e-3, 5.0


def settled_observations(
    session: Session,
    model: ObjectModel,
    *,
    settings: FitSettings = FitSettings(),
    coarser: Sequence[ProbeObservations] = (),
    with_surface: bool = False,
    snapshot_residual: float = SNAPSHOT_RESIDUAL,
) -> list[ProbeObservations]:
    """What each probing saw, with what the model says at the modulus that fits it best, where
    supports give and the model depends on it.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    model : ObjectModel                   of this session
    settings : FitSettings
    coarser : sequence of k ProbeObservations, or none    the same on a coarser mesh: the error of
                                          the mesh is added, and errors considered there are taken
    with_surface : bool                   have the displacement of all vertices told along with the
                                          estimate
    snapshot_residual : float             as `make_reduced_model`

    Returns
    -------
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `session_observations`; the springs
                                          explain the motion alone, so no modulus fits best
    """
    make = session_observations_at(
        session, model, settings=settings, with_surface=with_surface,
        snapshot_residual=snapshot_residual,
    )  # fmt: skip
    stiffnesses = [one.stiffness for one in session.supports if one.stiffness is not None]
    if not stiffnesses:
        return _with_mesh_errors(make(1.0), coarser)
    length = bounding_diagonal(session.mesh)
    modulus = min(stiffnesses) * length
    if coarser and coarser[0].settlement is not None:
        modulus = coarser[0].settlement.shear_modulus
    for _ in range(_SETTLING_ROUNDS):
        observations = _with_mesh_errors(make(modulus), coarser)
        _, found = best_constants_of(observations, settings=settings)
        step = float(np.log(found / modulus))
        if abs(step) < _SETTLED:
            return observations
        modulus *= float(np.exp(np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)))
    raise NotConvergedError(
        f"the shear modulus did not settle (last {found:.3g} Pa): under supports of stiffness"
        f" {min(stiffnesses):.3g} N/m^3 the object would hardly deform, or not at all; check the"
        " stiffness and the forces, and measure points that move against each other"
    )


def _with_mesh_errors(
    observations: Sequence[ProbeObservations], coarser: Sequence[ProbeObservations]
) -> list[ProbeObservations]:
    """What was seen, with the error of the mesh that a coarser one shows, if there is one."""
    if not coarser:
        return list(observations)
    found = []
    for one, other in zip(observations, coarser, strict=True):
        step = Discretisation(LEFT_OF_STEP, other.response_at)
        found.append(replace(one, nuisances=(*one.nuisances, step), considered=other.considered))
    return found
