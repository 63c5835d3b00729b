"""Contact of a rigid tool, from its shape, its force and the elastic constants.

The contact can hardly be measured, while the tool is known. Around the contact the object is
treated as a half space with the curvature of its surface; the shape of a spherical tool is exact.

A tool that slides and is not flat pulls the surface outward, as it presses along its own normals,
which under a sphere are inclined by r / R at the distance r from the centre of a small circle. A
tool that sticks does so whatever its shape, except where nothing changes the volume: a surface that
slid would move toward the centre of the contact, and is held. As the circle grows, every further
newton is that of a flat face that sticks.

The contact of other convex shapes is no circle, and is solved on a grid. The pressure is constant
on each of many square cells. The displacement under it is a convolution, so the complementarity
problem (pressure in contact, a gap elsewhere) is solved by conjugate gradients on the cells in
contact.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.polynomial.legendre import leggauss
from scipy.fft import irfft2, rfft2
from scipy.optimize import brentq

from palpate.arrays import tangents_of
from palpate.errors import InputError, NotConvergedError
from palpate.geometry import CREASE_ANGLE, TriangleMesh, closest_points, unit_normals
from palpate.records import CONE, SPHERE, STICKS, PressureMap, Tool
from palpate.shapes import Vector3

# The curvature is fitted to vertices within so many mean edge lengths, or so many radii of the
# tool, whichever is larger.
_FIT_EDGES, _FIT_RADII = 2.5, 1.0
# Coefficients of the fit: a quadratic surface, and the fourth-order term of a sphere.
_MIN_VERTICES = 7
# Largest contact radius over the tool's radius; beyond it the tool is practically buried.
_MAX_RADIUS_RATIO = 0.98
# Gauss points and weights on [-1, 1]: exact to 1e-6 up to circles of 0.98 radii.
_GAUSS = leggauss(24)
# Relative increase of the force on a circle per outward traction (`_stiffening`), under Hertz's and
# under a cone's pressure: Sneddon's integral for a tool as much steeper as the surface rises.
_HERTZ_STIFFENING = 15.0 / (8.0 * np.pi)
_CONE_STIFFENING = 6.0 * (2.0 * 0.9159655941772190 - 1.0) / np.pi**2  # with Catalan's constant
Grid = Float[np.ndarray, "n n"]
# Cells along each side of the square about the contact point.
_CELLS = 64
# The contact's extent over the square's: the square is changed until it is within this range, by
# at most these factors at once.
_FILLED, _ZOOM, _MOST_ROUNDS = (0.6, 0.9), (0.1, 2.0), 40
# Change of the force due to the outward traction at which it has converged.
_CONVERGED = 1e-3
# Relative change of the pressure at which the iteration ends, and most iterations.
_TOLERANCE, _MOST_ITERATIONS = 1e-6, 2000
# Farthest the middle of the contact may lie from the tool's centre point, over its half extent.
_FARTHEST = 3.0
# Faces whose normals are within this of perpendicular to the half space's are upright.
_UPRIGHT = 1e-6
# Faces of the tool whose heights are computed at once.
_AT_ONCE = 256
# A tool is buried where more than this share of the force acts on steeper slopes than this one,
# which a sphere has at 98 % of its radius.
_STEEP_SHARE, _STEEPEST = 0.1, 5.0
# Mean circle of `contact_circle` under a tool that sticks, over the radius: that of a sphere; under
# a flat face and a cone it is 3 % larger and smaller.
_MEAN_CIRCLE = 0.75


@dataclass(frozen=True, slots=True)
class ContactCircle:
    """Contact circle of a tool.

    Attributes
    ----------
    radius : float [m]              of the circle
    profile : str                   of the pressure over it, a key of `records.PRESSURES`
    outward : float [-]             as `records.Contact.outward`
    """

    radius: float
    profile: str
    outward: float


def contact_circle(
    tool: Tool, curvature: float, force: float, *, shear_modulus: float, poisson_ratio: float
) -> ContactCircle:
    """The contact circle of a tool on a curved half space.

    Parameters
    ----------
    tool : Tool
    curvature : float [1/m]         mean curvature of the surface, > 0 where it is convex
    force : float [N]               force of the tool on the object along the inward normal, > 0
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu <= 0.5

    Returns
    -------
    ContactCircle

    Raises
    ------
    InputError                      the tool pulls; the contact of a sphere or a cone would reach
                                    98 % of its radius

    Source
    ------
    Sneddon, Int. J. Eng. Sci. 3 (1965) 47, for any smooth profile. Without slip the contact is
    stiffer by a factor that is exact for a flat face (Mossakovskii 1954; Spence, Proc. R. Soc. A
    305 (1968) 55) and within 2 % for a sphere. The pressure under a cone is that of a cone as long
    as more of the force is due to its slope than to the curvature of the surface. Outward traction:
    p r / R of a sphere that slides (Johnson, Contact Mechanics, 1985, section 4.2, there neglected
    as small), p cot(angle) of a cone; without slip `_no_slip_outward`.
    """
    _check_inward(force)
    modulus = reduced_modulus(tool, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio)

    def circle(radius: float, profile: str) -> ContactCircle:
        outward = _sliding_outward(tool, radius)
        if tool.friction == STICKS:
            grown = 1.0 if profile == "flat" else _mean_circle(tool, curvature, radius)
            outward = grown * _no_slip_outward(poisson_ratio)
        return ContactCircle(radius, profile, outward)

    if tool.is_flat:
        hertz_radius = (
            (0.75 * force / (modulus * curvature)) ** (1 / 3) if curvature > 0.0 else np.inf
        )
        if hertz_radius < tool.radius:
            return circle(hertz_radius, "hertz")
        return circle(tool.radius, "flat")

    share = _CONE_STIFFENING if tool.shape == CONE else _HERTZ_STIFFENING

    def excess(ratio: float) -> float:
        radius = ratio * tool.radius
        own = _flat_force(tool, radius) + _curvature_force(curvature, radius)
        stiffer = _stiffening(share * _sliding_outward(tool, radius), poisson_ratio)
        return modulus * stiffer * own - force

    if excess(_MAX_RADIUS_RATIO) < 0.0:
        raise _buried(tool, force, shear_modulus)
    radius = tool.radius * float(brentq(excess, 1e-6, _MAX_RADIUS_RATIO, xtol=1e-9))
    conical = tool.shape == CONE and _flat_force(tool, radius) > abs(
        _curvature_force(curvature, radius)
    )
    return circle(radius, "cone" if conical else "hertz")


@dataclass(frozen=True, slots=True, eq=False)
class LocalSurface:
    """The smooth surface at a contact.

    Attributes
    ----------
    normal : (3,) float [-]         outward unit normal
    curvature : float [1/m]         mean curvature, > 0 where it is convex
    """

    normal: Vector3
    curvature: float

    @property
    def tangents(self) -> Float[np.ndarray, "2 3"]:
        """Two unit tangents, at right angles."""
        return tangents_of(self.normal)


def local_surface(mesh: TriangleMesh, point: Vector3, radius: float) -> LocalSurface:
    """Normal and mean curvature of the smooth surface around a point.

    Parameters
    ----------
    mesh : TriangleMesh             outward
    point : (3,) float [m]          on the surface or close to it
    radius : float [m]              of the tool

    Returns
    -------
    LocalSurface                    that of the nearest triangle where too few vertices are near
    """
    nearest = closest_points(mesh, point[None])
    normals = unit_normals(mesh)
    normal = normals[nearest.triangle[0]]
    corner = mesh.vertices[mesh.triangles]
    edge = float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).mean())
    level = normals @ normal > np.cos(CREASE_ANGLE)
    vertices = mesh.vertices[np.unique(mesh.triangles[level])]
    offset = vertices - nearest.position[0]
    reach = max(_FIT_EDGES * edge, _FIT_RADII * radius)
    near = np.linalg.norm(offset, axis=1) < reach
    if near.sum() < _MIN_VERTICES:
        return LocalSurface(normal, 0.0)
    tangents = tangents_of(normal)
    x, y = (offset[near] @ tangents.T).T / reach
    height = offset[near] @ normal / reach
    terms = [np.ones_like(x), x, y, x**2, x * y, y**2, (x**2 + y**2) ** 2]
    coefficients = np.linalg.lstsq(np.stack(terms, axis=1), height, rcond=None)[0]
    normal = normal - coefficients[1:3] @ tangents
    return LocalSurface(
        normal / np.linalg.norm(normal), -float(coefficients[3] + coefficients[5]) / reach
    )


@dataclass(frozen=True, slots=True, eq=False)
class ConvexContact:
    """Contact of a convex tool.

    Attributes
    ----------
    radius : float [m]              of the circle that a sphere would touch if its pressure had the
                                    same mean square distance from the tool's centre point
    pressure_map : PressureMap      pressure over it
    approach : float [m]            of tool and half space
    """

    radius: float
    pressure_map: PressureMap
    approach: float


def convex_contact(
    tool: Tool,
    local: LocalSurface,
    force: float,
    *,
    shear_modulus: float,
    poisson_ratio: float,
) -> ConvexContact:
    """Contact of a convex mesh with a curved half space.

    Parameters
    ----------
    tool : Tool                     a mesh
    local : LocalSurface            of the half space
    force : float [N]               of the tool on the object along the inward normal, > 0
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu <= 0.5

    Returns
    -------
    ConvexContact

    Raises
    ------
    InputError                      the tool pulls, is buried, or touches far from its centre point
    NotConvergedError               no equilibrium

    Source
    ------
    Polonsky and Keer, Wear 231 (1999) 206; displacement under a cell: Love, Phil. Trans. R. Soc. A
    228 (1929) 377, as in Johnson, Contact Mechanics (1985), equation 3.25.
    """
    _check_inward(force)
    modulus = reduced_modulus(tool, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio)
    axes, half, stiffer = local.tangents, tool.radius, 1.0
    for _ in range(_MOST_ROUNDS):
        x, y = half * np.stack(np.meshgrid(_centres(), _centres(), indexing="ij"))
        height, slopes, inside = _lower_surface(tool, axes, local.normal, x, y)
        if not inside.any():
            half *= _ZOOM[1]
            continue
        gap = height + 0.5 * local.curvature * (x**2 + y**2)
        pressure, approach = _solved(gap, inside, half, force / (modulus * stiffer))
        touched, distance = pressure > 0.0, np.hypot(x, y)
        extent = np.maximum(abs(x), abs(y))[touched].max() / half + 1.0 / _CELLS
        if not _FILLED[0] <= extent <= _FILLED[1]:
            half *= float(np.clip(extent / np.mean(_FILLED), *_ZOOM))
            continue
        radius = float(np.sqrt(2.5 * np.average(distance**2, weights=pressure)))
        outward = _outward(tool, (x, y), slopes, pressure, radius, poisson_ratio)
        previous = stiffer
        if tool.friction != STICKS:
            moment = float((outward * distance).sum() / (pressure.sum() * radius))
            stiffer = _stiffening(_HERTZ_STIFFENING * moment, poisson_ratio)
        if abs(stiffer - previous) < _CONVERGED:
            break
    else:
        raise NotConvergedError("the contact of the tool's mesh was not found on any square")
    _check_near_centre(x[touched], y[touched])
    if pressure[np.hypot(*slopes) > _STEEPEST].sum() > _STEEP_SHARE * pressure.sum():
        raise _buried(tool, force, shear_modulus)
    reach = float(distance[touched].max() + np.sqrt(2.0) * half / _CELLS)
    pressure_map = PressureMap(axes, half / radius, reach / radius, pressure, outward)
    return ConvexContact(radius, pressure_map, approach)


def _check_inward(force: float) -> None:
    """Refuse a tool that pulls; `force` [N] is along the inward normal.

    Raises
    ------
    InputError                      a force that is not positive
    """
    if not force > 0.0:
        raise InputError(
            f"the tool pulls with {-force:.3g} N: its force must point into the object; check the"
            " force's sign and frame, and that the contact's point is not on an edge of the object"
        )


def reduced_modulus(tool: Tool, *, shear_modulus: float, poisson_ratio: float) -> float:
    """Modulus E / (1 - nu^2) of the object, times the factor of a tool to which it sticks.

    Parameters
    ----------
    tool : Tool
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu <= 0.5

    Returns
    -------
    float [Pa]
    """
    modulus = 2.0 * shear_modulus / (1.0 - poisson_ratio)
    return modulus * (_no_slip_factor(poisson_ratio) if tool.friction == STICKS else 1.0)


def _buried(tool: Tool, force: float, shear_modulus: float) -> InputError:
    """The error of a force [N] that presses a tool in up to its side."""
    return InputError(
        f"a force of {force:.3g} N would bury a {tool.shape} of {1e3 * tool.radius:.3g} mm in a"
        f" material of G = {shear_modulus:.3g} Pa; check the tool's radius and the force"
    )


def _flat_force(tool: Tool, radius: float) -> float:
    """Force over the reduced modulus E / (1 - nu^2) for a contact radius on a flat surface [m^2]:
    of a sphere, or of a cone (Sneddon 1965, equations 6.15 and 6.4); 0 under a flat face, which the
    whole of it touches."""
    if tool.is_flat:
        return 0.0
    if tool.angle is not None:
        return 0.5 * np.pi * radius**2 / float(np.tan(tool.angle))
    log = np.log((tool.radius + radius) / (tool.radius - radius))
    return float(0.5 * (radius**2 + tool.radius**2) * log - radius * tool.radius)


def _curvature_force(curvature: float, radius: float) -> float:
    """The part due to the curvature of the surface, to be added [m^2]."""
    return 4.0 / 3.0 * curvature * radius**3


def _no_slip_factor(poisson_ratio: float) -> float:
    """Stiffness of a contact without slip over that of one without friction."""
    compressibility = 1.0 - 2.0 * poisson_ratio
    if compressibility == 0.0:
        return 1.0  # the limit: ln(3 - 4 nu) = ln(1 + 2 (1 - 2 nu)) approaches 2 (1 - 2 nu)
    return float((1.0 - poisson_ratio) * np.log(3.0 - 4.0 * poisson_ratio) / compressibility)


def _stiffening(outward: float, poisson_ratio: float) -> float:
    """Force of a tool that slides, over that without its outward traction, on the same circle.

    An outward traction q(r) = -dQ / dr raises the surface of a half space by (1 - 2 nu) / (2 G) Q:
    its Hankel transform of first order is the variable times that of Q, and that of the
    displacement lacks this factor. So the tool is met by a surface that is higher in the middle.

    Parameters
    ----------
    outward : float [-]             as `records.Contact.outward`, times `_HERTZ_STIFFENING` where
                                    the pressure is Hertz's
    poisson_ratio : float [-]
    """
    return 1.0 + outward * (1.0 - 2.0 * poisson_ratio) / (1.0 - poisson_ratio)


def _no_slip_outward(poisson_ratio: float) -> float:
    """Outward traction of a flat circular face that sticks, as `records.Contact.outward`:
    ln(3 - 4 nu) / pi.

    Source: in the dual integral equations of Spence, Proc. R. Soc. A 305 (1968) 55, pressure and
    traction along the surface are transforms of the cosine and the sine of g ln((a + t) / (a - t)),
    g = ln(3 - 4 nu) / (2 pi). Twice the first moment of the sine over the integral of the cosine
    is 2 g.
    """
    return float(np.log(3.0 - 4.0 * poisson_ratio)) / np.pi


def _mean_circle(tool: Tool, curvature: float, radius: float) -> float:
    """Radius of the circle at which a newton was added, averaged over all newtons and over the last
    radius: 3 / 4 under a small sphere, 2 / 3 under a cone."""

    def force(circle: float) -> float:
        return _flat_force(tool, circle) + _curvature_force(curvature, circle)

    circles, weight = 0.5 * radius * (_GAUSS[0] + 1.0), 0.5 * _GAUSS[1]
    return 1.0 - float(weight @ [force(circle) for circle in circles]) / force(radius)


def _sliding_outward(tool: Tool, radius: float) -> float:
    """Outward traction, as `records.Contact.outward`, of a tool that slides; 0 if it sticks."""
    if tool.friction == STICKS or tool.shape not in (SPHERE, CONE):
        return 0.0
    if tool.angle is not None:
        return np.pi / 6.0 / float(np.tan(tool.angle))
    ratio = radius / tool.radius
    return _lever_of_sphere(ratio) / ratio


def _lever_of_sphere(ratio: float) -> float:
    """Integral of the outward traction of a sphere times the distance from the centre, for one
    newton and a radius of one, by the ratio of the contact's radius to the sphere's.

    Source: Sneddon, Int. J. Eng. Sci. 3 (1965) 47: the pressure p(r) is in proportion to the
    integral of -h'(t) / sqrt(t^2 - r^2) over t from r to the contact's radius, with
    -h' = artanh(t) + t / (1 - t^2); the outward traction is p r / sqrt(1 - r^2).
    """
    t, weight = 0.5 * ratio * (_GAUSS[0] + 1.0), _GAUSS[1]
    density = weight * (np.arctanh(t) + t / (1.0 - t**2))
    return float(0.5 * (density @ ((1.0 + t**2) * np.arctanh(t) - t)) / (density @ t))


def _outward(
    tool: Tool,
    place: tuple[Grid, Grid],
    slopes: Float[np.ndarray, "2 n n"],
    pressure: Grid,
    radius: float,
    poisson_ratio: float,
) -> Grid:
    """Traction away from the centre (`PressureMap.outward`)."""
    distance = np.hypot(*place)
    if tool.friction == STICKS:
        # Its integral is right; where it acts is not known, but that it vanishes at the centre.
        size = _MEAN_CIRCLE * _no_slip_outward(poisson_ratio) / (0.4 * radius)
        return np.asarray(size * pressure * distance)
    # The mean slope is that of a tool that leans: its part along the surface is in the force.
    along, across = (slope - np.average(slope, weights=pressure) for slope in slopes)
    return np.asarray(pressure * (place[0] * along + place[1] * across) / distance)


def _centres() -> Float[np.ndarray, " n"]:
    """Centres of the cells along a side of the square from -1 to 1."""
    return (2.0 * np.arange(_CELLS) + 1.0) / _CELLS - 1.0


def _lower_surface(
    tool: Tool, axes: Float[np.ndarray, "2 3"], normal: Vector3, x: Grid, y: Grid
) -> tuple[Grid, Float[np.ndarray, "2 n n"], Bool[np.ndarray, "n n"]]:
    """Height of the tool's surface that faces the half space, its slopes along both axes, and where
    the tool is; heights and slopes are 0 elsewhere."""
    planes = np.zeros((0, 4)) if tool.planes is None else tool.planes
    a, b, c = (planes[:, :3] @ np.vstack([axes, normal]).T).T
    faces, covers, upright = c < -_UPRIGHT, c > _UPRIGHT, abs(c) <= _UPRIGHT
    places = np.stack([np.ones(x.size), x.ravel(), y.ravel()])

    def terms(chosen: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "k 3"]:
        """Height of planes as a function of 1, x and y; of upright ones, distance to them."""
        scale = np.where(upright, 1.0, c)[chosen, None]
        return np.stack([planes[:, 3], -a, -b], axis=1)[chosen] / scale

    lower = terms(faces)
    height, lowest = _highest(lower, places)
    top = -_highest(-terms(covers), places)[0]
    inside = (height <= top) & (terms(upright) @ places >= 0.0).all(axis=0)
    slopes = np.where(inside, lower[lowest, 1:].T, 0.0)
    height = np.where(inside, height, 0.0)
    return height.reshape(x.shape), slopes.reshape(2, *x.shape), inside.reshape(x.shape)


def _highest(
    planes: Float[np.ndarray, "p 3"], places: Float[np.ndarray, "3 m"]
) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Height of the highest plane at every place of a square, and which it is."""
    at_corners = planes @ places[:, [0, _CELLS - 1, -_CELLS, -1]]
    # A plane that lies below another one at all corners is the highest nowhere.
    candidates = np.flatnonzero(
        at_corners.max(axis=1) >= at_corners.min(axis=1).max(initial=-np.inf)
    )
    height, highest = np.full(places.shape[1], -np.inf), np.zeros(places.shape[1], dtype=np.int64)
    for first in range(0, candidates.size, _AT_ONCE):
        chosen = candidates[first : first + _AT_ONCE]
        heights = places.T @ planes[chosen].T
        best = heights.argmax(axis=1)
        reached = heights[np.arange(best.size), best]
        highest = np.where(reached > height, chosen[best], highest)
        height = np.maximum(reached, height)
    return height, highest


