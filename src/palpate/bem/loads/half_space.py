"""Surface displacement of a half space under a force spread over a round patch, and quadrature over
what such a patch covers of a mesh's cell.

The solutions of Boussinesq and Cerruti for a point force, integrated over a disc whose pressure
depends on the radius alone. Times the shear modulus, the result is linear in Poisson's ratio.

Cells of a mesh are often wider than a contact. A rule for whole cells then straddles the rim of the
patch; that in polar coordinates about a corner of a cell (`polar_points`) ends there.

Source: Johnson, Contact Mechanics (1985), eq. 3.18, 3.19 and 3.77, at the surface.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.polynomial.chebyshev import chebfit, chebpts1, chebval

from palpate.bem.integrals.surface import unit_gauss

# Beyond this many radii the patch is treated as a point.
_FAR = 8.0
# Gauss points of the polar integrals: angles of chords, radii of either half of a chord; and of the
# integral of a profile itself.
_ANGLES, _RADII, _PROFILE_POINTS = 48, 10, 64
# Degree of the interpolants, and the power of the distance from the rim in which they are
# polynomials: at the rim potentials are not smooth.
_DEGREE, _POWER = 32, 3
Profile = Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]
# Smallest part of an interval that is integrated by itself.
_LEAST_PART = 1e-2
# Fraction of a ray below which its part within a patch is taken as empty: where a rim touches the
# origin, points of such a part would coincide with it by rounding.
_SHORTEST = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class PressureDisc:
    """A round contact patch whose pressure depends on the radius alone.

    Attributes
    ----------
    centre : (3,) float [m]
    radius : float [m]
    profile : callable            pressure, up to a factor, at s = distance from the centre over
                                  radius, (n,) -> (n,)
    """

    centre: Float[np.ndarray, "3"]
    radius: float
    profile: Profile


@dataclass(frozen=True, slots=True, eq=False)
class DiscPotentials:
    """Integrals over the unit disc of p / R, p cos / R and p cos^2 / R as functions of the radius s
    of the point from which R and its angle are measured; the integral of the pressure p is 1.

    Attributes
    ----------
    inside, outside : (k, 3) float      Chebyshev coefficients over the cube roots of 1 - s and of
                                        (s - 1) / 7
    """

    inside: Float[np.ndarray, "k 3"]
    outside: Float[np.ndarray, "k 3"]

    def at(self, s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """The three integrals; beyond eight radii those of a point force.

        Parameters
        ----------
        s : (n,) float [-]              distance from the centre over the radius, >= 0
        """
        values = np.repeat(1.0 / np.maximum(s, _FAR)[:, None], 3, axis=1)
        on, beside = s <= 1.0, (s > 1.0) & (s <= _FAR)
        values[on] = chebval(2.0 * (1.0 - s[on]) ** (1 / _POWER) - 1.0, self.inside).T
        root = ((s[beside] - 1.0) / (_FAR - 1.0)) ** (1 / _POWER)
        values[beside] = chebval(2.0 * root - 1.0, self.outside).T
        return values


def disc_potentials(profile: Profile) -> DiscPotentials:
    """Potentials of a pressure profile, to about 1e-5 of the largest.

    Parameters
    ----------
    profile : callable            as `PressureDisc.profile`

    Returns
    -------
    DiscPotentials
    """
    x = chebpts1(_DEGREE + 1)
    away = (0.5 * (x + 1.0)) ** _POWER
    places = 1.0 - away, 1.0 + (_FAR - 1.0) * away
    inside, outside = (chebfit(x, chord_integrals(profile, s), _DEGREE) for s in places)
    return DiscPotentials(inside, outside)


def disc_displacement(
    disc: PressureDisc,
    potentials: DiscPotentials,
    normal: Float[np.ndarray, "3"],
    position: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "2 n 3 3"]:
    """Displacement of the surface of a half space times its shear modulus, per newton on the disc.

    Parameters
    ----------
    disc : PressureDisc
    potentials : DiscPotentials       of its profile
    normal : (3,) float [-]           outward normal of the half space
    position : (n, 3) float [m]       points on or near its surface; their distance from the centre
                                      in space is taken as that along the surface

    Returns
    -------
    (2, n, 3, 3) float [1/m]          constant and slope in Poisson's ratio; [.., i, j]: component
                                      i, force along j
    """
    offset = position - disc.centre
    distance = np.linalg.norm(offset, axis=1)
    tangent = offset - (offset @ normal)[:, None] * normal
    length = np.linalg.norm(tangent, axis=1)
    direction = tangent / np.where(length > 0, length, 1.0)[:, None]
    potential, pull, radial = potentials.at(distance / disc.radius).T / disc.radius
    along = direction[:, :, None] * direction[:, None, :]
    plane = np.eye(3) - np.outer(normal, normal)
    across = plane - along
    tensor = radial[:, None, None] * along + (potential - radial)[:, None, None] * across
    inward = -normal
    skew = inward[:, None] * direction[:, None, :] - direction[:, :, None] * inward
    skew = pull[:, None, None] * skew
    whole = potential[:, None, None] * np.eye(3)
    constant = whole / (2 * np.pi) + skew / (4 * np.pi)
    slope = (tensor - whole) / (2 * np.pi) - skew / (2 * np.pi)
    return np.stack([constant, slope])


def chord_integrals(profile: Profile, s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """The integrals of `DiscPotentials` themselves, along the chords through each point.

    Parameters
    ----------
    profile : callable            as `PressureDisc.profile`
    s : (n,) float [-]            distance from the centre over the radius, >= 0

    Returns
    -------
    (n, 3) float
    """
    x, w = unit_gauss(_ANGLES)
    widest = np.arcsin(1.0 / np.maximum(s, 1.0))[:, None]
    # This substitution makes the square root at the tangents smooth.
    angle = widest * np.sin(0.5 * np.pi * x)
    weight = widest * 0.5 * np.pi * np.cos(0.5 * np.pi * x) * w
    half = np.sqrt(np.clip(1 - (s[:, None] * np.sin(angle)) ** 2, 0, None))
    middle = s[:, None] * np.cos(angle)
    nearest, none = middle - half, np.zeros_like(middle)
    ahead = np.maximum(nearest, none), middle, middle + half
    behind = np.minimum(nearest, none), np.minimum(nearest, none), none
    lines = []
    for first, centre, last in (ahead, behind):
        reach, weights = _chord_points(first, centre, last, _RADII)
        square = s[:, None, None] ** 2 + reach**2 - 2 * reach * middle[:, :, None]
        inside = np.sqrt(np.clip(square, 0, None))
        pressure = profile(np.minimum(inside, 1 - 1e-12).ravel()).reshape(inside.shape)
        lines.append(2 * weight * (pressure * weights).sum(axis=2))
    r, w_r = rounded_gauss(_PROFILE_POINTS)
    total = 2 * np.pi * np.sum(w_r * r * profile(r))
    cosine = np.cos(angle)
    both, difference = lines[0] + lines[1], lines[0] - lines[1]
    parts = both, difference * cosine, both * cosine**2
    return np.stack([part.sum(axis=1) for part in parts], axis=1) / total


def rounded_gauss(n: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Gauss points and weights on [0, 1] for integrands that vary as a square root, or its inverse,
    at the ends; (n,) each."""
    x, w = unit_gauss(n)
    return np.sin(0.5 * np.pi * x) ** 2, 0.5 * np.pi * np.sin(np.pi * x) * w


