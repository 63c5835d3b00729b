"""Where the tool touched, from the motion of the whole surface: the elastic model decides.

For places around a first guess the boundary element model says how the surface would have moved,
for a few Poisson's ratios and any stiffness; the place whose motion fits best is the contact.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.bem import (
    BoundarySystem,
    FactorisedSystem,
    PressureDisc,
    SurfaceLoad,
    assemble_system,
    check_memory,
    factorise,
    load_right_hand,
    load_shapes,
    make_surface,
    solve,
)
from palpate.errors import RecordError
from palpate.geometry import TriangleMesh, closest_points, interpolation_matrix, unit_normals
from palpate.probe import find_contact_patch
from palpate.records import Contact
from palpate.shapes import Indices, Points, Vector3

# The best of these is taken; where the tool pressed hardly depends on it.
_POISSON_RATIOS = (0.2, 0.35, 0.48)
# Steps of the search in radii of the contact, and how often a step may be repeated.
_STEPS, _MOST_MOVES = (1.0, 0.4), 8
# Points nearer than so many radii are bent by how the tool presses, not where.
_NEAREST = 1.2
# The search begins in the middle of the points that move farther than so many of all [%].
_MOST_MOVED = 97.0
# Fewer points, or less of the motion explained, is no contact.
_LEAST_POINTS, _LEAST_EXPLAINED = 30, 0.5
_HEXAGON = np.array([[0.0, 0.0], *([np.cos(a), np.sin(a)] for a in np.arange(6) * np.pi / 3.0)])


@dataclass(frozen=True, slots=True, eq=False)
class FoundContact:
    """A contact point that was not told.

    Attributes
    ----------
    point : (3,) float [m]          on the surface
    std : float [m]                 along the surface, of each of two directions
    explained : float [-]           share of the motion that a push there explains, 0 to 1
    """

    point: Vector3
    std: float
    explained: float


@dataclass(frozen=True, slots=True, eq=False)
class ContactModel:
    """An object's boundary element model for a few Poisson's ratios.

    Attributes
    ----------
    mesh : TriangleMesh
    held : (k,) int
    system : BoundarySystem
    factors : tuple of FactorisedSystem     for each of the ratios
    """

    mesh: TriangleMesh
    held: Indices
    system: BoundarySystem
    factors: tuple[FactorisedSystem, ...]


def make_contact_model(mesh: TriangleMesh, held: Indices) -> ContactModel:
    """Prepare the search on an object.

    Parameters
    ----------
    mesh : TriangleMesh
    held : (k,) int                 triangles of the support

    Returns
    -------
    ContactModel

    Raises
    ------
    InputError                      its matrices do not fit into memory
    """
    check_memory(len(mesh.vertices), dense=True)
    system = assemble_system(make_surface(mesh, held))
    return ContactModel(mesh, held, system, tuple(factorise(system, nu) for nu in _POISSON_RATIOS))


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What was measured of one press."""

    force: Vector3
    radius: float
    profile: str
    point: Points
    displacement: Points
    at_points: csr_array


def find_contact(
    model: ContactModel,
    points: Points,
    displacement: Points,
    force: Vector3,
    *,
    radius: float,
    profile: str,
) -> FoundContact:
    """The point of the surface at which the force moves it as was measured.

    Parameters
    ----------
    model : ContactModel
    points : (n, 3) float [m]       on the surface
    displacement : (n, 3) float [m]
    force : (3,) float [N]          on the object
    radius : float [m]              of the contact
    profile : str                   of `PRESSURES`

    Returns
    -------
    FoundContact

    Raises
    ------
    RecordError                     no place explains the motion; a contact on the support
    """
    if len(points) < _LEAST_POINTS:
        raise RecordError(
            f"only {len(points)} points of the surface could be followed: the contact cannot be"
            " found; give `points` or `poses` in [contact]"
        )
    guess = _start(model.mesh, points, displacement, force)
    place = closest_points(model.mesh, points)
    nodes = model.system.surface.displacement
    at_points = interpolation_matrix(nodes, place.triangle, place.barycentric)
    seen = _Seen(force, radius, profile, points, displacement, at_points)
    for step in _STEPS:
        for _ in range(_MOST_MOVES):
            ring, across = _ring(model.mesh, guess, step * radius)
            rest = _unexplained(model, seen, ring)
            best = int(rest.argmin())
            if best == 0:
                break
            guess = ring[best]
    shift, curve = _lowest(step * radius * _HEXAGON, rest)
    position = closest_points(model.mesh, (guess + shift @ across)[None])
    explained = 1.0 - float(rest.min()) / float(_square(seen, guess))
    if explained < _LEAST_EXPLAINED:
        raise RecordError(
            f"no place of the surface explains how it moved (the best one {100 * explained:.0f} %):"
            " the contact cannot be found; give `points` or `poses` in [contact]"
        )
    # Neighbouring points err alike: as many count as patches of the contact's size they fill.
    span = np.ptp((points - guess) @ across.T, axis=0)
    count = float(np.clip(span.prod() / (np.pi * radius**2), 8.0, len(points)))
    variance = float(rest.min()) / count * np.linalg.inv(curve)
    return FoundContact(position.position[0], float(np.sqrt(variance.trace() / 2.0)), explained)


