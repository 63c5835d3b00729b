"""Observations of a session's probings: measured displacements with the responses of the model."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.bem import (
    DENSE_RESIDUAL,
    CompressedSystem,
    SolutionModel,
    factorise,
    make_reduced_model,
    solve,
)
from palpate.errors import InputError
from palpate.estimation import FitMethod, FitSettings, Nuisance, ProbeObservations
from palpate.geometry import SurfacePoints, TriangleMesh, distinct_points
from palpate.pipeline.model.moving_supports import free_std, given_motion
from palpate.pipeline.model.object_model import ObjectModel
from palpate.pipeline.model.probe_rows import probe_rows
from palpate.pipeline.model.responses import ProbeResponse, full_responses, reduced_responses
from palpate.pipeline.model.shared_errors import pose_changes, shared_errors
from palpate.pipeline.model.spring_responses import settlement, spring_responses
from palpate.records import GIVEN, DisplacementField, Probing, Session
from palpate.shapes import Vertices

# Relative residual for perturbed contacts; in thin bodies the error of the solution may be 1000
# times as large.
_PERTURBATION_TOLERANCE = 1e-5


def session_observations(
    session: Session,
    model: ObjectModel,
    *,
    settings: FitSettings = FitSettings(),
    shear_modulus: float = 1.0,
) -> list[ProbeObservations]:
    """Measured displacements of each probing, with the responses of the model.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    model : ObjectModel                   of this session
    settings : FitSettings                method and range of Poisson's ratio
    shear_modulus : float [Pa]            at which responses are taken; matters only where a support
                                          has a stiffness

    Returns
    -------
    list of k ProbeObservations

    Raises
    ------
    InputError                            a probing without displacements
    SingularSystemError                   the support does not hold the object
    NotConvergedError                     the reduced model does not cover the range
    """
    return session_observations_at(session, model, settings=settings)(shear_modulus)


def session_observations_at(
    session: Session,
    model: ObjectModel,
    *,
    settings: FitSettings = FitSettings(),
    with_surface: bool = False,
    residual: float = DENSE_RESIDUAL,
) -> Callable[[float], list[ProbeObservations]]:
    """As `session_observations`, for any modulus, from one factorisation.

    Parameters
    ----------
    session : Session
    model : ObjectModel
    settings : FitSettings
    with_surface : bool                   True: with responses of all vertices
    residual : float                      largest one of the loads (`make_reduced_model`)

    Returns
    -------
    function                              shear modulus [Pa] -> list of ProbeObservations

    Raises
    ------
    InputError                            a response that is not finite; a compressed system without
                                          reduced model
    SingularSystemError                   the support does not hold the object
    NotConvergedError                     the basis of the reduced model does not converge
    """
    rows = [
        probe_rows(model, k, _measured(probing).surface, average=_measured(probing).average)
        for k, probing in enumerate(session.probings)
    ]
    with_pose = session.errors.pose_translation > 0.0 or session.errors.pose_rotation > 0.0
    if with_pose or with_surface:
        every = _vertices(session.mesh)
        rows += [probe_rows(model, k, every, perturbed=False) for k in range(len(session.probings))]
    if model.springs is not None:
        on_springs = spring_responses(model, model.springs, rows, settings)
        return lambda modulus: _all_observations(session, model, on_springs(modulus), modulus)
    if settings.method == FitMethod.NELDER_MEAD:
        responses = full_responses(_full_solution(model), rows)
    else:
        reduced = reduced_model_of(model, settings=settings, residual=residual)
        responses = reduced_responses(reduced, rows, settings.poisson_range)
    return lambda modulus: _all_observations(session, model, responses, modulus)


def _full_solution(model: ObjectModel) -> Callable[[float], Float[np.ndarray, "k c"]]:
    """Poisson's ratio -> the solutions there, by a factorisation of their own."""
    if isinstance(model.system, CompressedSystem):
        raise InputError(
            f"the method nelder-mead factorises anew at every step, and a surface of"
            f" {len(model.session.mesh.vertices)} vertices is solved by iteration instead: leave"
            " --method out, or simplify the surface"
        )
    return lambda poisson_ratio: solve(
        factorise(model.system, poisson_ratio), model.right.at(poisson_ratio)
    )


