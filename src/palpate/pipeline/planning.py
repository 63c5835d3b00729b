"""What to measure, and what to expect of it, before it is measured: the expected precision of a
measurement, and the most informative next places, given what is measured already.

The cameras' pictures are rendered for an object that moves according to guessed constants, with the
tool and its shadow. They are tracked like the pictures of a session, and the Fisher information of
the resulting points follows from the model of the fit. Whatever hides, darkens or blurs the surface
costs points here as in the measurement.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, UInt

from palpate.checkpoints import Cache
from palpate.errors import InputError
from palpate.estimation import Information, ProbeObservations, fisher_information
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    closest_points,
)
from palpate.lab import Material, Pictures, Variant, planned_pictures
from palpate.pipeline.contacts import with_contact_radii
from palpate.pipeline.fit_session import fit_session
from palpate.pipeline.heterogeneous import FittedBody, Material as Substance, fitted_body
from palpate.pipeline.model.grading import refined_session
from palpate.pipeline.model.object_model import make_object_model
from palpate.pipeline.model.shared_errors import calibration_strains, with_stretch
from palpate.pipeline.motion.displacement import vertex_field
from palpate.pipeline.observations import graded_observations, session_observations
from palpate.pipeline.places import MOST_PLACES, reachable_places
from palpate.progress import Progress, part_of, silent
from palpate.records import (
    BudgetEntry,
    DisplacementField,
    Estimate,
    Probing,
    Rig,
    Session,
    lengths,
    observed_rows,
    picture_size,
    read_rig,
    require_probings,
)
from palpate.shapes import Points, Vector3, Vertices
from palpate.vision import JointFlow, measured_vertices, surface_map, visible

# Depth behind the rendered surface up to which a vertex counts as visible, over the object's size.
_DEPTH_TOLERANCE = 2e-3
# Fractions of the work that are done when rendering starts, and when all points are tracked.
_PICTURES, _POINTS = 0.1, 0.8
# Called with the name and the grey levels of a picture.
Show = Callable[[str, UInt[np.ndarray, "_ _"]], None]
# Accepted range, from the softest gel to diamond [Pa].
_YOUNG_RANGE = (1.0, 1.2e12)
# The tool hides the surface within this distance, in contact radii.
_HIDDEN_RADII = 2.0
_Further = tuple[Probing, ProbeObservations]
# Poisson's ratios that are tried where the constants are only to be known roughly.
_RATIOS = (0.05, 0.2, 0.35, 0.48)
# In `NextProbings`, beside the constants.
PREDICTION = "prediction"


@dataclass(frozen=True, slots=True)
class PlannedProbing:
    """The expected precision of one probing alone.

    Attributes
    ----------
    name : str
    seen : int                      vertices whose displacement can be measured in the pictures
    displacement : float [m]        median of |u| there
    sigma : float [m]               median standard deviation of a component there
    precision : name -> float       standard deviation of each constant; infinite where the probing
                                    alone does not determine it
    """

    name: str
    seen: int
    displacement: float
    sigma: float
    precision: dict[str, float]


@dataclass(frozen=True, slots=True)
class MeasurementPlan:
    """The expected precision of a session.

    Attributes
    ----------
    probings : tuple of PlannedProbing
    precision : name -> float       standard deviation of each constant from all probings together
    visible : name -> float         fraction of the free vertices that each camera sees
    budget : tuple of BudgetEntry   contributions to these standard deviations, by source
    """

    probings: tuple[PlannedProbing, ...]
    precision: dict[str, float]
    visible: dict[str, float]
    budget: tuple[BudgetEntry, ...]


def plan_measurement(
    session: Session,
    *,
    young_modulus: float,
    poisson_ratio: float,
    variant: Variant,
    pictures: Pictures = Pictures(),
    show: Show | None = None,
    progress: Progress = silent,
) -> MeasurementPlan:
    """The expected precision of a session whose pictures are still to be taken.

    The object is assumed to obey the model: errors from a wrong support, a wrong mesh or another
    material are not included.

    Parameters
    ----------
    session : Session               with a rig; its displacements and pictures are ignored
    young_modulus : float [Pa]      a guess, 1 to 1.2e12; precision is nearly proportional to it
    poisson_ratio : float [-]       a guess, -1 < nu < 0.5
    variant : Variant               of Mitsuba
    pictures : Pictures             settings of the cameras and their pictures
    show : callable or None         called with name and grey levels of every picture; names are
                                    `rest_c0`, `n01_c0` and so on
    progress : callable             called with the current step (text) and the fraction done

    Returns
    -------
    MeasurementPlan

    Raises
    ------
    InputError                      a session without a rig or without probings; constants out of
                                    range; cameras without sizes; no vertex that two cameras see, or
                                    that can be tracked
    RecordError, CalibrationError   the rig cannot be read, or contradicts itself
    SingularSystemError, NotConvergedError    as in `graded_observations`
    """
    _check(session, young_modulus, poisson_ratio)
    rig = read_rig(session.rig or session.path)
    is_visible = _visibility(session, rig)
    if not (is_visible.sum(axis=0) >= 2).any():
        raise InputError(
            f"{session.rig}: no vertex of the object is seen by two cameras; turn them to the"
            " object"
        )
    material = Material(young_modulus, poisson_ratio)
    progress("how the object will move", 0.0)
    moved = _moved(session, material)
    taken = planned_pictures(
        session, [u for u, _ in moved], material=material, pictures=pictures, variant=variant
    )
    stage_progress = part_of(progress, _PICTURES, _POINTS)
    stage_progress("texture and light", 0.0)
    fields = _followed(session, rig, taken, show, stage_progress)
    measured = _measured(session, fields, [tip for _, tip in moved])
    progress("what the points tell", _POINTS)
    information = _information(measured, material)
    free = np.setdiff1d(
        np.arange(len(session.mesh.vertices)),
        session.mesh.triangles[session.held_triangles].ravel(),
    )
    return MeasurementPlan(
        tuple(
            _planned(probing, information.bound([k])) for k, probing in enumerate(measured.probings)
        ),
        information.bound(range(len(measured.probings))),
        {camera.name: float(is_visible[c, free].mean()) for c, camera in enumerate(rig.cameras)},
        information.budget,
    )


@dataclass(frozen=True, slots=True, eq=False)
class NextProbings:
    """Places for further probings, and the precision to expect with them.

    Attributes
    ----------
    session : Session               with the probings measured so far
    force : float [N]               of every further probing, along the inward normal
    radius : float [m]              of its contact
    point : (c, 3) float [m]        places that a tool can reach
    inward : (c, 3) float [-]       unit inward normals there
    now : name -> float             standard deviations of the constants from the measured probings;
                                    and of predicted displacements, relative, `PREDICTION`, where
                                    the body is not the same everywhere
    alone : tuple of name -> float  the same with one of the c places added
    chosen : tuple of int           indices of the best places, best first
    after : tuple of name -> float  the same with each chosen place and those before it
    information : Information       of the session's probings, then of the places
    further : tuple of c Probing, ProbeObservations     at the places, as one uniform body has them
    """

    session: Session
    force: float
    radius: float
    point: Points
    inward: Points
    now: dict[str, float]
    alone: tuple[dict[str, float], ...]
    chosen: tuple[int, ...]
    after: tuple[dict[str, float], ...]
    information: Information
    further: tuple[_Further, ...]


def plan_next(
    session: Session,
    *,
    count: int = 3,
    fitted: FittedBody | None = None,
    known: NextProbings | None = None,
    cache: Cache | None = None,
    progress: Progress = silent,
) -> NextProbings:
    """Find the most informative places for further probings, one at a time (greedy): of a body that
    is the same everywhere about its constants (D-optimal), of others about the displacements under
    a push at any of the places.

    A further probing has the contact of the first one, its points except those that the tool hides,
    and their standard deviations; its force is the median of the session's.

    Parameters
    ----------
    session : Session               with measured probings; the first under a round patch or a tool
    count : int                     number of places to choose, 1 to 40
    fitted : FittedBody or None     by the fit of this session; None: it is fitted first
    known : NextProbings or None    of the same object with fewer probings: what is left of its
                                    places is compared, without computing again how it moves there
    cache : Cache or None           folder in which what is computed of the body is kept for reuse
    progress : callable

    Returns
    -------
    NextProbings

    Raises
    ------
    InputError                      another count; no contact radius or displacement in the first
                                    probing; no place that a tool can reach
    SingularSystemError, NotConvergedError    as in `fit_session`

    Source
    ------
    Fedorov, Theory of Optimal Experiments (1972).
    """
    require_probings(session)
    if not 1 <= count <= MOST_PLACES:
        raise InputError(f"count is {count}; must be 1 to {MOST_PLACES}, as many as are compared")
    first = session.probings[0]
    if first.displacement is None or (first.contact.radius is None and first.contact.tool is None):
        raise InputError(
            f"{session.path}: probing '{first.name}' has no contact radius or no displacement:"
            " further probings are planned like the first one; put one first that has both (pokes"
            " without pictures are not planned)"
        )
    if fitted is None:
        stage_progress = part_of(progress, 0.0, 0.4)
        fit = fit_session(session, cache=cache, material=Substance.AUTO, progress=stage_progress)
        fitted = fitted_body(fit)
    session = _with_radii(session, fitted.estimate)
    radius = session.probings[0].contact.radius or 0.0
    measured = _measured_session(session, fitted.estimate)
    force = float(np.median([np.linalg.norm(probing.force) for probing in measured.probings]))
    progress("what every place tells", 0.4)
    further, observed = _at_places(measured, radius, force, known, cache)
    point = np.array([probing.contact.point for probing, _ in further])
    inward = np.array([probing.force / np.linalg.norm(probing.force) for probing, _ in further])
    every = replace(measured, probings=(*measured.probings, *(probing for probing, _ in further)))
    observed = [*observed, *(observations for _, observations in further)]
    information, is_uniform = _information_of(every, observed, fitted), fitted.field is None
    made = range(len(session.probings))

    def expected(places: Sequence[int]) -> dict[str, float]:
        pushes = [*made, *(len(made) + k for k in places)]
        bound = information.bound(pushes)
        if not is_uniform:
            others = range(len(made), len(made) + len(point))
            bound[PREDICTION] = information.prediction(pushes, others)
        return bound

    def gain(places: Sequence[int]) -> float:
        if is_uniform:
            return float(np.linalg.det(information.of([*made, *(len(made) + k for k in places)])))
        return -expected(places)[PREDICTION]

    chosen = _greedy(gain, len(point), min(count, len(point)))
    return NextProbings(
        session, force, radius, point, inward,
        now=expected([]),
        alone=tuple(expected([k]) for k in range(len(point))),
        chosen=tuple(chosen),
        after=tuple(expected(chosen[: n + 1]) for n in range(len(chosen))),
        information=information,
        further=further,
    )  # fmt: skip


def _with_radii(session: Session, estimate: Estimate) -> Session:
    modulus, ratio = estimate.shear_modulus.value, estimate.poisson_ratio.value
    return with_contact_radii(session, shear_modulus=modulus, poisson_ratio=ratio)


def _measured_session(session: Session, estimate: Estimate) -> Session:
    """The session with standard deviations, on a mesh that is resolved about its contacts only:
    about all places it would be the whole surface."""
    given = tuple(
        _with_std(probing, fit.rms_residual)
        for probing, fit in zip(session.probings, estimate.probes, strict=True)
    )
    return refined_session(replace(session, probings=given))


def _at_places(
    session: Session, radius: float, force: float, known: NextProbings | None, cache: Cache | None
) -> tuple[tuple[_Further, ...], list[ProbeObservations]]:
    """Further probings like the first at every place that a tool can reach, or those left of a
    known plan, with what is observed there; and the observations of the session's own probings."""
    if known is not None and (left := _left(known, session, radius)):
        return left, _observed(session, cache)
    point, inward = reachable_places(session, radius=radius)
    if not len(point):
        raise InputError("no place of the surface is left for a further probing of this radius")
    further = tuple(
        _like(session.probings[0], session.mesh, position, force * along, f"further {k}")
        for k, (position, along) in enumerate(zip(point, inward, strict=True))
    )
    made = len(session.probings)
    observed = _observed(replace(session, probings=(*session.probings, *further)), cache)
    return tuple(zip(further, observed[made:], strict=True)), observed[:made]


