"""Surface displacement of a half space under a force spread over a round patch.

The solutions of Boussinesq and Cerruti for a point force, integrated over a disc whose pressure
depends on the radius alone. Times the shear modulus, the result is linear in Poisson's ratio.

Source: Johnson, Contact Mechanics (1985), eq. 3.18, 3.19 and 3.77, at the surface.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.bem.integrals import unit_gauss

# Beyond this many radii the patch is treated as a point.
_FAR = 8.0
# Gauss points of the polar integrals: angles about points on the patch or close to it, angles about
# points farther away, radii of either half of a chord; and of the integral of a profile itself.
_ANGLES, _ANGLES_BESIDE, _RADII, _PROFILE_POINTS = 96, 24, 10, 64
# Beyond this many radii the smaller number of angles is exact to rounding.
_BESIDE = 1.2


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


def disc_displacement(
    disc: PressureDisc, normal: Float[np.ndarray, "3"], position: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "2 n 3 3"]:
    """Displacement of the surface of a half space times its shear modulus, per newton on the disc.

    Parameters
    ----------
    disc : PressureDisc
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
    potential, pull, radial = (part / disc.radius for part in _radial(disc, distance / disc.radius))
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


def _radial(disc: PressureDisc, s: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], ...]:
    """Integrals over the unit disc of p / R, p cos / R and p cos^2 / R, with R and its angle
    measured from a point at radius s; the integral of p is 1."""
    values = np.repeat(1.0 / np.maximum(s, _FAR)[:, None], 3, axis=1)
    over, beside = s <= _BESIDE, (s > _BESIDE) & (s <= _FAR)
    values[over] = _polar_integrals(disc.profile, s[over], _ANGLES)
    values[beside] = _polar_integrals(disc.profile, s[beside], _ANGLES_BESIDE)
    return values[:, 0], values[:, 1], values[:, 2]


def _polar_integrals(
    profile: Profile, s: Float[np.ndarray, " n"], angles: int
) -> Float[np.ndarray, "n 3"]:
    x, w = unit_gauss(angles)
    widest = np.where(s > 1, np.arcsin(np.minimum(1.0, 1.0 / np.maximum(s, 1.0))), np.pi)
    # This substitution makes the square root at the tangents smooth.
    angle = widest[:, None] * np.sin(0.5 * np.pi * x)
    weight = widest[:, None] * 0.5 * np.pi * np.cos(0.5 * np.pi * x) * w
    half = np.sqrt(np.clip(1 - (s[:, None] * np.sin(angle)) ** 2, 0, None))
    middle = s[:, None] * np.cos(angle)
    first, last = np.maximum(middle - half, 0), np.maximum(middle + half, 0)
    reach, w_t = chord_points(first, np.clip(middle, first, last), last, _RADII)
    square = s[:, None, None] ** 2 + reach**2 - 2 * reach * middle[:, :, None]
    inside = np.sqrt(np.clip(square, 0, None))
    pressure = profile(np.minimum(inside, 1 - 1e-12).ravel()).reshape(inside.shape)
    line = 2 * weight * (pressure * w_t).sum(axis=2)
    r, w_r = rounded_gauss(_PROFILE_POINTS)
    total = 2 * np.pi * np.sum(w_r * r * profile(r))
    cosine = np.cos(angle)
    return np.stack([(line * cosine**k).sum(axis=1) / total for k in range(3)], axis=1)


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
