"""Observations of a session's probings: measured displacements with the responses of the model.

A model on compliant supports is taken at the shear modulus that fits best. Models of several meshes
of one body show how large the discretisation error is.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from jaxtyping import Float, Int

from palpate.bem import DENSE_RESIDUAL, LARGEST_DENSE, SolutionModel, make_solver
from palpate.checkpoints import Cache
from palpate.errors import InputError, NotConvergedError
from palpate.estimation import (
    FitMethod,
    FitSettings,
    Nuisance,
    NuisanceParameter,
    ProbeObservations,
    ResponseTerms,
    joint_minimum,
    padded,
)
from palpate.geometry import SurfacePoints, TriangleMesh, bounding_diagonal, distinct_points
from palpate.pipeline.model.grading import REMAINING_FRACTION, edge_refined_session, graded_session
from palpate.pipeline.model.object_model import (
    ObjectModel,
    ObservationMatrix,
    make_object_model,
    probe_columns,
    probe_rows,
)
from palpate.pipeline.model.pose import PoseChanges, pose_changes
from palpate.pipeline.model.responses import (
    ProbeResponse,
    full_responses,
    reduced_responses,
    settlement,
    spring_responses,
)
from palpate.pipeline.model.shared_errors import shared_errors
from palpate.pipeline.model.supports import free_std, given_motion
from palpate.pipeline.once import made_once
from palpate.progress import Progress, part_of, silent
from palpate.records import EXACT, GIVEN, DisplacementField, Probing, Session
from palpate.shapes import Vertices

# Relative residual for perturbed contacts; in thin bodies the error of the solution may be 1000
# times as large.
_PERTURBATION_TOLERANCE = 1e-5
# For compliant supports: largest number of iterations for the modulus at which the model is taken,
# the change of its logarithm that ends them (the error is of second order in it), and the longest
# step.
_MOST_ROUNDS, _STEP_TOLERANCE, _LONGEST_STEP = 12, 1e-3, 5.0
Terms = Callable[[float], Float[np.ndarray, "n_rows t c"]]
_GRADING = "mesh at rims and hollow edges (in steps from the given to the graded one)"
# Relative residual of a model used only for the change to a finer mesh: that is at least a
# thousandth of the displacement, so it is known to a hundredth; on a plate of 5 mm a residual of
# 1e-4 changes no constant by 1e-7.
UNGRADED_RESIDUAL = 1e-5
# What an estimate calls the errors that come out of the compared meshes.
_STEPS = {
    "wider fits": "fields between the vertices (in steps to wider fits)",
    "finer edges": "sharp edges (in steps to finer ones)",
}
# Fraction of the work that the integrals take.
_SOLVED = 0.5


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
    return _session_observations_at(session, model, settings=settings)(shear_modulus)


def reduced_model_of(
    model: ObjectModel,
    *,
    settings: FitSettings = FitSettings(),
    residual: float = DENSE_RESIDUAL,
    columns: Int[np.ndarray, " m"] | None = None,
) -> SolutionModel:
    """Solutions for loads of a model on supports that do not yield, at all Poisson's ratios.

    They do not depend on what was measured.

    Parameters
    ----------
    model : ObjectModel
    settings : FitSettings                range of Poisson's ratio
    residual : float                      largest one of the loads (`make_reduced_model`)
    columns : (m,) int or None            of the loads' right-hand sides; None: all

    Returns
    -------
    SolutionModel                         kept in the model's cache, if it has one

    Raises
    ------
    SingularSystemError, NotConvergedError    as `make_reduced_model`
    """
    tolerance = np.full(model.right.terms.shape[2], residual)
    tolerance[model.loads.perturbation_columns] = _PERTURBATION_TOLERANCE
    right = model.right
    if columns is not None:
        right, tolerance = right.of(columns), tolerance[columns]
    return model.solver.reduced_model(right, settings.poisson_range, tolerance)


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
    residual : float                      as `reduced_model_of`

    Returns
    -------
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `session_observations`; or the modulus
                                          does not converge, as the springs alone explain the motion
    """
    make = _session_observations_at(
        session, model, settings=settings, with_surface=with_surface, residual=residual
    )
    stiffnesses = [
        support.stiffness for support in session.supports if support.stiffness is not None
    ]
    if not stiffnesses:
        return _with_mesh_errors(make(1.0), coarser)
    length = bounding_diagonal(session.mesh)
    modulus = min(stiffnesses) * length
    if coarser and coarser[0].settlement is not None:
        modulus = coarser[0].settlement.shear_modulus
    for _ in range(_MOST_ROUNDS):
        observations = _with_mesh_errors(make(modulus), coarser)
        best = joint_minimum(observations, settings).shear_modulus
        step = float(np.log(best / modulus))
        if abs(step) < _STEP_TOLERANCE:
            return observations
        modulus *= float(np.exp(np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)))
    raise NotConvergedError(
        f"the shear modulus did not settle (last {best:.3g} Pa): under supports of stiffness"
        f" {min(stiffnesses):.3g} N/m^3 the object would hardly deform, or not at all; check the"
        " stiffness and the forces, and measure points that move against each other"
    )


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