def _left(known: NextProbings, session: Session, radius: float) -> tuple[_Further, ...]:
    """The places of another plan at which nothing has been measured since."""
    taken = np.array([probing.contact.point for probing in session.probings])
    gap = np.linalg.norm(known.point[:, None] - taken, axis=2).min(axis=1)
    return tuple(known.further[k] for k in np.flatnonzero(gap > radius))


def _observed(session: Session, cache: Cache | None) -> list[ProbeObservations]:
    """Observations with the model of the session's mesh."""
    return session_observations(session, make_object_model(session, cache=cache))


def _information_of(
    session: Session, observed: Sequence[ProbeObservations], fitted: FittedBody
) -> Information:
    """Information of a session's probings, planned ones included."""
    if fitted.field is not None:
        observed = fitted.field.with_field(session, observed)
    return fisher_information(
        observed,
        poisson_ratio=fitted.estimate.poisson_ratio.value,
        shear_modulus=fitted.estimate.shear_modulus.value,
        errors=fitted.errors,
    )


def expected_precision(session: Session) -> dict[str, float]:
    """Smallest standard deviations that measured displacements allow: the bound of `plan_next`, on
    the mesh as it is, at constants that explain the displacements roughly.

    Parameters
    ----------
    session : Session               with probings, all of them measured

    Returns
    -------
    constant's name -> float        standard deviation of nu, those of G and E over their values;
                                    infinite where not identifiable

    Raises
    ------
    InputError                      a tool that pulls or is buried
    SingularSystemError, NotConvergedError    as in `session_observations`
    """
    size, moved = bounding_diagonal(session.mesh), _lengths(session)
    strongest = max(float(np.linalg.norm(probing.force)) for probing in session.probings)
    shear = strongest / (size * moved)
    has_tool = any(probing.contact.radius is None for probing in session.probings)
    for _ in range(2 if has_tool else 1):
        settled = with_contact_radii(session, shear_modulus=shear, poisson_ratio=_RATIOS[1])
        observed = session_observations(settled, make_object_model(settled), shear_modulus=shear)
        shear, ratio, rms = min(
            (_explaining(observed, nu) for nu in _RATIOS), key=lambda candidate: candidate[2]
        )
    known = [
        probe if probe.std is not None
        else replace(probe, std=np.full(probe.displacement.shape, rms))
        for probe in observed
    ]  # fmt: skip
    bound = fisher_information(known, poisson_ratio=ratio, shear_modulus=shear).bound(
        range(len(known))
    )
    young = 2.0 * shear * (1.0 + ratio)
    return bound | {
        "shear_modulus": bound["shear_modulus"] / shear,
        "young_modulus": bound["young_modulus"] / young,
    }


