"""Estimate of the contact point from the measured motion of the surface and the elastic model.

For points around a first guess the boundary element model predicts the displacement of the surface,
for a few Poisson's ratios and with a free scale (stiffness); the best-fitting point is the contact.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.arrays import tangents_of
from palpate.bem import (
    BoundarySystem,
    FactorisedSystem,
    PressureDisc,
    SurfaceLoad,
    boundary_system,
    check_memory,
    factorise,
    indentation_corrections,
    load_right_hand,
    make_surface,
    solve,
)
from palpate.errors import RecordError
from palpate.geometry import TriangleMesh, closest_points, interpolation_matrix, unit_normals
from palpate.probe import find_contact_patch
from palpate.records import Contact
from palpate.shapes import Indices, Points, Vector3

# Poisson's ratios that are tried; the contact point hardly depends on the ratio.
_POISSON_RATIOS = (0.2, 0.35, 0.48)
# Step sizes of the search in contact radii, and largest number of moves for each.
_STEPS, _MAX_MOVES = (1.0, 0.4), 8
# Points closer to the contact than this many radii are ignored: their motion depends on the
# pressure distribution.
_MIN_DISTANCE = 1.2
# The search begins at the middle of the points whose displacement exceeds this percentile.
_MOVED_PERCENTILE = 97.0
# Least number of points, and least fraction of the motion that a contact must explain.
_MIN_POINTS, _MIN_EXPLAINED = 30, 0.5
# Least component of the force along the inward normal at a contact, over the force.
_INWARD = 0.3
_HEXAGON = np.array([[0.0, 0.0], *([np.cos(a), np.sin(a)] for a in np.arange(6) * np.pi / 3.0)])


@dataclass(frozen=True, slots=True, eq=False)
class ContactModel:
    """Factorised boundary element model of an object for a few Poisson's ratios.

    Attributes
    ----------
    mesh : TriangleMesh
    held : (k,) int                 triangles of the support
    system : BoundarySystem
    factors : tuple of FactorisedSystem     one for each ratio
    """

    mesh: TriangleMesh
    held: Indices
    system: BoundarySystem
    factors: tuple[FactorisedSystem, ...]


def make_contact_model(mesh: TriangleMesh, held: Indices) -> ContactModel:
    """Assemble and factorise the model for the search.

    Parameters
    ----------
    mesh : TriangleMesh
    held : (k,) int                 triangles of the support

    Returns
    -------
    ContactModel

    Raises
    ------
    InputError                      the matrices do not fit into memory
    SingularSystemError             the support does not hold the object
    """
    check_memory(len(mesh.vertices), dense=True, n_factors=len(_POISSON_RATIOS))
    system = boundary_system(make_surface(mesh, held))
    return ContactModel(mesh, held, system, tuple(factorise(system, nu) for nu in _POISSON_RATIOS))


@dataclass(frozen=True, slots=True, eq=False)
class _MeasuredPress:
    """Measured force and displacements of one press, and the interpolation to its points."""

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
) -> tuple[Vector3, float, float]:
    """Find the surface point at which the force best explains the measured displacement.

    Parameters
    ----------
    model : ContactModel
    points : (n, 3) float [m]       measured points, on the surface
    displacement : (n, 3) float [m] measured displacements
    force : (3,) float [N]          on the object
    radius : float [m]              contact radius
    profile : str                   pressure profile, a key of `PRESSURES`

    Returns
    -------
    point : (3,) float [m]          on the surface
    std : float [m]                 standard deviation along each of two tangents
    explained : float [-]           fraction of the sum of squared displacements that a push at this
                                    point explains, 0 to 1

    Raises
    ------
    RecordError                     too few points, no point explains the motion, or all fit alike
    InputError                      a contact on the support
    """
    if len(points) < _MIN_POINTS:
        raise RecordError(
            f"only {len(points)} points of the surface could be followed: the contact cannot be"
            " found; give `points` or `poses` in [contact]"
        )
    part = _pressed_part(model.mesh, force)
    guess = _first_guess(part, points, displacement, force)
    closest = closest_points(model.mesh, points)
    nodes = model.system.surface.displacement
    at_points = interpolation_matrix(nodes, closest.triangle, closest.barycentric)
    press = _MeasuredPress(force, radius, profile, points, displacement, at_points)
    for step in _STEPS:
        for _ in range(_MAX_MOVES):
            ring, tangents = _ring(part, guess, step * radius)
            residuals = _unexplained(model, press, ring)
            best = int(residuals.argmin())
            if best == 0:
                break
            guess = ring[best]
    shift, half_hessian = _paraboloid_minimum(step * radius * _HEXAGON, residuals)
    position = closest_points(part, (guess + shift @ tangents)[None])
    share = 1.0 - float(residuals.min()) / float(_sum_of_squares(press, guess))
    if share < _MIN_EXPLAINED:
        raise RecordError(
            f"no place of the surface explains how it moved (the best one {100 * share:.0f} %):"
            " the contact cannot be found; give `points` or `poses` in [contact]"
        )
    # Errors of neighbouring points are correlated: the effective number of independent points is
    # that of patches of the contact's size in the measured area.
    span = np.ptp((points - guess) @ tangents.T, axis=0)
    count = float(np.clip(span.prod() / (np.pi * radius**2), 8.0, len(points)))
    variance = float(residuals.min()) / count * np.linalg.inv(half_hessian)
    return position.position[0], float(np.sqrt(variance.trace() / 2.0)), share


def _pressed_part(mesh: TriangleMesh, force: Vector3) -> TriangleMesh:
    """The part of a surface that a force presses in: a tool touches no other."""
    inward = -unit_normals(mesh) @ force
    return TriangleMesh(mesh.vertices, mesh.triangles[inward > _INWARD * np.linalg.norm(force)])


def _first_guess(
    mesh: TriangleMesh, points: Points, displacement: Points, force: Vector3
) -> Vector3:
    """First guess: centroid of the points that move most along the force, moved to the surface.

    The tool occludes the contact itself, so this may be off by a tool radius.
    """
    along = np.maximum(displacement @ force, 0.0)
    moving = along >= np.percentile(along, _MOVED_PERCENTILE)
    centroid = np.average(points[moving], axis=0, weights=along[moving])
    position: Vector3 = closest_points(mesh, centroid[None]).position[0]
    return position


def _ring(
    mesh: TriangleMesh, centre: Vector3, size: float
) -> tuple[Points, Float[np.ndarray, "2 3"]]:
    """A surface point and six around it, and two unit tangents there."""
    closest = closest_points(mesh, centre[None])
    tangents = tangents_of(unit_normals(mesh)[closest.triangle[0]])
    return closest_points(mesh, centre + size * _HEXAGON @ tangents).position, tangents


def _sum_of_squares(press: _MeasuredPress, centre: Vector3) -> float:
    """Sum of squared measured displacements of the points away from a contact [m^2]."""
    is_far = np.linalg.norm(press.point - centre, axis=1) > _MIN_DISTANCE * press.radius
    return float(np.square(press.displacement[is_far]).sum())


def _unexplained(
    model: ContactModel, press: _MeasuredPress, candidates: Points
) -> Float[np.ndarray, " k"]:
    """Sum of squared residuals for each candidate, at the best ratio and stiffness [m^2].

    The same measured points are used for all candidates.
    """
    loads = [_load(model, press, candidate) for candidate in candidates]
    shapes = indentation_corrections(model.system.surface, loads)
    right_hand = load_right_hand(model.system, loads, shapes)
    is_far = np.linalg.norm(press.point - candidates[0], axis=1) > _MIN_DISTANCE * press.radius
    measured = press.displacement[is_far].ravel()
    best = np.full(len(candidates), np.inf)
    free = model.system.unknowns.free_vertices
    for factor, ratio in zip(model.factors, _POISSON_RATIOS, strict=True):
        unit = solve(factor, right_hand.at(ratio)).reshape(-1, len(candidates), 3) @ press.force
        residuals = []
        for k in range(len(candidates)):
            moved = np.zeros_like(model.mesh.vertices)
            moved[free] = unit[: 3 * free.size, k].reshape(-1, 3)
            expected = (press.at_points @ moved)[is_far].ravel()
            scale = expected @ measured / (expected @ expected)
            residuals.append(float(np.square(measured - scale * expected).sum()))
        if min(residuals) < best.min():
            best = np.array(residuals)
    return best


def _load(model: ContactModel, press: _MeasuredPress, point: Vector3) -> SurfaceLoad:
    contact = Contact(point, press.radius, press.profile)
    patch = find_contact_patch(model.mesh, contact, model.held, name="searched")
    disc = PressureDisc(contact.point, press.radius, contact.pressure)
    return SurfaceLoad(patch.triangles, patch.density, disc)


def _paraboloid_minimum(
    offsets: Float[np.ndarray, "k 2"], value: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2 2"]]:
    """Minimum of a fitted paraboloid, limited to the fitted region, and half its Hessian."""
    x, y = offsets.T
    matrix = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    _, bx, by, cxx, cxy, cyy = np.linalg.lstsq(matrix, value, rcond=None)[0]
    half_hessian = np.array([[cxx, 0.5 * cxy], [0.5 * cxy, cyy]])
    if np.linalg.eigvalsh(half_hessian)[0] <= 0.0:
        raise RecordError(
            "the motion fits as well wherever the tool may have touched: the contact cannot be"
            " found; give `points` or `poses` in [contact]"
        )
    shift = -0.5 * np.linalg.solve(half_hessian, np.array([bx, by]))
    reach = np.linalg.norm(offsets, axis=1).max()
    return shift * min(1.0, reach / max(float(np.linalg.norm(shift)), 1e-300)), half_hessian