def ungraded_observations(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    rings: int = 1,
    cache: Cache | None = None,
    like: ObjectModel | None = None,
    with_surface: bool = False,
    progress: Progress = silent,
) -> tuple[ObjectModel | None, list[ProbeObservations]]:
    """The model of the mesh as it is, without other errors, and the observations with it.

    The change from these to the graded mesh shows the discretisation error.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    settings : FitSettings
    rings : int                           as for `bem.make_surface`
    cache : Cache or None                 folder in which what is computed of the body is kept
    like : ObjectModel or None            as `make_object_model`
    with_surface : bool                   True: with responses of all vertices
    progress : callable                   called with the current step (text) and the fraction done

    Returns
    -------
    ObjectModel or None                   None: all observations were kept
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `converged_observations`
    """
    model = like

    def make(new: Session) -> list[ProbeObservations]:
        nonlocal model
        model = ungraded_model(
            new, settings=settings, rings=rings, cache=cache, like=model,
            progress=part_of(progress, 0.0, _SOLVED),
        )  # fmt: skip
        progress("reduced model", _SOLVED)
        return converged_observations(
            model.session,
            model,
            settings=settings,
            with_surface=with_surface,
            residual=UNGRADED_RESIDUAL,
        )

    observations = made_once(session, ("ungraded", settings, rings, with_surface), make, cache)
    return model, observations


def ungraded_model(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    rings: int = 1,
    cache: Cache | None = None,
    like: ObjectModel | None = None,
    progress: Progress = silent,
) -> ObjectModel:
    """The model of the mesh as it is, without other errors.

    Parameters
    ----------
    session, settings, rings, cache, like, progress    as in `ungraded_observations`

    Returns
    -------
    ObjectModel

    Raises
    ------
    InputError                            as `make_object_model`
    """
    plain = replace(session, errors=EXACT)
    progress("integrals", 0.0)
    model = make_object_model(
        plain, rings=rings, cache=cache, perturbed=False, like=like, progress=progress
    )
    # On springs, factors serve all moduli.
    if like is None and model.springs is None:
        # In solutions, a residual of 1e-5 allows for errors at least as large as single precision.
        model = replace(model, solver=make_solver(model.system, single=True))
    return model


def with_mesh_steps(
    session: Session,
    observations: Sequence[ProbeObservations],
    *,
    settings: FitSettings = FitSettings(),
    cache: Cache | None = None,
    progress: Progress = silent,
) -> list[ProbeObservations]:
    """Observations with the errors of the given mesh's model between vertices and along sharp
    edges, as large as the steps to other meshes.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    observations : sequence of k ProbeObservations    `ungraded_observations` of it, in this order
    settings : FitSettings
    cache : Cache or None                 folder in which what is computed of the body is kept
    progress : callable                   called with the current step (text) and the fraction done

    Returns
    -------
    list of k ProbeObservations           unchanged where the mesh is so large that its integrals
                                          are compressed: four times as many vertices reduce the
                                          error between them to a tenth

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `converged_observations`
    """
    stepped = list(observations)
    meshes = compared_meshes(session, cache=cache)
    for number, (name, compared_session, rings) in enumerate(meshes):
        _, compared = ungraded_observations(
            compared_session,
            settings=replace(settings, method=FitMethod.REDUCED.value),
            rings=rings,
            cache=cache,
            progress=part_of(
                progress, number / len(meshes), (number + 1) / len(meshes), prefix=f"{name}, "
            ),
        )
        for k, other in enumerate(compared):
            probe = stepped[k]
            step = model_step(_STEPS[name], 1.0, probe.response_terms, other.response_terms)
            stepped[k] = replace(probe, nuisances=(*probe.nuisances, step))
    return stepped


def compared_meshes(
    session: Session, *, cache: Cache | None = None
) -> list[tuple[str, Session, int]]:
    """The meshes and fits between vertices with which the model of the given mesh is compared.

    Parameters
    ----------
    session : Session
    cache : Cache or None                 as for `session_surface`

    Returns
    -------
    list of (name, Session, int)          "wider fits" and "finer edges", each with the rings of its
                                          fits; without the latter where the mesh has no sharp
                                          edges, without those that are too large for dense matrices
    """
    refined = edge_refined_session(session, cache=cache)
    meshes = [("wider fits", session, 2)]
    if len(refined.mesh.vertices) > len(session.mesh.vertices):
        meshes.append(("finer edges", refined, 1))
    return [compared for compared in meshes if len(compared[1].mesh.vertices) <= LARGEST_DENSE]


def graded_observations(session: Session) -> list[ProbeObservations]:
    """Observations as a fit takes them: with the graded mesh's model and the errors of that mesh.

    Parameters
    ----------
    session : Session                     k probings, each with displacements

    Returns
    -------
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `converged_observations`
    """
    _, ungraded = ungraded_observations(session)
    ungraded = with_mesh_steps(session, ungraded)
    graded = graded_session(session)
    return converged_observations(graded, make_object_model(graded), coarser=ungraded)