def _lengths(session: Session) -> float:
    """Typical displacement of the measured points [m]."""
    fields = (probing.displacement for probing in session.probings)
    length = [lengths(f.displacement[observed_rows(f)]) for f in fields if f is not None]
    return float(np.median(np.concatenate(length)))


def _explaining(observed: Sequence[ProbeObservations], ratio: float) -> tuple[float, float, float]:
    """Shear modulus [Pa] that explains displacements best by least squares at a Poisson's ratio,
    that ratio, and the RMS of what is left [m]."""
    parts = []
    for probe in observed:
        load = np.concatenate([probe.force, [1.0], probe.motion])
        measured = probe.displacement.ravel()
        rows = probe.response.value(ratio)[: len(measured), : len(load)] @ load
        known = np.isfinite(measured)
        parts.append((measured[known], rows[known]))
    measured, unit = (np.concatenate(column) for column in zip(*parts, strict=True))
    compliance = float(measured @ unit) / float(unit @ unit)
    left = float(np.sqrt(np.mean((measured - compliance * unit) ** 2)))
    return 1.0 / compliance, ratio, left


def _check(session: Session, young: float, poisson: float) -> None:
    require_probings(session)
    if session.rig is None:
        raise InputError(
            f'{session.path}: has no cameras; add [rig] cameras = "rig.toml" to plan pictures'
        )
    low, high = _YOUNG_RANGE
    if not (low <= young <= high and -1.0 < poisson < 0.5):
        raise InputError(
            f"young_modulus is {young:g} Pa, poisson_ratio {poisson:g}; must be {low:g} to"
            f" {high:g} Pa, from the softest gel to diamond, and in (-1, 0.5)"
        )