def polar_points(
    position: Float[np.ndarray, "c 3 3"],
    corners: Float[np.ndarray, "c 3 3"],
    disc: PressureDisc | None,
    count: int,
) -> tuple[Float[np.ndarray, "c q 3"], Float[np.ndarray, "c q"]]:
    """Quadrature of cells of triangles in polar coordinates about their first corners.

    Of a round patch only that part is covered which lies in the cell. Points are denser at the ends
    of its radii and angles, where the pressure may vary as a square root or its inverse, and where
    they pass its centre.

    Parameters
    ----------
    position : (c, 3, 3) float [m]  corners of the cells, as if they were flat
    corners : (c, 3, 3) float [-]   their barycentric coordinates in the triangle
    disc : PressureDisc or None     the round patch, where there is one
    count : int                     points on either half of a radius, and of the range of angles

    Returns
    -------
    barycentric : (c, q, 3) float [-]    q = 4 count^2
    weight : (c, q) float [-]       sum to half the cell's share of its triangle
    """
    near, side = position[:, 1] - position[:, 0], position[:, 2] - position[:, 1]
    angles = _whole(np.ones(len(position)))
    if disc is not None:
        centre = disc.centre - position[:, 0]
        angles = _seen_interval(near, side, centre, disc.radius)
    t, weight_t = _chord_points(*angles, count)
    radii = _whole(np.ones(t.shape))
    if disc is not None:
        ray = near[:, None] + t[..., None] * side[:, None]
        radii = _crossed_interval(ray, centre[:, None], disc.radius)
    s, weight_s = _chord_points(*radii, count)
    weight = s * weight_s * weight_t[..., None] * np.abs(np.linalg.det(corners))[:, None, None]
    t = np.broadcast_to(t[..., None], s.shape)
    shares = np.stack([1.0 - s, s * (1.0 - t), s * t], axis=-1)
    barycentric = np.einsum("cstk,ckj->cstj", shares, corners)
    return barycentric.reshape(-1, 4 * count**2, 3), weight.reshape(-1, 4 * count**2)


