"""Contact of a rigid tool, from its shape, its force and the elastic constants.

The contact can hardly be measured, while the tool is known. Around the contact the object is
treated as a half space with the curvature of its surface.

Under a round tool the gap f(r) before the contact depends on the distance from the axis alone, and
Sneddon's integrals of its slope give force, approach and pressure on a circle of any radius a: with

    g(x) = x integral of f'(x sin t) over t from 0 to pi / 2,

the approach is g(a), the force 2 E* integral of r^2 f'(r) / sqrt(a^2 - r^2), and the pressure
E* / pi times the integral of g'(x) / sqrt(x^2 - r^2) over x from r to a. A flat face that the
surface touches up to its rim adds the pressure of a punch.

The contact of other shapes is solved on a grid. The pressure is constant on each of many square
cells. The displacement under it is a convolution, so the complementarity problem (pressure in
contact, a gap elsewhere) is solved by conjugate gradients on the cells in contact.

A tool that slides and is not flat pulls the surface outward, as it presses along its own normals.
Such a traction q(r) = -dQ / dr raises the surface of a half space by (1 - 2 nu) / (2 G) Q: its
Hankel transform of first order is the variable times that of Q, and that of the displacement lacks
this factor. So the tool is met by a surface that is higher in the middle, and touches less of it. A
tool that sticks pulls outward whatever its shape, except where nothing changes the volume: a
surface that slid would move toward the centre of the contact, and is held. As the circle grows,
every further newton is that of a flat face that sticks.

Source: Sneddon, Int. J. Eng. Sci. 3 (1965) 47; outward traction: Johnson, Contact Mechanics (1985),
section 4.2, there neglected as small. Without slip the contact is stiffer by a factor that is exact
for a flat face (Mossakovskii 1954; Spence, Proc. R. Soc. A 305 (1968) 55) and within 2 % for a
sphere.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.polynomial.chebyshev import Chebyshev
from numpy.polynomial.legendre import leggauss
from scipy.fft import irfft2, rfft2
from scipy.optimize import brentq

from palpate.arrays import tangents_of
from palpate.errors import InputError, NotConvergedError
from palpate.geometry import CREASE_ANGLE, TriangleMesh, closest_points, unit_normals
from palpate.records import (
    SPREAD,
    STICKS,
    RoundTool,
    ShapedTool,
    Tool,
    ToolTraction,
    grid_traction,
)
from palpate.shapes import Vector3

# The curvature is fitted to vertices within so many mean edge lengths, or so many radii of the
# tool, whichever is larger.
_FIT_EDGES, _FIT_RADII = 2.5, 1.0
# Coefficients of the fit: a quadratic surface, and the fourth-order term of a sphere.
_MIN_VERTICES = 7
# Largest contact radius over the tool's radius; beyond it the tool is practically buried.
_MAX_RADIUS_RATIO = 0.98
# Gauss points and weights on [0, 1], and degree of the interpolant of g: exact to 1e-6 up to
# circles of 0.98 radii of a sphere.
_POINTS, _WEIGHTS = (0.5 * (values + k) for values, k in zip(leggauss(32), (1.0, 0.0), strict=True))
_DEGREE = 40
# Relative change of the circle at which its outward traction has converged; most rounds.
_CONVERGED, _MOST_ROUNDS = 1e-6, 40
# Distance over the radius within which the pressure under a tip is taken as constant.
_NEAREST = 1e-6
# Distance over the radius within which the surface is raised as there: changes a circle by 1e-4.
_TIP = 0.1
Distances = Float[np.ndarray, "*n"]
# Of the gap before the contact, at distances from the axis [m], about a circle of a radius [m].
Slope = Callable[[Distances, float], Distances]
_NONE = ToolTraction(np.zeros_like(SPREAD), np.zeros_like(SPREAD))
Grid = Float[np.ndarray, "n n"]
# Cells along each side of the square about the contact point.
_CELLS = 64
# The contact's extent over the square's: the square is changed until it is within this range, by
# at most these factors at once.
_FILLED, _ZOOM = (0.6, 0.9), (0.1, 2.0)
# The same on a grid, whose circle changes by steps.
_CONVERGED_ON_GRID = 1e-3
# Relative change of the pressure at which the iteration ends, and most iterations.
_TOLERANCE, _MOST_ITERATIONS = 1e-6, 2000
# Farthest the middle of the contact may lie from the tool's centre point, over its half extent.
_FARTHEST = 3.0
# A tool is buried where more than this share of the force acts on steeper slopes than this one,
# which a sphere has at 98 % of its radius.
_STEEP_SHARE, _STEEPEST = 0.1, 5.0
# Mean circle (`_mean_circle`) under a tool that sticks and is not round: that of a sphere; under a
# flat face and a cone it is 3 % larger and smaller.
_MEAN_CIRCLE = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class ToolContact:
    """Contact of a tool.

    Attributes
    ----------
    radius : float [m]              of the circle under a round tool; else of that which a sphere
                                    would touch if its pressure had the same mean square distance
                                    from the tool's centre point
    traction : ToolTraction         over it
    approach : float [m]            of tool and half space
    """

    radius: float
    traction: ToolTraction
    approach: float


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


def tool_contact(
    tool: Tool,
    local: LocalSurface,
    force: float,
    *,
    shear_modulus: float,
    poisson_ratio: float,
) -> ToolContact:
    """Contact of a tool with a curved half space.

    Parameters
    ----------
    tool : Tool
    local : LocalSurface            of the half space
    force : float [N]               of the tool on the object along the inward normal, > 0
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu <= 0.5

    Returns
    -------
    ToolContact

    Raises
    ------
    InputError                      the tool pulls, is buried, or touches far from its centre point
    NotConvergedError               no equilibrium
    """
    if not force > 0.0:
        raise InputError(
            f"the tool pulls with {-force:.3g} N: its force must point into the object; check the"
            " force's sign and frame, and that the contact's point is not on an edge of the object"
        )
    modulus = reduced_modulus(tool, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio)
    contact = None
    if isinstance(tool, RoundTool):
        contact = _on_circle(tool, local, force / modulus, poisson_ratio)
    elif isinstance(tool, ShapedTool):
        contact = _on_grid(tool, local, force / modulus, poisson_ratio)
    if contact is None:
        raise InputError(
            f"a force of {force:.3g} N would bury a {tool.shape} of {1e3 * tool.radius:.3g} mm in a"
            f" material of G = {shear_modulus:.3g} Pa; check the tool's radius and the force"
        )
    return contact


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


def _on_circle(
    tool: RoundTool, local: LocalSurface, load: float, poisson_ratio: float
) -> ToolContact | None:
    """The contact of a round tool under a force over the reduced modulus [m^2]; None: the tool is
    buried."""
    # A flat face meets a hollow as it meets a plane.
    curvature = max(local.curvature, 0.0) if tool.is_flat else local.curvature
    largest = tool.radius * (1.0 if tool.is_flat else _MAX_RADIUS_RATIO)
    raised, radius, traction = _raised(poisson_ratio), 0.0, _NONE
    for _ in range(_MOST_ROUNDS):

        def slope(r: Distances, circle: float, pressure: ToolTraction = traction) -> Distances:
            own_slope = tool.slope(r)
            # At a tip what is pulled has no bound, and rounds would not settle.
            near = np.maximum(r / circle, _TIP)
            pulled = pressure.mean(near) if tool.friction != STICKS else 0.0
            return own_slope * (1.0 + raised * pulled) + curvature * r

        previous, radius = radius, largest
        spare = load - _load_on(slope, largest)
        if spare < 0.0:
            radius, spare = _circle(slope, load, largest), 0.0
        elif not tool.is_flat:
            return None
        pressure, approach = _pressure(slope, radius)
        # Of a punch, beyond what the shape alone takes.
        approach += spare / (2.0 * radius)
        pressure = pressure + spare / (2.0 * np.pi * radius**2)
        if tool.friction == STICKS:
            pulled = _mean_circle(slope, radius, load) * _no_slip_lever(poisson_ratio)
            return ToolContact(radius, _sticking(pressure, pulled), approach)
        traction = ToolTraction(pressure, pressure * tool.slope(radius * SPREAD))
        approach -= raised * radius * float(traction.potential[0])
        if abs(radius - previous) < _CONVERGED * radius:
            return ToolContact(radius, traction, approach)
    raise NotConvergedError(
        "the circle that a tool touches did not settle: it is too steep to slide on so compressible"
        ' a material; say friction = "sticks", or give the contact\'s radius and profile'
    )


def _raised(poisson_ratio: float) -> float:
    """How far an outward traction -dQ / dr raises the surface, over Q and times the reduced
    modulus."""
    return (1.0 - 2.0 * poisson_ratio) / (1.0 - poisson_ratio)


def _circle(slope: Slope, load: float, largest: float) -> float:
    """Radius of the circle under a force over the reduced modulus."""
    least = 1e-9 * largest
    radius = brentq(lambda a: _load_on(slope, a) - load, least, largest, xtol=1e-12 * largest)
    return float(radius)


def _load_on(slope: Slope, radius: float) -> float:
    """Force over the reduced modulus on a circle [m^2]."""
    s = np.sin(0.5 * np.pi * _POINTS)
    return float(np.pi * radius**2 * (_WEIGHTS @ (s**2 * slope(radius * s, radius))))


def _pressure(slope: Slope, radius: float) -> tuple[Float[np.ndarray, " k"], float]:
    """Pressure over the reduced modulus, as `ToolTraction` keeps it, and approach [m], of a circle
    without a rim."""
    s = np.sin(0.5 * np.pi * _POINTS)
    rise = Chebyshev.interpolate(
        lambda x: 0.5 * np.pi * x * (slope(x[:, None] * s, radius) @ _WEIGHTS),
        _DEGREE,
        [0.0, radius],
    )
    change = rise.deriv()
    # A tip has a slope at the axis: the arcosh of a cone.
    tip = float(change(0.0))
    square = np.clip(1.0 - SPREAD**2, 0.0, None)
    at = radius * np.sqrt(SPREAD[:, None] ** 2 + square[:, None] * _POINTS**2)
    smooth = (((change(at) - tip) / at) @ _WEIGHTS) * radius * square
    sharp = tip * np.arccosh(1.0 / np.maximum(SPREAD, _NEAREST)) * np.sqrt(square)
    return (smooth + sharp) / np.pi, float(rise(radius))


def _mean_circle(slope: Slope, radius: float, load: float) -> float:
    """Radius of the circle at which a newton was added, averaged over all newtons and over the last
    radius: 3 / 4 under a small sphere, 2 / 3 under a cone, 1 under a flat face."""
    before = [_load_on(slope, radius * share) for share in _POINTS]
    return 1.0 - float(_WEIGHTS @ before) / load


def _sticking(pressure: Float[np.ndarray, " k"], lever: float) -> ToolTraction:
    """Traction of a round tool that sticks, with a lever (`ToolTraction.lever`); where the outward
    one acts is not known, but that it vanishes at the centre."""
    unit = ToolTraction(pressure, pressure * SPREAD)
    return ToolTraction(pressure, unit.outward * (lever / unit.lever))


def _on_grid(
    tool: ShapedTool, local: LocalSurface, load: float, poisson_ratio: float
) -> ToolContact | None:
    """The contact of any tool under a force over the reduced modulus [m^2]; None: the tool is
    buried.

    Source: Polonsky and Keer, Wear 231 (1999) 206; displacement under a cell: Love, Phil. Trans. R.
    Soc. A 228 (1929) 377, as in Johnson, Contact Mechanics (1985), equation 3.25.
    """
    axes, half, radius, traction = local.tangents, tool.radius, 0.0, _NONE
    for _ in range(_MOST_ROUNDS):
        x, y = half * np.stack(np.meshgrid(_centres(), _centres(), indexing="ij"))
        face = tool.face(axes, local.normal, x, y)
        if not face.inside.any():
            half *= _ZOOM[1]
            continue
        gap, distance = face.height + 0.5 * local.curvature * (x**2 + y**2), np.hypot(x, y)
        if tool.friction != STICKS and radius > 0.0:
            reach = traction.reach * radius
            raised = np.interp(distance / reach, SPREAD, traction.potential) * reach * np.pi
            gap -= _raised(poisson_ratio) * raised
        pressure, approach = _solved(gap, face.inside, half, load)
        touched = pressure > 0.0
        extent = np.maximum(abs(x), abs(y))[touched].max() / half + 1.0 / _CELLS
        if not _FILLED[0] <= extent <= _FILLED[1]:
            half *= float(np.clip(extent / np.mean(_FILLED), *_ZOOM))
            continue
        steep = np.hypot(*face.slope) > _STEEPEST
        if pressure[steep].sum() > _STEEP_SHARE * pressure.sum():
            return None
        previous, radius = radius, float(np.sqrt(2.5 * np.average(distance**2, weights=pressure)))
        reach = float(distance[touched].max() + np.sqrt(2.0) * half / _CELLS)
        outward = _outward(tool, (x, y), face.slope, pressure, radius, poisson_ratio)
        traction = grid_traction(axes, half / radius, reach / radius, pressure, outward)
        if abs(radius - previous) < _CONVERGED_ON_GRID * radius:
            break
    else:
        raise NotConvergedError(
            f"the contact of a {tool.shape} was not found on any square: parts of it are too fine"
            " for its size; check its lengths, or give the contact's radius and profile"
        )
    _check_near_centre(x[touched], y[touched])
    return ToolContact(radius, traction, approach)


def _no_slip_factor(poisson_ratio: float) -> float:
    """Stiffness of a contact without slip over that of one without friction."""
    compressibility = 1.0 - 2.0 * poisson_ratio
    if compressibility == 0.0:
        return 1.0  # the limit: ln(3 - 4 nu) = ln(1 + 2 (1 - 2 nu)) approaches 2 (1 - 2 nu)
    return float((1.0 - poisson_ratio) * np.log(3.0 - 4.0 * poisson_ratio) / compressibility)


def _no_slip_lever(poisson_ratio: float) -> float:
    """Lever of the outward traction (`ToolTraction.lever`) of a flat circular face that sticks:
    ln(3 - 4 nu) / pi.

    Source: in the dual integral equations of Spence, Proc. R. Soc. A 305 (1968) 55, pressure and
    traction along the surface are transforms of the cosine and the sine of g ln((a + t) / (a - t)),
    g = ln(3 - 4 nu) / (2 pi). Twice the first moment of the sine over the integral of the cosine
    is 2 g.
    """
    return float(np.log(3.0 - 4.0 * poisson_ratio)) / np.pi


def _outward(
    tool: ShapedTool,
    position: tuple[Grid, Grid],
    slopes: Float[np.ndarray, "2 n n"],
    pressure: Grid,
    radius: float,
    poisson_ratio: float,
) -> Grid:
    """Traction away from the centre on a grid."""
    distance = np.hypot(*position)
    if tool.friction == STICKS:
        # Its integral is right; where it acts is not known, but that it vanishes at the centre.
        size = _MEAN_CIRCLE * _no_slip_lever(poisson_ratio) / (0.4 * radius)
        return np.asarray(size * pressure * distance)
    # The mean slope is that of a tool that leans: its part along the surface is in the force.
    along, across = (slope - np.average(slope, weights=pressure) for slope in slopes)
    return np.asarray(pressure * (position[0] * along + position[1] * across) / distance)


def _centres() -> Float[np.ndarray, " n"]:
    """Centres of the cells along a side of the square from -1 to 1."""
    return (2.0 * np.arange(_CELLS) + 1.0) / _CELLS - 1.0


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
