"""Surface displacement of a half space under a force spread over a round patch.

The solutions of Boussinesq and Cerruti for a point force, integrated over a disc whose pressure
depends on the radius alone. Times the shear modulus, the result is linear in Poisson's ratio.

Source: Johnson, Contact Mechanics (1985), eq. 3.18, 3.19 and 3.77, at the surface.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.polynomial.chebyshev import chebfit, chebpts1, chebval

from palpate.bem.integrals.quadrature import unit_gauss

# Beyond this many radii the patch is treated as a point.
_FAR = 8.0
# Gauss points of the polar integrals: angles of chords, radii of either half of a chord; and of the
# integral of a profile itself.
_ANGLES, _RADII, _PROFILE_POINTS = 48, 10, 64
# Degree of the interpolants, and the power of the distance from the rim in which they are
# polynomials: at the rim potentials are not smooth.
_DEGREE, _POWER = 32, 3


Profile = Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]


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
        reach, weights = chord_points(first, centre, last, _RADII)
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


def chord_points(
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


def rounded_gauss(n: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Gauss points and weights on [0, 1] for integrands that vary as a square root, or its inverse,
    at the ends; (n,) each."""
    x, w = unit_gauss(n)
    return np.sin(0.5 * np.pi * x) ** 2, 0.5 * np.pi * np.sin(np.pi * x) * w