def _visibility(session: Session, rig: Rig) -> Bool[np.ndarray, "c v"]:
    """Which vertices each camera sees."""
    mesh = session.mesh
    tolerance = _DEPTH_TOLERANCE * bounding_diagonal(mesh)
    shown = []
    for camera in rig.cameras:
        surface = surface_map(camera, picture_size(camera)[::-1], mesh.vertices, mesh.triangles)
        shown.append(visible(surface, camera, mesh.vertices, tolerance=tolerance))
    return np.stack(shown)


def _moved(session: Session, material: Material) -> list[tuple[Vertices, Vector3 | None]]:
    """Displacement of the mesh's vertices in every probing [m], and of the contact point where the
    session has a tip displacement."""
    vertices = session.mesh.vertices
    still = DisplacementField(
        points=vertices,
        displacement=np.zeros_like(vertices),
        std=None,
        vertex=None,
        surface=closest_points(session.mesh, vertices),
        source="plan",
    )
    observed = replace(
        session,
        probings=tuple(replace(probing, displacement=still) for probing in session.probings),
    )
    shear, ratio = material.shear_modulus, material.poisson_ratio
    guessed = _at_guess(observed, material)
    moved = []
    for probe in session_observations(guessed, make_object_model(guessed), shear_modulus=shear):
        load = np.concatenate([probe.force / shear, [1.0 / shear], probe.motion])
        rows = (probe.response.value(ratio)[:, : load.size] @ load).reshape(-1, 3)
        tip = None if probe.tip_displacement is None else rows[len(vertices)]
        moved.append((rows[: len(vertices)], tip))
    return moved


