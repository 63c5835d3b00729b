"""The same probings beside models of several meshes: what the mesh that is fitted may be off by."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.bem import LARGEST_DENSE, SurfaceSettings
from palpate.errors import NotConvergedError
from palpate.estimation import (
    SNAPSHOT_RESIDUAL,
    Discretisation,
    FitMethod,
    FitSettings,
    Interpolation,
    ProbeObservations,
    best_constants_of,
)
from palpate.geometry import bounding_diagonal
from palpate.pipeline.model import LEFT_OF_STEP, ObjectModel, graded_session, make_object_model
from palpate.pipeline.observations.session_observations import session_observations_at
from palpate.records import EXACT, Session

# Relative residual of a compressed model that shows the step to a finer mesh only: a thousandth of
# the displacement or more, so that the step is known to a hundredth.
_COARSER_RESIDUAL = 1e-5
# Where supports give: how often the modulus about which the model is taken is found anew, the
# change of its logarithm that ends this (what it leaves is of its square), and the longest step.
_SETTLING_ROUNDS, _SETTLED, _LONGEST_STEP = 12, 1e-3, 5.0


def coarser_observations(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    surface: SurfaceSettings = SurfaceSettings(),
    cache: Path | None = None,
    like: ObjectModel | None = None,
) -> tuple[ObjectModel, list[ProbeObservations]]:
    """The model of the mesh as it is, nothing else being wrong, and what was seen beside it.

    Beside the same on the graded mesh it shows how much the mesh is off.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    settings : FitSettings
    surface : SurfaceSettings
    cache : Path or None                  folder that keeps the integrals
    like : ObjectModel or None            as `make_object_model`

    Returns
    -------
    ObjectModel
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `settled_observations`
    """
    plain = replace(session, errors=EXACT)
    model = make_object_model(plain, surface=surface, cache=cache, nominal=True, like=like)
    return model, settled_observations(
        plain, model, settings=settings, snapshot_residual=_COARSER_RESIDUAL
    )


def with_interpolation_errors(
    session: Session,
    observations: Sequence[ProbeObservations],
    *,
    settings: FitSettings = FitSettings(),
    surface: SurfaceSettings = SurfaceSettings(),
    cache: Path | None = None,
) -> list[ProbeObservations]:
    """What was seen beside the given mesh's model, with what that model's fields between the
    vertices may be off by.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    observations : sequence of k ProbeObservations    `coarser_observations` of it, likewise
    settings : FitSettings
    surface : SurfaceSettings
    cache : Path or None                  folder that keeps the integrals

    Returns
    -------
    list of k ProbeObservations           as they are where elements are linear, and where the mesh
                                          is so large that its integrals are compressed: four times
                                          as many vertices leave a tenth of that error

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `settled_observations`
    """
    if not surface.quadratic or len(session.mesh.vertices) > LARGEST_DENSE:
        return list(observations)
    _, wider = coarser_observations(
        session,
        settings=replace(settings, method=FitMethod.REDUCED.value),
        surface=replace(surface, rings=2),
        cache=cache,
    )
    return [
        replace(one, considered=(Interpolation(one.response_at, other.response_at),))
        for one, other in zip(observations, wider, strict=True)
    ]


def graded_observations(session: Session) -> list[ProbeObservations]:
    """What a fit would see: beside the graded mesh's model, with the error that its mesh has.

    Parameters
    ----------
    session : Session                     k probings, each with displacements

    Returns
    -------
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `settled_observations`
    """
    _, coarser = coarser_observations(session)
    coarser = with_interpolation_errors(session, coarser)
    graded = graded_session(session)
    return settled_observations(graded, make_object_model(graded), coarser=coarser)


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
