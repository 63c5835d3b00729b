"""Contact circle of a rigid tool, from its shape, its force and the elastic constants.

The circle can hardly be measured, while the tool is known. Around the contact the object is treated
as a half space with the curvature of its surface; the shape of a spherical tool is exact.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from palpate.errors import InputError
from palpate.geometry import CREASE_ANGLE, TriangleMesh, closest_points, unit_normals
from palpate.records import CONE, STICKS, Tool
from palpate.shapes import Vector3

# The curvature is fitted to vertices within so many mean edge lengths, or so many radii of the
# tool, whichever is larger.
_FIT_EDGES, _FIT_RADII = 2.5, 1.0
# Coefficients of the fit: a quadratic surface, and the fourth-order term of a sphere.
_MIN_VERTICES = 7
# Largest contact radius over the tool's radius; beyond it the tool is practically buried.
_MAX_RADIUS_RATIO = 0.98


@dataclass(frozen=True, slots=True)
class ContactCircle:
    """Contact circle of a tool.

    Attributes
    ----------
    radius : float [m]              of the circle
    profile : str                   of the pressure over it, a key of `records.PRESSURES`
    """

    radius: float
    profile: str


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
    as more of the force is due to its slope than to the curvature of the surface.
    """
    check_inward(force)
    modulus = reduced_modulus(tool, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio)
    if tool.is_flat:
        hertz_radius = (
            (0.75 * force / (modulus * curvature)) ** (1 / 3) if curvature > 0.0 else np.inf
        )
        if hertz_radius < tool.radius:
            return ContactCircle(hertz_radius, "hertz")
        return ContactCircle(tool.radius, "flat")

    def excess(ratio: float) -> float:
        radius = ratio * tool.radius
        return modulus * (_flat_force(tool, radius) + _curvature_force(curvature, radius)) - force

    if excess(_MAX_RADIUS_RATIO) < 0.0:
        raise buried(tool, force, shear_modulus)
    radius = tool.radius * float(brentq(excess, 1e-6, _MAX_RADIUS_RATIO, xtol=1e-9))
    conical = tool.shape == CONE and _flat_force(tool, radius) > abs(
        _curvature_force(curvature, radius)
    )
    return ContactCircle(radius, "cone" if conical else "hertz")


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
        return np.linalg.svd(self.normal[None])[2][1:]


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
    tangents = np.linalg.svd(normal[None])[2][1:]
    x, y = (offset[near] @ tangents.T).T / reach
    height = offset[near] @ normal / reach
    terms = [np.ones_like(x), x, y, x**2, x * y, y**2, (x**2 + y**2) ** 2]
    found = np.linalg.lstsq(np.stack(terms, axis=1), height, rcond=None)[0]
    normal = normal - found[1:3] @ tangents
    return LocalSurface(normal / np.linalg.norm(normal), -float(found[3] + found[5]) / reach)


def _flat_force(tool: Tool, radius: float) -> float:
    """Force over the reduced modulus E / (1 - nu^2) for a contact radius on a flat surface [m^2]:
    of a sphere, or of a cone (Sneddon 1965, equations 6.15 and 6.4)."""
    if tool.angle is not None:
        return 0.5 * np.pi * radius**2 / float(np.tan(tool.angle))
    log = np.log((tool.radius + radius) / (tool.radius - radius))
    return float(0.5 * (radius**2 + tool.radius**2) * log - radius * tool.radius)


def _curvature_force(curvature: float, radius: float) -> float:
    """The same due to the curvature of the surface, to be added [m^2]."""
    return 4.0 / 3.0 * curvature * radius**3


def _no_slip_factor(poisson_ratio: float) -> float:
    """Stiffness of a contact without slip over that of one without friction."""
    compressibility = 1.0 - 2.0 * poisson_ratio
    if compressibility == 0.0:
        return 1.0  # the limit: ln(3 - 4 nu) = ln(1 + 2 (1 - 2 nu)) approaches 2 (1 - 2 nu)
    return float((1.0 - poisson_ratio) * np.log(3.0 - 4.0 * poisson_ratio) / compressibility)