def _start(mesh: TriangleMesh, points: Points, displacement: Points, force: Vector3) -> Vector3:
    """The middle of what moves most along the force, brought to the surface.

    The tool hides the contact itself, so that this may be a tool's radius away from it.
    """
    along = np.maximum(displacement @ force, 0.0)
    most = along >= np.percentile(along, _MOST_MOVED)
    middle = np.average(points[most], axis=0, weights=along[most])
    position: Vector3 = closest_points(mesh, middle[None]).position[0]
    return position


def _ring(
    mesh: TriangleMesh, centre: Vector3, size: float
) -> tuple[Points, Float[np.ndarray, "2 3"]]:
    """A point of the surface and six around it, and the directions along the surface there."""
    place = closest_points(mesh, centre[None])
    across = np.linalg.svd(unit_normals(mesh)[place.triangle[0]][None])[2][1:]
    return closest_points(mesh, centre + size * _HEXAGON @ across).position, across


def _square(seen: _Seen, centre: Vector3) -> float:
    """Sum of the squares of what was measured away from a contact."""
    away = np.linalg.norm(seen.point - centre, axis=1) > _NEAREST * seen.radius
    return float(np.square(seen.displacement[away]).sum())


def _unexplained(model: ContactModel, seen: _Seen, places: Points) -> Float[np.ndarray, " k"]:
    """Sum of the squares of what is left at each place, at the best ratio and stiffness.

    The points that count are the same for all places.
    """
    loads = [_load(model, seen, place) for place in places]
    shapes = load_shapes(model.system.surface, loads)
    right = load_right_hand(model.system, loads, shapes)
    away = np.linalg.norm(seen.point - places[0], axis=1) > _NEAREST * seen.radius
    measured = seen.displacement[away].ravel()
    best = np.full(len(places), np.inf)
    free = model.system.unknowns.free_vertices
    for factor, ratio in zip(model.factors, _POISSON_RATIOS, strict=True):
        unit = solve(factor, right.at(ratio)).reshape(-1, len(places), 3) @ seen.force
        rest = []
        for k in range(len(places)):
            moved = np.zeros_like(model.mesh.vertices)
            moved[free] = unit[: 3 * free.size, k].reshape(-1, 3)
            expected = (seen.at_points @ moved)[away].ravel()
            scale = expected @ measured / (expected @ expected)
            rest.append(float(np.square(measured - scale * expected).sum()))
        if min(rest) < best.min():
            best = np.array(rest)
    return best


def _load(model: ContactModel, seen: _Seen, place: Vector3) -> SurfaceLoad:
    contact = Contact(place, seen.radius, seen.profile)
    patch = find_contact_patch(model.mesh, contact, model.held, name="searched")
    disc = PressureDisc(contact.point, seen.radius, patch.pressure)
    return SurfaceLoad(patch.triangles, patch.density, disc)


def _lowest(
    place: Float[np.ndarray, "k 2"], value: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2 2"]]:
    """Where a paraboloid through values is lowest, within reach of them, and half its curvature."""
    x, y = place.T
    matrix = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    _, bx, by, cxx, cxy, cyy = np.linalg.lstsq(matrix, value, rcond=None)[0]
    curve = np.array([[cxx, 0.5 * cxy], [0.5 * cxy, cyy]])
    if np.linalg.eigvalsh(curve)[0] <= 0.0:
        raise RecordError(
            "the motion fits as well wherever the tool may have touched: the contact cannot be"
            " found; give `points` or `poses` in [contact]"
        )
    shift = -0.5 * np.linalg.solve(curve, np.array([bx, by]))
    reach = np.linalg.norm(place, axis=1).max()
    return shift * min(1.0, reach / max(float(np.linalg.norm(shift)), 1e-300)), curve