def reduced_model_of(
    model: ObjectModel,
    *,
    settings: FitSettings = FitSettings(),
    residual: float = DENSE_RESIDUAL,
) -> SolutionModel:
    """Solutions for all loads of a model on supports that do not yield, at all Poisson's ratios.

    They do not depend on what was measured.

    Parameters
    ----------
    model : ObjectModel
    settings : FitSettings                range of Poisson's ratio
    residual : float                      as in `session_observations_at`

    Returns
    -------
    SolutionModel                         kept in the model's cache, if it has one

    Raises
    ------
    SingularSystemError, NotConvergedError    as `session_observations_at`
    """
    tolerance = np.full(model.right.terms.shape[2], residual)
    tolerance[model.loads.perturbation_columns] = _PERTURBATION_TOLERANCE
    return make_reduced_model(
        model.centred or model.system, model.right, poisson_range=settings.poisson_range,
        tolerance=tolerance,
    )  # fmt: skip


def _all_observations(
    session: Session,
    model: ObjectModel,
    responses: Sequence[ProbeResponse],
    shear_modulus: float,
) -> list[ProbeObservations]:
    """Observations of each probing; the first responses are those of the probings' points, further
    ones, if any, those of all vertices."""
    own = responses[: len(session.probings)]
    vertices = responses[len(session.probings) :] or own
    support = session.mesh.vertices[np.unique(session.mesh.triangles[session.held_triangles])]
    changes = _pose_changes(session, model)
    observations = []
    for k, (response, nodal) in enumerate(zip(own, vertices, strict=True)):
        nuisances = shared_errors(model, k, response, changes[k], nodal.value)
        probe = _observations(session, model, k, response, support, nuisances)
        probe = replace(probe, vertices=None if nodal is response else nodal)
        if model.springs is not None:
            probe = replace(probe, settlement=settlement(model, response, shear_modulus))
        observations.append(probe)
    return observations


def _pose_changes(session: Session, model: ObjectModel) -> list[list[csr_array]]:
    """`pose_changes` of every probing's points, computed once for points common to several."""
    surfaces = [_measured(probing).surface for probing in session.probings]
    every, numbers = distinct_points(surfaces)
    changes = pose_changes(model, every)
    rows = [(3 * number[:, None] + np.arange(3)).ravel() for number in numbers]
    return [[change[own] for change in changes] for own in rows]


def _vertices(mesh: TriangleMesh) -> SurfacePoints:
    """All vertices as points of the surface."""
    corner = np.zeros(len(mesh.vertices), dtype=np.int64)
    corner[mesh.triangles.ravel()] = np.arange(mesh.triangles.size)
    triangle, place = np.divmod(corner, 3)
    return SurfacePoints(triangle, np.eye(3)[place], mesh.vertices, np.zeros(len(corner)))


def _observations(
    session: Session,
    model: ObjectModel,
    index: int,
    response: ProbeResponse,
    support: Vertices,
    nuisances: tuple[Nuisance, ...],
) -> ProbeObservations:
    probing = session.probings[index]
    field = _measured(probing)
    motion, motion_std = _motions(session, model, index)
    force_std = probing.force_std
    if force_std is None:
        length = float(np.linalg.norm(probing.force))
        force_std = np.full(3, session.errors.force * length)
    return ProbeObservations(
        name=probing.name,
        position=field.points,
        displacement=field.displacement,
        std=field.std,
        covariance=field.covariance,
        correlation=field.correlation,
        force=probing.force,
        force_std=force_std,
        tip_displacement=probing.tip_displacement,
        tip_displacement_std=probing.tip_displacement_std,
        response=response,
        landmarks={"the contact": probing.contact.point[None], "the support": support},
        motion=motion,
        motion_std=motion_std,
        nuisances=nuisances,
        reference=probing.images.rest if probing.images and field.vertex is not None else None,
    )


def _motions(
    session: Session, model: ObjectModel, index: int
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    """Prior values and standard deviations of the motions of the supports."""
    value, std = [], []
    for support in model.supports:
        if support.motion == GIVEN:
            given = given_motion(session, session.probings[index], support)
            value.append(given.value)
            std.append(given.std)
        else:
            value.append(np.zeros(6))
            std.append(free_std(session.mesh))
    strains = np.ones(int(model.gives_motions))
    remaining = [
        j for j in range(6 * len(value) + strains.size) if j not in model.pulled_translations(index)
    ]
    return (
        np.concatenate([*value, strains])[remaining],
        np.concatenate([*std, 0.0 * strains])[remaining],
    )


def _measured(probing: Probing) -> DisplacementField:
    """The displacements of a probing; an error where there are none."""
    if probing.displacement is None:
        raise InputError(
            f"probing '{probing.name}' has no measured displacement and no images; give one of"
            " them, or leave it out with --probe"
        )
    return probing.displacement
