"""From a session to its elastic constants: the one place where probe, boundary elements and
estimation meet."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.bem import SurfaceSettings
from palpate.errors import InputError, NotConvergedError
from palpate.estimation import (
    Discretisation,
    FitMethod,
    FitResult,
    FitSettings,
    Nuisance,
    ProbeFit,
    ProbeObservations,
    ProbeResponse,
    SpringResponse,
    best_constants_of,
    fit,
    full_responses,
    make_reduced_model,
    reduced_response,
)
from palpate.geometry import SurfacePoints, TriangleMesh, bounding_diagonal
from palpate.pipeline.model import (
    LEFT_OF_STEP,
    ObjectModel,
    free_std,
    given_motion,
    graded_session,
    make_object_model,
    pose_changes,
    probe_rows,
    settlement,
    shared_errors,
    spring_responses,
)
from palpate.progress import Progress, part_of, silent
from palpate.records import (
    EXACT,
    GIVEN,
    DisplacementField,
    ProbeEstimate,
    Probing,
    Session,
    SupportEstimate,
    require_probings,
)
from palpate.shapes import Vertices

# Fraction of the work that is done when the estimation starts.
_FIT_STARTS = 0.8
# Where supports give: how often the modulus about which the model is taken is found anew, the
# change of its logarithm that ends this (what it leaves is of its square), and the longest step.
_SETTLING_ROUNDS, _SETTLED, _LONGEST_STEP = 12, 1e-3, 5.0
# A turn [rad] that leaves a false strain of 1e-5 is mentioned.
_LARGE_TURN = 5e-3


def fit_session(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    surface: SurfaceSettings = SurfaceSettings(),
    cache: Path | None = None,
    progress: Progress = silent,
) -> FitResult:
    """Estimate the elastic constants of a session's object.

    Parameters
    ----------
    session : Session                 every probing with a displacement
    settings : FitSettings            how the constants are searched and their intervals found
    surface : SurfaceSettings         how the surface between the vertices is understood
    cache : Path or None              folder that keeps the integrals for the next time
    progress : callable               told what is done (text) and how far it is (0 to 1)

    Returns
    -------
    FitResult                         its estimate with the seconds of every stage, and all settings

    Raises
    ------
    InputError                        a probing without displacements, a bad contact
    SingularSystemError               the support does not hold the object
    """
    start = time.perf_counter()
    require_probings(session)
    progress("the given mesh", 0.0)
    # First, and gone before the graded one takes its memory.
    plain = replace(session, errors=EXACT)
    coarser = settled_observations(
        plain, make_object_model(plain, surface=surface, cache=cache), settings=settings
    )
    compared = time.perf_counter()
    progress("integrals over the surface", 0.25)
    graded = graded_session(session, surface=surface)
    model = make_object_model(graded, surface=surface, cache=cache)
    assembled = time.perf_counter()
    progress("factorisation", 0.5)
    observations = settled_observations(graded, model, settings=settings, coarser=coarser)
    factorised = time.perf_counter()
    result = fit(observations, settings=settings, progress=part_of(progress, _FIT_STARTS, 1.0))
    progress("done", 1.0)
    seconds = {
        "given_mesh": compared - start,
        "assembly": assembled - compared,
        "factorisation": factorised - assembled,
        **result.estimate.seconds,
        "total": time.perf_counter() - start,
    }
    probes = tuple(
        replace(one, supports=_support_estimates(model, k, result.probes[k]))
        for k, one in enumerate(result.estimate.probes)
    )
    estimate = replace(
        result.estimate,
        probes=probes,
        notes=(*result.estimate.notes, *_turn_notes(probes)),
        seconds=seconds,
        settings={
            **result.estimate.settings,
            "surface": asdict(surface),
            "errors": asdict(session.errors),
            "vertices": [len(one.mesh.vertices) for one in (session, graded)],
            "assumed_forces": [one.name for one in session.probings if one.force_std is None],
        },
    )
    return replace(result, estimate=estimate)


def settled_observations(
    session: Session,
    model: ObjectModel,
    *,
    settings: FitSettings = FitSettings(),
    coarser: Sequence[ProbeObservations] = (),
) -> list[ProbeObservations]:
    """What each probing saw, with what the model says at the modulus that fits it best, where
    supports give and the model depends on it.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    model : ObjectModel                   of this session
    settings : FitSettings
    coarser : sequence of k ProbeObservations, or none    the same on a coarser mesh: the error of
                                          the mesh is added

    Returns
    -------
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `session_observations`; the springs
                                          explain the motion alone, so no modulus fits best
    """
    make = session_observations_at(session, model, settings=settings)
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
    return [
        replace(one, nuisances=(*one.nuisances, Discretisation(LEFT_OF_STEP, other.response_at)))
        for one, other in zip(observations, coarser, strict=True)
    ]


def _turn_notes(probes: Sequence[ProbeEstimate]) -> list[str]:
    """Sentences about turns that are not small."""
    notes = []
    for probe in probes:
        for support in probe.supports:
            turn = float(np.linalg.norm(support.rotation))
            if turn > _LARGE_TURN:
                notes.append(
                    f"Support {support.support} turned by {turn:.2g} rad in probing {probe.name!r}."
                    " Displacements are taken as linear in the turn, which leaves a false strain of"
                    f" {0.5 * turn**2:.1g} across its axis: where that counts, turn the measured"
                    " displacements back first."
                )
    return notes


def _support_estimates(
    model: ObjectModel, index: int, found: ProbeFit
) -> tuple[SupportEstimate, ...]:
    """How the supports moved in a probing; the shifts of one that is pulled are not estimated."""
    lifts = model.lifts(index)
    left = [j for j in range(6 * len(model.supports)) if j not in lifts]
    value, std = np.full((2, 6 * len(model.supports)), np.nan)
    value[left], std[left] = found.motion[: len(left)], found.motion_std[: len(left)]
    estimates = []
    for support, moved, error in zip(
        model.supports, value.reshape(-1, 2, 3), std.reshape(-1, 2, 3), strict=True
    ):
        parts = (tuple(part.tolist()) for part in (moved[0], error[0], moved[1], error[1]))
        estimates.append(SupportEstimate(support.number, *parts))
    return tuple(estimates)


def session_observations(
    session: Session,
    model: ObjectModel,
    *,
    settings: FitSettings = FitSettings(),
    shear_modulus: float = 1.0,
) -> list[ProbeObservations]:
    """What each probing saw, with what the model says it should have seen.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    model : ObjectModel                   of this session
    settings : FitSettings                method and range of Poisson's ratio
    shear_modulus : float [Pa]            about which the model is taken; it counts only where a
                                          support has a stiffness

    Returns
    -------
    list of k ProbeObservations

    Raises
    ------
    InputError                            a probing without displacements
    SingularSystemError                   the support does not hold the object
    NotConvergedError                     the reduced model does not serve the range
    """
    return session_observations_at(session, model, settings=settings)(shear_modulus)


def session_observations_at(
    session: Session, model: ObjectModel, *, settings: FitSettings = FitSettings()
) -> Callable[[float], list[ProbeObservations]]:
    """The same for any modulus, from one factorisation.

    Parameters
    ----------
    session : Session
    model : ObjectModel
    settings : FitSettings

    Returns
    -------
    function                              shear modulus [Pa] -> list of ProbeObservations
    """
    rows = [
        probe_rows(model, k, _measured(probing).surface)
        for k, probing in enumerate(session.probings)
    ]
    with_pose = session.errors.pose_translation > 0.0 or session.errors.pose_rotation > 0.0
    if with_pose:
        every = _vertices(session.mesh)
        rows += [probe_rows(model, k, every, nominal=True) for k in range(len(session.probings))]
    if model.springs is not None:
        on_springs = spring_responses(model, model.springs, rows, settings)
        return lambda modulus: _all_observations(session, model, on_springs(modulus), modulus)
    if settings.method == FitMethod.NELDER_MEAD:
        responses = full_responses(model.system, model.right, rows)
    else:
        reduced = make_reduced_model(
            model.system, model.right, poisson_range=settings.poisson_range
        )
        responses = [reduced_response(reduced, row) for row in rows]
    return lambda modulus: _all_observations(session, model, responses, modulus)


def _all_observations(
    session: Session,
    model: ObjectModel,
    responses: Sequence[ProbeResponse | SpringResponse],
    shear_modulus: float,
) -> list[ProbeObservations]:
    """What each probing saw; behind the responses of its points may be those of all vertices."""
    own = responses[: len(session.probings)]
    vertices = responses[len(session.probings) :] or own
    support = session.mesh.vertices[np.unique(session.mesh.triangles[session.held_triangles])]
    changes: dict[bytes, list[csr_array]] = {}
    observations = []
    for k, (response, nodal) in enumerate(zip(own, vertices, strict=True)):
        field = _measured(session.probings[k])
        # Probings often have the same points.
        key = field.surface.position.tobytes()
        changes[key] = changes.get(key) or pose_changes(model, field.surface)
        nuisances = shared_errors(model, k, response, changes[key], nodal.value, field.scale_error)
        seen = _observations(session, model, k, response, support, nuisances)
        if isinstance(response, SpringResponse):
            seen = replace(seen, settlement=settlement(model, response, shear_modulus))
        observations.append(seen)
    return observations


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
    response: ProbeResponse | SpringResponse,
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
        force=probing.force,
        force_std=force_std,
        tip_displacement=probing.tip_displacement,
        tip_displacement_std=probing.tip_displacement_std,
        response=response,
        landmarks={"the contact": probing.contact.point[None], "the support": support},
        motion=motion,
        motion_std=motion_std,
        nuisances=nuisances,
    )


def _motions(
    session: Session, model: ObjectModel, index: int
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    """What is known before about the motions of the supports, and how well."""
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
    left = [j for j in range(6 * len(value) + strains.size) if j not in model.lifts(index)]
    return (
        np.concatenate([*value, strains])[left],
        np.concatenate([*std, 0.0 * strains])[left],
    )


def _measured(probing: Probing) -> DisplacementField:
    """The displacements of a probing, which must be there."""
    if probing.displacement is None:
        raise InputError(
            f"probing '{probing.name}' has no measured displacement and no images; give one of"
            " them, or leave it out with --probe"
        )
    return probing.displacement
