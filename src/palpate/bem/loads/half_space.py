"""Surface displacement of a half space under a round patch: what a displacement looks like close to
a tool.

The formulae of Boussinesq and Cerruti for a point force, spread over a disc whose pressure depends
on the radius alone. All of it is linear in Poisson's ratio once multiplied by the shear modulus.

Source: Johnson, Contact Mechanics (1985), eq. 3.18, 3.19 and 3.77, at the surface.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.bem.integrals import unit_gauss

# From this many radii on the patch is a point.
_FAR = 8.0
# Gauss points of the polar integrals, by angle about points on the patch and far enough beside it,
# and by radius, and of a profile's own integral.
_ANGLES, _ANGLES_BESIDE, _RADII, _PROFILE_POINTS = 96, 24, 12, 64
# From this many radii on the fewer angles leave nothing but rounding.
_BESIDE = 1.2


Profile = Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]


@dataclass(frozen=True, slots=True, eq=False)
class PressureDisc:
    """A round patch on which a tool presses.

    Attributes
    ----------
    centre : (3,) float [m]
    radius : float [m]
    profile : callable            pressure over any scale at s = distance from the centre / radius,
                                  (n,) -> (n,)
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
                                      counts

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
    """Integrals over the unit disc of p / R, p cos / R and p cos^2 / R, with R and its angle seen
    from radius s."""
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
    # The square root at the tangents is smooth in this angle.
    angle = widest[:, None] * np.sin(0.5 * np.pi * x)
    weight = widest[:, None] * 0.5 * np.pi * np.cos(0.5 * np.pi * x) * w
    half = np.sqrt(np.clip(1 - (s[:, None] * np.sin(angle)) ** 2, 0, None))
    middle = s[:, None] * np.cos(angle)
    first, last = np.maximum(middle - half, 0), np.maximum(middle + half, 0)
    t, w_t = _rounded_gauss(_RADII)
    reach = first[:, :, None] + (last - first)[:, :, None] * t
    square = s[:, None, None] ** 2 + reach**2 - 2 * reach * middle[:, :, None]
    inside = np.sqrt(np.clip(square, 0, None))
    pressure = profile(np.minimum(inside, 1 - 1e-12).ravel()).reshape(inside.shape)
    line = 2 * weight * ((last - first) * (pressure @ w_t))
    r, w_r = _rounded_gauss(_PROFILE_POINTS)
    total = 2 * np.pi * np.sum(w_r * r * profile(r))
    cosine = np.cos(angle)
    return np.stack([(line * cosine**k).sum(axis=1) / total for k in range(3)], axis=1)


def _rounded_gauss(n: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Points and weights on [0, 1] for what goes as a square root, or one over it, at the ends."""
    x, w = unit_gauss(n)
    return np.sin(0.5 * np.pi * x) ** 2, 0.5 * np.pi * np.sin(np.pi * x) * w
