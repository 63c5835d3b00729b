"""How the pressure of a tool is distributed over its contact patch."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from palpate.shapes import Points, PointScalars

Pressure = Callable[[Float[np.ndarray, "*n"]], Float[np.ndarray, "*n"]]


def smooth_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """(1 - s^2)^2: decreases smoothly to zero at the rim, as under a soft tool.

    Parameters
    ----------
    s : array [-]                   distance from the contact point over the radius, >= 0

    Returns
    -------
    array [-]                       1 at the centre, 0 from the rim on; callers normalise it
    """
    return np.clip(1 - s**2, 0, None) ** 2


def uniform_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """1 inside the radius, 0 outside, as under a flat tool on a soft layer.

    Parameters
    ----------
    s : array [-]                   distance from the contact point over the radius, >= 0

    Returns
    -------
    array [-]                       1 at the centre, 0 from the rim on
    """
    return (s < 1).astype(np.float64)


def hertz_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """sqrt(1 - s^2), under a frictionless sphere (Hertz 1881).

    Parameters
    ----------
    s : array [-]                   distance from the contact point over the radius, >= 0

    Returns
    -------
    array [-]                       1 at the centre, 0 from the rim on

    Source
    ------
    Hertz, J. reine angew. Math. 92 (1881) 156-171
    """
    return np.sqrt(np.clip(1 - s**2, 0, None))


def flat_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """1 / sqrt(1 - s^2), under a frictionless rigid flat punch.

    Parameters
    ----------
    s : array [-]                   distance from the contact point over the radius, >= 0

    Returns
    -------
    array [-]                       1 at the centre, singular at the rim, 0 from there on

    Source
    ------
    Johnson, Contact Mechanics (1985), eq. 3.34
    """
    return np.where(s < 1, 1.0 / np.sqrt(np.clip(1 - s**2, 1e-12, None)), 0.0)


def cone_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """arcosh(1 / s), under a frictionless rigid cone.

    Parameters
    ----------
    s : array [-]                   distance from the contact point over the radius, >= 0

    Returns
    -------
    array [-]                       logarithmically singular at the centre; 0 from the rim on

    Source
    ------
    Johnson, Contact Mechanics (1985), section 5.2; Love, Q. J. Math. 10 (1939) 161
    """
    return np.arccosh(1.0 / np.clip(s, 1e-9, 1.0))


# To add a tool shape, add its pressure function and one line here. Only the shape of the curve
# matters: it is scaled so that its integral is the force.
PRESSURES: Mapping[str, Pressure] = {
    "smooth": smooth_pressure,
    "uniform": uniform_pressure,
    "hertz": hertz_pressure,
    "flat": flat_pressure,
    "cone": cone_pressure,
}
# Linear hat function of the vertex nearest to the contact point; a contact without a radius.
VERTEX = "vertex"
# Loads over given triangles: uniform traction, or a grip that moves them rigidly.
UNIFORM, RIGID = "uniform", "rigid"
# Angles over which a pressure map is averaged.
_ANGLES = 32


def contact_profiles() -> tuple[str, ...]:
    """Permitted names of a contact's pressure profile."""
    return (*PRESSURES, VERTEX)


@dataclass(frozen=True, slots=True, eq=False)
class PressureMap:
    """Pressure that is not a function of the distance from the contact point alone.

    The grids cover a square about the contact point in the tangent plane; their values are those at
    the centres of g x g equal cells, index [i, j] along the first and second axis.

    Attributes
    ----------
    axes : (2, 3) float [-]         orthonormal tangents
    half_side : float [-]           of the square, in contact radii
    reach : float [-]               farthest point of the contact from its centre, in contact radii
    pressure : (g, g) float         >= 0, of any scale
    outward : (g, g) float          radial component, away from the contact point, of the traction;
                                    the same scale
    """

    axes: Float[np.ndarray, "2 3"]
    half_side: float
    reach: float
    pressure: Float[np.ndarray, "g g"]
    outward: Float[np.ndarray, "g g"]

    def at(self, offset: Points) -> PointScalars:
        """Pressure at points, interpolated bilinearly.

        Parameters
        ----------
        offset : (p, 3) float [-]       from the contact point, in contact radii

        Returns
        -------
        (p,) float                      0 outside the square
        """
        return self._interpolated(self.pressure, offset)

    def mean(self, s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Pressure averaged over all directions, at a distance `s` over the reach."""
        return self._averaged(self.pressure, s)

    def mean_outward(self, s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Outward traction averaged over all directions, at a distance `s` over the reach; 0 where
        it points inward."""
        return np.clip(self._averaged(self.outward, s), 0.0, None)

    def _interpolated(self, grid: Float[np.ndarray, "g g"], offset: Points) -> PointScalars:
        place = 0.5 * (offset @ self.axes.T / self.half_side + 1.0) * len(grid) - 0.5
        return np.asarray(map_coordinates(grid, place.T, order=1, mode="grid-constant"))

    def _averaged(
        self, grid: Float[np.ndarray, "g g"], s: Float[np.ndarray, "*n"]
    ) -> Float[np.ndarray, "*n"]:
        angle = 2.0 * np.pi * np.arange(_ANGLES) / _ANGLES
        around = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ self.axes
        offset = (self.reach * np.ravel(s)[:, None, None] * around).reshape(-1, 3)
        return self._interpolated(grid, offset).reshape(*np.shape(s), _ANGLES).mean(axis=-1)