def _followed(
    session: Session,
    rig: Rig,
    taken: Iterator[tuple[str, tuple[UInt[np.ndarray, "_ _"], ...]]],
    show: Show | None,
    progress: Progress,
) -> list[DisplacementField]:
    """Displacements tracked in the pictures of each probing; the first ones taken are at rest."""
    flow, fields, state = JointFlow(), [], None
    for number, (name, pictures) in enumerate(taken):
        for camera, picture in zip(rig.cameras, pictures, strict=True):
            if show is not None:
                show(f"{name}_{camera.name}", picture)
        progress(f"pictures of {name}", (number + 1) / (len(session.probings) + 1))
        grey = tuple(picture.astype(np.float32) for picture in pictures)
        if state is None:
            state = flow.start(rig, grey, session.mesh)
            continue
        vertices = flow.vertices(flow.follow(state, grey)[1], rig, session.mesh)
        followed = measured_vertices(vertices)
        if not followed.any():
            raise InputError(
                f"probing '{name}': no vertex could be followed in the pictures that are to be"
                " expected; turn the cameras, or press less deep"
            )
        rows = np.flatnonzero((vertices.count > 0) | followed)
        fields.append(vertex_field(session.mesh, vertices, rows, f"planned pictures of {name}"))
    return fields


def _measured(
    session: Session, fields: Sequence[DisplacementField], tips: Sequence[Vector3 | None]
) -> Session:
    """The session as if it had been measured."""
    probings = [
        replace(probing, displacement=field, images=None, tip_displacement=tip)
        for probing, field, tip in zip(session.probings, fields, tips, strict=True)
    ]
    return replace(session, probings=tuple(probings))


