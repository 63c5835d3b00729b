"""Contact circle of a rigid tool, from its shape, its force and the elastic constants.

The circle can hardly be measured, while the tool is known. Around the contact the object is treated
as a half space with the curvature of its surface; the shape of a spherical tool is exact.

A tool that slides and is not flat pulls the surface outward, as it presses along its own normals,
which under a sphere are inclined by r / R at the distance r from the centre of a small circle. A
tool that sticks does so whatever its shape, except where nothing changes the volume: a surface that
slid would move toward the centre of the contact, and is held. As the circle grows, every further
newton is that of a flat face that sticks.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq

from palpate.arrays import tangents_of
from palpate.errors import InputError
from palpate.geometry import CREASE_ANGLE, TriangleMesh, closest_points, unit_normals
from palpate.records import CONE, SPHERE, STICKS, Tool
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
# Relative increase of the force on a circle per outward traction (`stiffening`), under Hertz's and
# under a cone's pressure: Sneddon's integral for a tool as much steeper as the surface rises.
HERTZ_STIFFENING = 15.0 / (8.0 * np.pi)
_CONE_STIFFENING = 6.0 * (2.0 * 0.9159655941772190 - 1.0) / np.pi**2  # with Catalan's constant


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
    as small), p cot(angle) of a cone; without slip `no_slip_outward`.
    """
    check_inward(force)
    modulus = reduced_modulus(tool, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio)

    def circle(radius: float, profile: str) -> ContactCircle:
        outward = _sliding_outward(tool, radius)
        if tool.friction == STICKS:
            grown = 1.0 if profile == "flat" else _mean_circle(tool, curvature, radius)
            outward = grown * no_slip_outward(poisson_ratio)
        return ContactCircle(radius, profile, outward)

    if tool.is_flat:
        hertz_radius = (
            (0.75 * force / (modulus * curvature)) ** (1 / 3) if curvature > 0.0 else np.inf
        )
        if hertz_radius < tool.radius:
            return circle(hertz_radius, "hertz")
        return circle(tool.radius, "flat")

    share = _CONE_STIFFENING if tool.shape == CONE else HERTZ_STIFFENING

    def excess(ratio: float) -> float:
        radius = ratio * tool.radius
        own = _flat_force(tool, radius) + _curvature_force(curvature, radius)
        stiffer = stiffening(share * _sliding_outward(tool, radius), poisson_ratio)
        return modulus * stiffer * own - force

    if excess(_MAX_RADIUS_RATIO) < 0.0:
        raise buried(tool, force, shear_modulus)
    radius = tool.radius * float(brentq(excess, 1e-6, _MAX_RADIUS_RATIO, xtol=1e-9))
    conical = tool.shape == CONE and _flat_force(tool, radius) > abs(
        _curvature_force(curvature, radius)
    )
    return circle(radius, "cone" if conical else "hertz")


def check_inward(force: float) -> None:
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
    """Modulus E / (1 - nu^2) of the object [Pa], times the factor of a tool to which it sticks."""
    modulus = 2.0 * shear_modulus / (1.0 - poisson_ratio)
    return modulus * (_no_slip_factor(poisson_ratio) if tool.friction == STICKS else 1.0)


def buried(tool: Tool, force: float, shear_modulus: float) -> InputError:
    """The error of a force [N] that presses a tool in up to its side."""
    return InputError(
        f"a force of {force:.3g} N would bury a {tool.shape} of {1e3 * tool.radius:.3g} mm in a"
        f" material of G = {shear_modulus:.3g} Pa; check the tool's radius and the force"
    )


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
    found = np.linalg.lstsq(np.stack(terms, axis=1), height, rcond=None)[0]
    normal = normal - found[1:3] @ tangents
    return LocalSurface(normal / np.linalg.norm(normal), -float(found[3] + found[5]) / reach)


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


def stiffening(outward: float, poisson_ratio: float) -> float:
    """Force of a tool that slides, over that without its outward traction, on the same circle.

    An outward traction q(r) = -dQ / dr raises the surface of a half space by (1 - 2 nu) / (2 G) Q:
    its Hankel transform of first order is the variable times that of Q, and that of the
    displacement lacks this factor. So the tool is met by a surface that is higher in the middle.

    Parameters
    ----------
    outward : float [-]             as `records.Contact.outward`, times `HERTZ_STIFFENING` where the
                                    pressure is Hertz's
    poisson_ratio : float [-]
    """
    return 1.0 + outward * (1.0 - 2.0 * poisson_ratio) / (1.0 - poisson_ratio)


def no_slip_outward(poisson_ratio: float) -> float:
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

    place, weight = 0.5 * radius * (_GAUSS[0] + 1.0), 0.5 * _GAUSS[1]
    return 1.0 - float(weight @ [force(circle) for circle in place]) / force(radius)


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
