"""Where to push next: the most informative places, given what is measured already."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.errors import InputError
from palpate.estimation import Information, fisher_information
from palpate.geometry import TriangleMesh, closest_points, split_sides, unit_normals, vertex_normals
from palpate.pipeline.fit_session import fit_session
from palpate.pipeline.model.grading import refined_session
from palpate.pipeline.model.object_model import make_object_model
from palpate.pipeline.observations.session_observations import session_observations
from palpate.progress import Progress, part_of, silent
from palpate.records import DisplacementField, Probing, Session, require_probings
from palpate.shapes import Points

# Number of places that are compared.
_CANDIDATES = 40
# Distance of a contact's centre from creases and rims of held parts, in contact radii.
_CLEARANCE = 1.3
# A tool approaches along the surface normal: radius of its shaft and height at which it begins, in
# contact radii; and the largest cosine between that normal and the mean normal of the supports.
_SHAFT_RADII, _SHAFT_STARTS, _FROM_BELOW = 1.5, 1.0, 0.3
# The tool hides the surface within this distance, in contact radii.
_HIDDEN_RADII = 2.0


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
    now : name -> float             standard deviations of the constants from the measured probings
    alone : tuple of name -> float  the same with one of the c places added
    chosen : tuple of int           indices of the best places, best first
    after : tuple of name -> float  the same with each chosen place and those before it
    information : Information       of the session's probings, then of the places
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


def plan_next(
    session: Session,
    *,
    count: int = 3,
    progress: Progress = silent,
) -> NextProbings:
    """Find the most informative places for further probings, one at a time (greedy D-optimal).

    A further probing has the contact of the first one, its points except those that the tool hides,
    and their standard deviations; its force is the median of the session's.

    Parameters
    ----------
    session : Session               with measured probings; the first under a round patch
    count : int                     number of places to choose, at least 1
    progress : callable

    Returns
    -------
    NextProbings

    Raises
    ------
    InputError                      a count below 1; no contact radius or displacement in the first
                                    probing; no place that a tool can reach
    SingularSystemError, NotConvergedError    as in `fit_session`

    Source
    ------
    Fedorov, Theory of Optimal Experiments (1972).
    """
    require_probings(session)
    first = session.probings[0]
    radius = first.contact.radius
    if count < 1:
        raise InputError(f"count is {count}; must be at least 1")
    if radius is None or first.displacement is None:
        raise InputError(
            f"probing '{first.name}' has no contact radius or no displacement: further probings"
            " are planned like the first one; put one first that has both"
        )
    progress("the constants", 0.0)
    fitted = fit_session(session, progress=part_of(progress, 0.0, 0.4))
    estimate = fitted.estimate
    given = [
        _with_std(probing, fit.rms_residual)
        for probing, fit in zip(session.probings, estimate.probes, strict=True)
    ]
    force = float(np.median([np.linalg.norm(probing.force) for probing in given]))
    point, inward = _reachable(session, radius)
    if not len(point):
        raise InputError("no place of the surface is left for a further probing of this radius")
    # Resolved about the measured contacts only: about all places it would be the whole surface.
    resolved = refined_session(replace(session, probings=tuple(given)))
    further = [
        _like(resolved.probings[0], resolved.mesh, place, force * direction, f"further {k}")
        for k, (place, direction) in enumerate(zip(point, inward, strict=True))
    ]
    whole = replace(resolved, probings=(*resolved.probings, *further))
    progress("what every place tells", 0.4)
    observed = session_observations(whole, make_object_model(whole))
    information = fisher_information(
        observed,
        poisson_ratio=estimate.poisson_ratio.value,
        shear_modulus=estimate.shear_modulus.value,
    )
    made = list(range(len(given)))
    chosen = _greedy(information, made, len(point), min(count, len(point)))
    progress("done", 1.0)
    sets = [made + [len(made) + k for k in chosen[: n + 1]] for n in range(len(chosen))]
    return NextProbings(
        session, force, radius, point, inward,
        now=information.bound(made),
        alone=tuple(information.bound([*made, len(made) + k]) for k in range(len(point))),
        chosen=tuple(chosen),
        after=tuple(information.bound(probings) for probings in sets),
        information=information,
    )  # fmt: skip


def _greedy(information: Information, made: list[int], places: int, count: int) -> list[int]:
    """Places that increase the determinant of the information most, one at a time."""
    chosen: list[int] = []
    for _ in range(count):
        left = [k for k in range(places) if k not in chosen]
        so_far = made + [len(made) + k for k in chosen]
        gain = [np.linalg.det(information.of([*so_far, len(made) + k])) for k in left]
        chosen.append(left[int(np.argmax(gain))])
    return chosen


def _with_std(probing: Probing, rms: float) -> Probing:
    """A probing with standard deviations; where none are given, the RMS of its residuals."""
    field = probing.displacement
    if field is None or field.std is not None:
        return probing
    return replace(probing, displacement=replace(field, std=np.full_like(field.displacement, rms)))


def _like(
    first: Probing, mesh: TriangleMesh, place: np.ndarray, force: np.ndarray, name: str
) -> Probing:
    """A probing like the first, at another place."""
    field, contact = first.displacement, first.contact
    if field is None or field.std is None:
        raise InputError(f"probing '{first.name}' has no displacement")
    distance = np.linalg.norm(field.points - place, axis=1)
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
        name, replace(contact, point=place), force, force_std, None, None, planned, None,
        force_sensor=first.force_sensor,
    )  # fmt: skip


def _reachable(session: Session, radius: float) -> tuple[Points, Points]:
    """Evenly spread places at which a tool can press, and the inward normals there."""
    mesh = session.mesh
    normals = vertex_normals(mesh.vertices, mesh.triangles)
    free = _far_from_edges(session, radius) & ~_from_the_support(session, normals)
    taken = np.array([probing.contact.point for probing in session.probings])
    free &= cKDTree(taken).query(mesh.vertices)[0] > radius
    vertices = _spread(mesh.vertices, np.flatnonzero(free), taken, 3 * _CANDIDATES)
    reachable = [k for k in vertices if _shaft_is_free(mesh, mesh.vertices[k], normals[k], radius)]
    chosen = np.array(reachable[:_CANDIDATES], dtype=np.int64)
    return mesh.vertices[chosen], -normals[chosen]


def _far_from_edges(session: Session, radius: float) -> Bool[np.ndarray, " v"]:
    """Vertices that keep clear of creases, rims and what is held."""
    mesh = session.mesh
    held = np.zeros(len(mesh.triangles), dtype=np.int64)
    held[session.held_triangles] = 1
    sides = split_sides(mesh, held)
    corner = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=2)
    ends = corner[sides.cut[sides.edge]]
    free = np.ones(len(mesh.vertices), dtype=bool)
    if len(ends):
        along = np.linspace(0.0, 1.0, 9)[:, None, None]
        line = mesh.vertices[ends[:, 0]] * (1 - along) + mesh.vertices[ends[:, 1]] * along
        free = cKDTree(line.reshape(-1, 3)).query(mesh.vertices)[0] > _CLEARANCE * radius
    free[np.unique(mesh.triangles[session.held_triangles])] = False
    return free


def _from_the_support(session: Session, normals: Points) -> Bool[np.ndarray, " v"]:
    """Vertices that face the same way as the supports, where the fixture obstructs the tool."""
    outward = unit_normals(session.mesh)[session.held_triangles].mean(axis=0)
    return normals @ outward > _FROM_BELOW


def _shaft_is_free(
    mesh: TriangleMesh, place: np.ndarray, outward: np.ndarray, radius: float
) -> bool:
    """Whether the tool's shaft would be clear of the object."""
    offset = mesh.vertices[mesh.triangles].mean(axis=1) - place
    along = offset @ outward
    off_axis = np.linalg.norm(offset - along[:, None] * outward, axis=1)
    return not bool(((along > _SHAFT_STARTS * radius) & (off_axis < _SHAFT_RADII * radius)).any())


def _spread(
    vertices: Points, free: Int[np.ndarray, " f"], taken: Float[np.ndarray, "p 3"], count: int
) -> list[int]:
    """Farthest-point sample of the free vertices, starting from the points already taken."""
    if not len(free):
        return []
    gap = cKDTree(taken).query(vertices[free])[0]
    chosen = []
    for _ in range(min(count, len(free))):
        k = int(gap.argmax())
        chosen.append(int(free[k]))
        gap = np.minimum(gap, np.linalg.norm(vertices[free] - vertices[free[k]], axis=1))
    return chosen