def _session_observations_at(
    session: Session,
    model: ObjectModel,
    *,
    settings: FitSettings = FitSettings(),
    with_surface: bool = False,
    residual: float = DENSE_RESIDUAL,
) -> Callable[[float], list[ProbeObservations]]:
    """As `session_observations`, for any shear modulus [Pa], from one factorisation."""
    every = range(len(session.probings))
    if model.springs is not None:
        rows = _rows(session, model, every, with_surface=with_surface)
        on_springs = spring_responses(model, model.springs, list(chain(*rows)), settings)
        return lambda modulus: _all_observations(session, model, on_springs(modulus), modulus)
    if settings.method == FitMethod.NELDER_MEAD:
        rows = _rows(session, model, every, with_surface=with_surface)
        responses = full_responses(
            lambda ratio: model.solver.at(ratio)(model.right.at(ratio)), list(chain(*rows))
        )
    else:
        parts: tuple[list[ProbeResponse], ...] = [], []
        for group in _groups(model):
            needed = [probe_columns(model, k)[0] for k in group]
            columns = None if len(group) == len(every) else np.unique(np.concatenate(needed))
            reduced = reduced_model_of(model, settings=settings, residual=residual, columns=columns)
            rows = _rows(session, model, group, with_surface=with_surface)
            for part, matrices in zip(parts, rows, strict=True):
                part += reduced_responses(
                    reduced, matrices, settings.poisson_range, columns=columns
                )
        responses = [*parts[0], *parts[1]]
    return lambda modulus: _all_observations(session, model, responses, modulus)


def _groups(model: ObjectModel) -> list[range]:
    """Probings of which a reduced model is made at once: what it takes of all of them would be most
    of what a fit of many needs."""
    count, most = len(model.session.probings), model.solver.together
    if most is None:
        return [range(count)]
    size = max(1, most // max(len(probe_columns(model, k)[0]) for k in range(count)))
    return [range(first, min(first + size, count)) for first in range(0, count, size)]


def _rows(
    session: Session, model: ObjectModel, chosen: Iterable[int], *, with_surface: bool
) -> tuple[Iterator[ObservationMatrix], Iterator[ObservationMatrix]]:
    """Observation matrices of some probings' points; and, where needed, of all vertices."""
    probings, errors = session.probings, session.errors
    fields = ((k, _measured(probings[k])) for k in chosen)
    points = (probe_rows(model, k, x.surface, average=x.average) for k, x in fields)
    needed = with_surface or errors.pose_translation > 0.0 or errors.pose_rotation > 0.0
    every = _vertices(session.mesh)
    return points, (probe_rows(model, k, every, perturbed=False) for k in chosen if needed)


def _all_observations(
    session: Session,
    model: ObjectModel,
    responses: Sequence[ProbeResponse],
    shear_modulus: float,
) -> list[ProbeObservations]:
    """Observations of each probing; the first responses are those of the probings' points, further
    ones, if any, those of all vertices."""
    at_points = responses[: len(session.probings)]
    vertices = responses[len(session.probings) :] or at_points
    support = session.mesh.vertices[np.unique(session.mesh.triangles[session.held_triangles])]
    changes = _pose_changes(session, model)
    observations = []
    for k, (response, nodal) in enumerate(zip(at_points, vertices, strict=True)):
        nuisances = shared_errors(model, k, response, changes[k], nodal.value)
        probe = _observations(session, model, k, response, support, nuisances)
        probe = replace(probe, vertices=None if nodal is response else nodal)
        if model.springs is not None:
            probe = replace(probe, settlement=settlement(model, response, shear_modulus))
        observations.append(probe)
    return observations


def _pose_changes(session: Session, model: ObjectModel) -> list[PoseChanges | None]:
    """`pose_changes` of every probing's points, computed once for points common to several."""
    surfaces = [_measured(probing).surface for probing in session.probings]
    every, numbers = distinct_points(surfaces)
    changes = pose_changes(model, every)
    return [None if changes is None else changes.at(number) for number in numbers]


def _vertices(mesh: TriangleMesh) -> SurfacePoints:
    """All vertices as points of the surface."""
    corner = np.zeros(len(mesh.vertices), dtype=np.int64)
    corner[mesh.triangles.ravel()] = np.arange(mesh.triangles.size)
    triangle, corner_index = np.divmod(corner, 3)
    return SurfacePoints(triangle, np.eye(3)[corner_index], mesh.vertices, np.zeros(len(corner)))


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
    return ProbeObservations(
        name=probing.name,
        position=field.points,
        displacement=field.displacement,
        std=field.std,
        covariance=field.covariance,
        correlation=field.correlation,
        force=probing.force,
        force_std=session.force_std(probing),
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
            motion = given_motion(session, session.probings[index], support)
            value.append(motion.value)
            std.append(motion.std)
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
        steps = (nuisance for nuisance in coarse.nuisances if nuisance.parameters[0].is_model_error)
        with_errors.append(replace(probe, nuisances=(*probe.nuisances, error, *steps)))
    return with_errors