def _check_near_centre(x: Float[np.ndarray, " t"], y: Float[np.ndarray, " t"]) -> None:
    """Refuse a contact that lies beside the tool's centre point."""
    beside = np.array([x.max() + x.min(), y.max() + y.min()]) / 2.0
    if np.abs(beside).max() > _FARTHEST * 0.5 * max(np.ptp(x), np.ptp(y)):
        raise InputError(
            f"the tool's mesh touches {1e3 * np.hypot(*beside):.3g} mm beside its origin; the"
            " origin of its frame must be the point that touches the object at 'point': move the"
            " mesh, or check tool_rotation"
        )


def _solved(
    gap: Grid, inside: Bool[np.ndarray, "n n"], half: float, force: float
) -> tuple[Grid, float]:
    """Pressure over pi times the reduced modulus [-], and the approach [m], for the gap between
    tool and half space at rest [m] and the force over the reduced modulus [m^2]."""
    displace = _displacement_of(half)
    cell = (2.0 * half / _CELLS) ** 2
    total = force / (np.pi * cell)
    pressure = np.where(inside, total / inside.sum(), 0.0)
    direction, previous, conjugate = np.zeros_like(gap), 1.0, 0.0
    for _ in range(_MOST_ITERATIONS):
        touched = pressure > 0.0
        distance = displace(pressure) + gap
        approach = float(distance[touched].mean())
        distance -= approach
        square = float((distance[touched] ** 2).sum())
        direction = np.where(touched, distance + conjugate * square / previous * direction, 0.0)
        change = displace(direction)
        change -= change[touched].mean()
        slope = float((change * direction)[touched].sum())
        step = float((distance * direction)[touched].sum()) / slope if slope > 0.0 else 0.0
        updated = np.maximum(pressure - step * direction, 0.0)
        overlapping = inside & (updated == 0.0) & (distance < 0.0)
        updated[overlapping] = -step * distance[overlapping]
        updated *= total / updated.sum()
        conjugate, previous = float(not overlapping.any()), square
        error = float(np.abs(updated - pressure).sum()) / total
        pressure = updated
        if error < _TOLERANCE or square == 0.0:
            return pressure, approach
    raise NotConvergedError("the pressure under the tool's mesh did not settle")


def _displacement_of(half: float) -> Callable[[Grid], Grid]:
    """The displacement of the cells' centres under pressures over pi times the reduced modulus."""
    side, n = 2.0 * half / _CELLS, 2 * _CELLS
    offset = side * np.where(np.arange(n) < _CELLS, np.arange(n), np.arange(n) - n)
    x, y = np.meshgrid(offset, offset, indexing="ij")

    def corner(x: Grid, y: Grid) -> Grid:
        """Integral of 1 / r over x and y, up to functions of one of them."""
        return x * np.arcsinh(y / abs(x)) + y * np.arcsinh(x / abs(y))

    (left, right), (below, above) = ((z - 0.5 * side, z + 0.5 * side) for z in (x, y))
    kernel = rfft2(
        corner(right, above) - corner(left, above) - corner(right, below) + corner(left, below)
    )
    return lambda pressure: irfft2(rfft2(pressure, (n, n)) * kernel, (n, n))[:_CELLS, :_CELLS]
