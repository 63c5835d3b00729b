"""From a session to its elastic constants: the one place where probe, boundary elements and
estimation meet."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, hstack, kron

from palpate.bem import (
    BodyForce,
    BoundarySystem,
    ContactShape,
    PointEquations,
    PressureDisc,
    RightHand,
    SurfaceLoad,
    SurfaceSettings,
    assemble_system,
    body_force_columns,
    cached_system,
    check_memory,
    joined,
    load_right_hand,
    load_shape,
    make_surface,
    point_equations,
)
from palpate.errors import InputError
from palpate.estimation import (
    FitMethod,
    FitResult,
    FitSettings,
    PointRows,
    ProbeObservations,
    ProbeResponse,
    ProbeRows,
    fit,
    full_responses,
    make_reduced_model,
    reduced_response,
)
from palpate.geometry import interpolation_matrix
from palpate.probe import ContactPatch, find_contact_patch
from palpate.progress import Progress, part_of, silent
from palpate.records import DisplacementField, Probing, Session, require_probings
from palpate.shapes import Vertices

# Fraction of the work that is done when the estimation starts.
_FIT_STARTS = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class ContactPoints:
    """Integral equations for the displacement of the contact points themselves.

    Attributes
    ----------
    equations : PointEquations            of every patch
    right : RightHand                     the same columns as those of the system
    """

    equations: PointEquations
    right: RightHand


@dataclass(frozen=True, slots=True, eq=False)
class ObjectModel:
    """Boundary element model of a session's object with the loads of its probings.

    Attributes
    ----------
    system : BoundarySystem
    patches : tuple of p ContactPatch     distinct contacts
    patch_of : (k,) int                   which of them each probing has
    right : RightHand                     three columns a contact, then two of gravity, if any
    body : BodyForce or None
    tips : ContactPoints or None          None where no tip was measured
    """

    system: BoundarySystem
    patches: tuple[ContactPatch, ...]
    patch_of: Int[np.ndarray, " k"]
    right: RightHand
    body: BodyForce | None
    tips: ContactPoints | None


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
    scale_error = max(_measured(probing).scale_error for probing in session.probings)
    settings = replace(
        settings, displacement_error=float(np.hypot(settings.displacement_error, scale_error))
    )
    progress("integrals over the surface", 0.0)
    model = make_object_model(session, surface=surface, cache=cache)
    assembled = time.perf_counter()
    progress("factorisation", 0.5)
    observations = session_observations(session, model, settings=settings)
    factorised = time.perf_counter()
    result = fit(observations, settings=settings, progress=part_of(progress, _FIT_STARTS, 1.0))
    progress("done", 1.0)
    seconds = {
        "assembly": assembled - start,
        "factorisation": factorised - assembled,
        **result.estimate.seconds,
        "total": time.perf_counter() - start,
    }
    kept = {**result.estimate.settings, "surface": asdict(surface)}
    return replace(result, estimate=replace(result.estimate, seconds=seconds, settings=kept))


def make_object_model(
    session: Session,
    *,
    surface: SurfaceSettings = SurfaceSettings(),
    cache: Path | None = None,
) -> ObjectModel:
    """Compute all integrals of a session's object, its contacts and its weight.

    Parameters
    ----------
    session : Session
    surface : SurfaceSettings
    cache : Path or None              folder that keeps the integrals for the next time

    Returns
    -------
    ObjectModel

    Raises
    ------
    InputError                        the model does not fit into memory, a bad contact
    """
    check_memory(len(session.mesh.vertices))
    patches, patch_of = _distinct_patches(session)
    boundary = make_surface(session.mesh, session.held_triangles, settings=surface)
    system = assemble_system(boundary) if cache is None else cached_system(boundary, cache)
    loads = [surface_load(patch) for patch in patches]
    shapes = [load_shape(boundary, load) for load in loads]
    weight = None
    if session.gravity is not None and session.density is not None:
        weight = session.density * session.gravity
    right, body = _right_hand(system, loads, shapes, weight)
    tips = None
    if any(probing.tip_displacement is not None for probing in session.probings):
        equations = point_equations(
            system,
            np.array([patch.triangle for patch in patches]),
            np.array([patch.barycentric for patch in patches]),
        )
        tips = ContactPoints(equations, _right_hand(equations.system, loads, shapes, weight)[0])
    return ObjectModel(system, patches, patch_of, right, body, tips)


def _right_hand(
    system: BoundarySystem,
    loads: Sequence[SurfaceLoad],
    shapes: Sequence[ContactShape | None],
    weight: Float[np.ndarray, "3"] | None,
) -> tuple[RightHand, BodyForce | None]:
    """Columns of all loads and of the weight [N/m^3], if any."""
    right = load_right_hand(system, loads, shapes)
    if weight is None:
        return right, None
    body = body_force_columns(system, weight)
    return joined([right, body.right]), body


def session_observations(
    session: Session, model: ObjectModel, *, settings: FitSettings = FitSettings()
) -> list[ProbeObservations]:
    """What each probing saw, with what the model says it should have seen.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    model : ObjectModel                   of this session
    settings : FitSettings                method and range of Poisson's ratio

    Returns
    -------
    list of k ProbeObservations

    Raises
    ------
    InputError                            a probing without displacements
    SingularSystemError                   the support does not hold the object
    NotConvergedError                     the reduced model does not serve the range
    """
    rows = [
        _rows(model, probing, int(patch))
        for probing, patch in zip(session.probings, model.patch_of, strict=True)
    ]
    if settings.method == FitMethod.NELDER_MEAD:
        responses = full_responses(model.system, model.right, rows)
    else:
        reduced = make_reduced_model(
            model.system, model.right, poisson_range=settings.poisson_range
        )
        responses = [reduced_response(reduced, row) for row in rows]
    support = session.mesh.vertices[np.unique(session.mesh.triangles[session.held_triangles])]
    return [
        _observations(probing, response, support)
        for probing, response in zip(session.probings, responses, strict=True)
    ]


def surface_load(patch: ContactPatch) -> SurfaceLoad:
    """A contact patch as a load of the boundary element model.

    Parameters
    ----------
    patch : ContactPatch

    Returns
    -------
    SurfaceLoad
    """
    disc = None
    if patch.contact.radius is not None:
        disc = PressureDisc(patch.contact.point, patch.contact.radius, patch.pressure)
    return SurfaceLoad(patch.triangles, patch.density, disc)


def _distinct_patches(session: Session) -> tuple[tuple[ContactPatch, ...], Int[np.ndarray, " k"]]:
    """Every contact once, and which of them each probing has."""
    patches: dict[tuple[object, ...], ContactPatch] = {}
    keys = []
    for probing in session.probings:
        contact = probing.contact
        key = (*contact.point.tolist(), contact.radius, contact.profile)
        keys.append(key)
        if key not in patches:
            patches[key] = find_contact_patch(
                session.mesh, contact, session.held_triangles, name=probing.name
            )
    order = list(patches)
    return tuple(patches.values()), np.array([order.index(key) for key in keys])


def _rows(model: ObjectModel, probing: Probing, patch: int) -> ProbeRows:
    columns = 3 * patch + np.arange(3)
    if model.body is not None:
        columns = np.concatenate([columns, 3 * len(model.patches) + np.arange(2)])
    place = _measured(probing).surface
    nodes = model.system.surface.displacement
    at_points = interpolation_matrix(nodes, place.triangle, place.barycentric)
    particular = np.zeros(3 * place.triangle.size)
    if model.body is not None:
        particular = (at_points @ model.body.particular).ravel()
    free = at_points[:, model.system.unknowns.free_vertices]
    rest = csr_array((particular.size, model.system.size - 3 * free.shape[1]))
    surface = csr_array(hstack([kron(free, np.eye(3)), rest]))
    tip = None
    if probing.tip_displacement is not None and model.tips is not None:
        tip = _tip_rows(model, model.tips, patch, columns)
    return ProbeRows(columns, surface, particular, tip)


def _tip_rows(
    model: ObjectModel, tips: ContactPoints, patch: int, columns: Int[np.ndarray, " c"]
) -> PointRows:
    right = [tips.equations.by_point(part)[patch][:, columns] for part in tips.right.terms]
    particular = np.zeros(3)
    if model.body is not None:
        contact = model.patches[patch]
        nodes = model.system.surface.displacement
        at_tip = interpolation_matrix(
            nodes, np.array([contact.triangle]), contact.barycentric[None]
        )
        particular = (at_tip @ model.body.particular)[0]
    return PointRows(
        tips.equations.matrix[:, patch], tips.equations.own[:, patch], np.stack(right), particular
    )


def _observations(
    probing: Probing, response: ProbeResponse, support: Vertices
) -> ProbeObservations:
    field = _measured(probing)
    return ProbeObservations(
        name=probing.name,
        position=field.points,
        displacement=field.displacement,
        std=field.std,
        force=probing.force,
        force_std=np.zeros(3) if probing.force_std is None else probing.force_std,
        tip_displacement=probing.tip_displacement,
        tip_displacement_std=probing.tip_displacement_std,
        response=response,
        landmarks={"the contact": probing.contact.point[None], "the support": support},
    )


def _measured(probing: Probing) -> DisplacementField:
    """The displacements of a probing, which must be there."""
    if probing.displacement is None:
        raise InputError(
            f"probing '{probing.name}' has no measured displacement and no images; give one of"
            " them, or leave it out with --probe"
        )
    return probing.displacement
