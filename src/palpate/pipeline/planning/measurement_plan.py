"""The expected precision of a measurement before it is made.

The cameras' pictures are rendered for an object that moves according to guessed constants, with the
tool and its shadow. They are tracked like the pictures of a session, and the Fisher information of
the resulting points follows from the model of the fit. Whatever hides, darkens or blurs the surface
costs points here as in the measurement.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, UInt

from palpate.errors import InputError
from palpate.estimation import Information, fisher_information
from palpate.geometry import bounding_diagonal, closest_points
from palpate.lab import Material, Pictures, Variant, planned_pictures
from palpate.pipeline.calibrated_space import calibration_strains, with_stretch
from palpate.pipeline.model.contacts.contact_radii import with_contact_radii
from palpate.pipeline.model.grading import refined_session
from palpate.pipeline.model.object_model import make_object_model
from palpate.pipeline.motion.displacement import vertex_field
from palpate.pipeline.observations.mesh_errors import graded_observations
from palpate.pipeline.observations.session_observations import session_observations
from palpate.progress import Progress, part_of, silent
from palpate.records import (
    BudgetEntry,
    DisplacementField,
    Probing,
    Rig,
    Session,
    picture_size,
    read_rig,
    require_probings,
)
from palpate.shapes import Vector3, Vertices
from palpate.vision import JointFlow, measured_vertices, surface_map, visible

# Depth behind the rendered surface up to which a vertex counts as visible, over the object's size.
_DEPTH_TOLERANCE = 2e-3
# Fractions of the work that are done when rendering starts, and when all points are tracked.
_PICTURES, _POINTS = 0.1, 0.8
# Called with the name and the grey levels of a picture.
Show = Callable[[str, UInt[np.ndarray, "_ _"]], None]
# Accepted range, from the softest gel to diamond [Pa].
_YOUNG_RANGE = (1.0, 1.2e12)


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
    report = part_of(progress, _PICTURES, _POINTS)
    report("texture and light", 0.0)
    fields = _followed(session, rig, taken, show, report)
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