def _chord_points(
    first: Float[np.ndarray, "*p"],
    middle: Float[np.ndarray, "*p"],
    last: Float[np.ndarray, "*p"],
    count: int,
) -> tuple[Float[np.ndarray, "*p q"], Float[np.ndarray, "*p q"]]:
    """Points and weights along chords of a round patch, `count` on either side of their middle,
    where they pass its centre; denser at both ends and there, where pressures are not smooth.

    Parameters
    ----------
    first, middle, last : array     distance along each chord from a point of it

    Returns
    -------
    points, weights : array         with 2 `count` values along a new last axis
    """
    x, w = rounded_gauss(count)
    halves = (middle - first)[..., None], (last - middle)[..., None]
    starts = first[..., None], middle[..., None]
    points = [start + half * x for start, half in zip(starts, halves, strict=True)]
    return np.concatenate(points, axis=-1), np.concatenate([half * w for half in halves], axis=-1)


def _whole(
    ones: Float[np.ndarray, "*p"],
) -> tuple[Float[np.ndarray, "*p"], Float[np.ndarray, "*p"], Float[np.ndarray, "*p"]]:
    """Begin, middle and end of intervals from 0 to 1."""
    return 0.0 * ones, 0.5 * ones, ones


def _crossed_interval(
    ray: Float[np.ndarray, "p q 3"], centre: Float[np.ndarray, "p 1 3"], radius: float
) -> tuple[Float[np.ndarray, "p q"], Float[np.ndarray, "p q"], Float[np.ndarray, "p q"]]:
    """Where rays from the origin enter a ball, come nearest to its centre, and leave it, as
    fractions of their length, 0 to 1; equal where they miss it."""
    square = (ray**2).sum(axis=-1)
    nearest = (ray * centre).sum(axis=-1) / square
    depth = radius**2 - ((nearest[..., None] * ray - centre) ** 2).sum(axis=-1)
    half = np.sqrt(np.clip(depth, 0.0, None) / square)
    begin, end = np.clip(nearest - half, 0.0, 1.0), np.clip(nearest + half, 0.0, 1.0)
    end = np.where(end - begin > _SHORTEST, end, begin)
    return begin, _divided(begin, nearest, end), end


def _divided(
    start: Float[np.ndarray, "*p"], middle: Float[np.ndarray, "*p"], end: Float[np.ndarray, "*p"]
) -> Float[np.ndarray, "*p"]:
    """A given middle of intervals, or half way where it lies at their ends or outside."""
    margin = _LEAST_PART * (end - start)
    inside = (middle > start + margin) & (middle < end - margin)
    return np.where(inside, middle, 0.5 * (start + end))


def _seen_interval(
    near: Float[np.ndarray, "p 3"],
    side: Float[np.ndarray, "p 3"],
    centre: Float[np.ndarray, "p 3"],
    radius: float,
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """Interval of t, within 0 to 1, in which the rays from the origin towards near + t side hit a
    ball, empty where none does; between its ends, the ray that passes nearest to the centre."""
    beyond = (centre**2).sum(axis=1) - radius**2
    a, b = (near * centre).sum(axis=1), (side * centre).sum(axis=1)
    # Hit where beyond |ray|^2 <= (ray . centre)^2, a quadratic in t.
    first = beyond * (near**2).sum(axis=1) - a**2
    second = 2.0 * (beyond * (near * side).sum(axis=1) - a * b)
    third = beyond * (side**2).sum(axis=1) - b**2
    root = np.sqrt(np.clip(second**2 - 4.0 * third * first, 0.0, None))
    # The form without cancellation: the first term vanishes where the side is parallel to a tangent
    # from the origin.
    larger = -0.5 * (second + np.copysign(root, second))
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = np.sort(np.nan_to_num(np.stack([larger / third, first / larger])), axis=0)
        across = np.cross(np.cross(near, side), centre)
        straight = -(near * across).sum(axis=1) / (side * across).sum(axis=1)
    breaks = np.stack([0.0 * a, *np.clip(roots, 0.0, 1.0), 0.0 * a + 1.0])
    between = 0.5 * (breaks[1:] + breaks[:-1])
    hit = first + second * between + third * between**2 <= 0.0
    hit = (hit & (a + between * b > 0.0)) | (beyond <= 0.0)
    start = np.where(hit, breaks[:-1], 1.0).min(axis=0)
    end = np.maximum(np.where(hit, breaks[1:], 0.0).max(axis=0), start)
    return start, _divided(start, np.nan_to_num(straight), end), end