def _information(session: Session, material: Material) -> Information:
    """Fisher information of the points, with the model of a fit and all its errors."""
    shear, ratio = material.shear_modulus, material.poisson_ratio
    observed = graded_observations(_at_guess(session, material))
    with_reference = [
        replace(probe, reference="planned pictures at rest")
        for probe in with_stretch(observed, calibration_strains(session))
    ]
    return fisher_information(with_reference, poisson_ratio=ratio, shear_modulus=shear)


def _at_guess(session: Session, material: Material) -> Session:
    """The session on a mesh resolved for the model, with the contact radii of its tools."""
    return with_contact_radii(
        refined_session(session),
        shear_modulus=material.shear_modulus,
        poisson_ratio=material.poisson_ratio,
    )


def _planned(probing: Probing, precision: dict[str, float]) -> PlannedProbing:
    field = probing.displacement
    if field is None or field.std is None:
        raise InputError(f"probing '{probing.name}' has no displacement")
    return PlannedProbing(
        probing.name,
        int(np.isfinite(field.displacement).all(axis=1).sum()),
        float(np.nanmedian(np.linalg.norm(field.displacement, axis=1))),
        float(np.nanmedian(np.sqrt((field.std**2).mean(axis=1)))),
        precision,
    )


def _greedy(gain: Callable[[Sequence[int]], float], places: int, count: int) -> list[int]:
    """Places that gain most, one at a time."""
    chosen: list[int] = []
    for _ in range(count):
        left = [k for k in range(places) if k not in chosen]
        chosen.append(max(left, key=lambda k: gain([*chosen, k])))
    return chosen


def _with_std(probing: Probing, rms: float) -> Probing:
    """A probing with standard deviations; where none are given, the RMS of its residuals."""
    field = probing.displacement
    if field is None or field.std is not None:
        return probing
    return replace(probing, displacement=replace(field, std=np.full_like(field.displacement, rms)))


def _like(
    first: Probing, mesh: TriangleMesh, position: np.ndarray, force: np.ndarray, name: str
) -> Probing:
    """A probing like the first, at another place."""
    field, contact = first.displacement, first.contact
    if field is None or field.std is None:
        raise InputError(f"probing '{first.name}' has no displacement")
    distance = np.linalg.norm(field.points - position, axis=1)
    observed = distance > _HIDDEN_RADII * (contact.radius or 0.0)
    observed &= np.isfinite(field.displacement).any(axis=1)
    points = field.points[observed]
    no_motion = np.where(np.isfinite(field.displacement[observed]), 0.0, np.nan)
    planned = DisplacementField(
        points, no_motion, field.std[observed], None, closest_points(mesh, points), "plan",
    )  # fmt: skip
    force_std = first.force_std
    if force_std is not None:
        force_std = np.full(3, np.linalg.norm(force_std) / np.sqrt(3.0))
    return Probing(
        name, replace(contact, point=position), force, force_std, None, None, planned, None,
        force_sensor=first.force_sensor,
    )  # fmt: skip
