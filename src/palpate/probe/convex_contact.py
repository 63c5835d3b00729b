"""Contact of a rigid tool of any convex shape with a curved half space, solved on a grid.

The pressure is constant on each of many square cells. The displacement under it is a convolution,
so the complementarity problem (pressure in contact, a gap elsewhere) is solved by conjugate
gradients on the cells in contact.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.fft import irfft2, rfft2

from palpate.errors import InputError, NotConvergedError
from palpate.probe.contact_circle import (
    HERTZ_STIFFENING,
    LocalSurface,
    buried,
    check_inward,
    no_slip_outward,
    reduced_modulus,
    stiffening,
)
from palpate.records import STICKS, PressureMap, Tool
from palpate.shapes import Vector3

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
    check_inward(force)
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
            stiffer = stiffening(HERTZ_STIFFENING * moment, poisson_ratio)
        if abs(stiffer - previous) < _CONVERGED:
            break
    else:
        raise NotConvergedError("the contact of the tool's mesh was not found on any square")
    _check_near_centre(x[touched], y[touched])
    if pressure[np.hypot(*slopes) > _STEEPEST].sum() > _STEEP_SHARE * pressure.sum():
        raise buried(tool, force, shear_modulus)
    reach = float(distance[touched].max() + np.sqrt(2.0) * half / _CELLS)
    pressure_map = PressureMap(axes, half / radius, reach / radius, pressure, outward)
    return ConvexContact(radius, pressure_map, approach)


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
        size = _MEAN_CIRCLE * no_slip_outward(poisson_ratio) / (0.4 * radius)
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
