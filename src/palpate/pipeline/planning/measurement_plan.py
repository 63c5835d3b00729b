"""The precision to expect of a measurement before it is made: the smallest intervals that its
cameras, its force sensor and its probings allow."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from palpate.errors import InputError
from palpate.estimation import ProbeObservations, cramer_rao_bound
from palpate.geometry import bounding_diagonal, closest_points
from palpate.pipeline.measure_motion import SCALE_ERROR
from palpate.pipeline.model import make_object_model
from palpate.pipeline.observations import session_observations
from palpate.progress import Progress, silent
from palpate.records import (
    DisplacementField,
    Probing,
    Rig,
    Session,
    picture_size,
    read_rig,
    require_probings,
)
from palpate.shapes import Points
from palpate.vision import project_jacobian, surface_map, visible

# What a camera's match of a good speckle leaves at a vertex [px]; BENCHMARK.md has 0.005 to 0.02.
MATCHING_NOISE = 0.01
# Contact radii about the contact point within which the tool hides the surface.
_HIDDEN_RADII = 2.0
# How far a vertex may lie behind the drawn surface and still be seen, over the object's size.
_DEPTH_TOLERANCE = 2e-3
# Relative force error where a session does not say how well its force is known.
_USUAL_FORCE_ERROR = 0.01
# Guesses that a plan takes: of the softest gel and of diamond [Pa]; of a match that fails [px].
_YOUNG_RANGE, _NOISE_RANGE = (1.0, 1.2e12), (1e-5, 10.0)


@dataclass(frozen=True, slots=True)
class PlannedProbing:
    """The precision to expect of one probing alone.

    Attributes
    ----------
    name : str
    seen : int                      vertices that two cameras see, without those under the tool
    displacement : float [m]        median of |u| there
    sigma : float [m]               median standard deviation of a component there
    precision : name -> float       standard deviation of each constant, may be infinite
    """

    name: str
    seen: int
    displacement: float
    sigma: float
    precision: dict[str, float]


@dataclass(frozen=True, slots=True)
class MeasurementPlan:
    """The precision to expect of a session.

    Attributes
    ----------
    probings : tuple of PlannedProbing
    precision : name -> float       of all probings together
    visible : name -> float         share of the free vertices that each camera sees
    """

    probings: tuple[PlannedProbing, ...]
    precision: dict[str, float]
    visible: dict[str, float]


def plan_measurement(
    session: Session,
    *,
    young_modulus: float,
    poisson_ratio: float,
    matching_noise: float = MATCHING_NOISE,
    progress: Progress = silent,
) -> MeasurementPlan:
    """The precision to expect from a session whose pictures are still to be taken.

    The Cramer-Rao bound for the noise of the matches, seen through the cameras as they stand, and
    of the force; on top of it the error of scale that all pictures share.

    Parameters
    ----------
    session : Session               with a rig; its displacements and pictures are not looked at
    young_modulus : float [Pa]      a guess: precision is nearly in proportion to it
    poisson_ratio : float           a guess
    matching_noise : float [px]     standard deviation of one camera's match at a vertex
    progress : callable             told what is done (text) and how far it is (0 to 1)

    Returns
    -------
    MeasurementPlan

    Raises
    ------
    InputError                      a session without a rig or without probings; constants out of
                                    range; cameras without sizes; nothing that two cameras see
    """
    _check(session, young_modulus, poisson_ratio, matching_noise)
    rig = read_rig(session.rig or session.path)
    progress("what the cameras see", 0.0)
    seen = _seen(session, rig)
    rows = np.flatnonzero(seen.sum(axis=0) >= 2)
    if len(rows) == 0:
        raise InputError(
            f"{session.rig}: no vertex of the object is seen by two cameras; turn them to the"
            " object"
        )
    sigma = _sigma(rig, session.mesh.vertices[rows], seen[:, rows], matching_noise)
    probings = (_with_seen_vertices(session, probing, rows, sigma) for probing in session.probings)
    session = replace(session, probings=tuple(probings))
    progress("integrals over the surface", 0.2)
    model = make_object_model(session)
    progress("what the probings tell", 0.7)
    shear = 0.5 * young_modulus / (1.0 + poisson_ratio)
    observed = session_observations(session, model, shear_modulus=shear)
    free = np.setdiff1d(
        np.arange(len(session.mesh.vertices)),
        session.mesh.triangles[session.held_triangles].ravel(),
    )
    return MeasurementPlan(
        tuple(_planned(probe, poisson_ratio, shear) for probe in observed),
        cramer_rao_bound(observed, poisson_ratio=poisson_ratio, shear_modulus=shear),
        {camera.name: float(seen[c, free].mean()) for c, camera in enumerate(rig.cameras)},
    )


def _check(session: Session, young: float, poisson: float, noise: float) -> None:
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
    low, high = _NOISE_RANGE
    if not low <= noise <= high:
        raise InputError(f"matching_noise is {noise:g} px; must be {low:g} to {high:g}")


def _seen(session: Session, rig: Rig) -> Bool[np.ndarray, "c v"]:
    """Which vertices each camera sees."""
    mesh = session.mesh
    tolerance = _DEPTH_TOLERANCE * bounding_diagonal(mesh)
    shown = []
    for camera in rig.cameras:
        surface = surface_map(camera, picture_size(camera)[::-1], mesh.vertices, mesh.triangles)
        shown.append(visible(surface, camera, mesh.vertices, tolerance=tolerance))
    return np.stack(shown)


def _sigma(
    rig: Rig, points: Points, seen: Bool[np.ndarray, "c n"], noise: float
) -> Float[np.ndarray, "n 3"]:
    """Standard deviation of each component of a displacement triangulated by those who see it."""
    information = np.zeros((len(points), 3, 3))
    for camera, mine in zip(rig.cameras, seen, strict=True):
        slope = project_jacobian(camera, points)[1]
        information += mine[:, None, None] * np.einsum("nai,naj->nij", slope, slope)
    covariance = noise**2 * np.linalg.inv(information)
    return np.sqrt(np.einsum("nii->ni", covariance))


def _with_seen_vertices(
    session: Session,
    probing: Probing,
    rows: np.ndarray,
    sigma: Float[np.ndarray, "n 3"],
) -> Probing:
    """The probing with a measurement of its vertices in place of its pictures."""
    contact = probing.contact
    away = np.linalg.norm(session.mesh.vertices[rows] - contact.point, axis=1)
    open_view = away > _HIDDEN_RADII * (contact.radius or 0.0)
    if not open_view.any():
        raise InputError(
            f"probing '{probing.name}': all that two cameras see lies under the tool; turn them"
        )
    vertex = rows[open_view]
    place = session.mesh.vertices[vertex]
    field = DisplacementField(
        points=place,
        displacement=np.zeros_like(place),
        std=sigma[open_view],
        vertex=vertex,
        surface=closest_points(session.mesh, place),
        source="plan",
        scale_error=SCALE_ERROR,
    )
    return replace(probing, displacement=field)


def _planned(observed: ProbeObservations, poisson: float, shear: float) -> PlannedProbing:
    count = len(observed.position)
    response = observed.response.value(poisson)[: 3 * count, :4] @ np.append(observed.force, 1.0)
    moved = np.linalg.norm(response.reshape(-1, 3), axis=1) / shear
    std = observed.std if observed.std is not None else np.full((1, 3), np.nan)
    return PlannedProbing(
        observed.name,
        count,
        float(np.median(moved)),
        float(np.median(np.sqrt((std**2).mean(axis=1)))),
        cramer_rao_bound([observed], poisson_ratio=poisson, shear_modulus=shear),
    )
