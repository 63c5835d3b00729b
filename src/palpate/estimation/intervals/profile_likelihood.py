"""Intervals from the profile likelihood, which stay valid where Poisson's ratio is at a bound.

The profile is that of the misfit with the final weights held fixed, for which the shear modulus and
the forces are eliminated in closed form. Its height is calibrated: a constant's interval is where
the profile stays below quantile^2 times (variance of the constant / variance from the curvature of
the misfit alone).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.search import (
    FixedWeights,
    ProjectedProbes,
    best_compliance,
    deviance_of,
    refined_minimum,
)

_NEAR_POINTS, _FAR_POINTS = 65, 161
_EDGE_STEPS = 4
# In log(1 / G): longest first step from the valley, longest correction, farthest edge.
_FIRST_REACH, _LONGEST_STEP, _FARTHEST_EDGE = 3.0, 0.5, 20.0


@dataclass(frozen=True, slots=True, eq=False)
class ProfileCurve:
    """The valley of the misfit along Poisson's ratio.

    Parameters
    ----------
    probes : ProjectedProbes
    poisson_ratio : (g,) float [-]
    compliance : (g,) float [1/Pa]      best 1 / G
    height : (g,) float                 misfit above its minimum
    no_signal : float                   misfit above its minimum for 1 / G = 0
    """

    probes: ProjectedProbes
    poisson_ratio: Float[np.ndarray, " g"]
    compliance: Float[np.ndarray, " g"]
    height: Float[np.ndarray, " g"]
    no_signal: float


def profile_curve(
    weights: FixedWeights, *, centre: float, half_width: float, enough: float
) -> ProfileCurve:
    """The valley near a minimum, or over the whole range if the near part does not suffice.

    Parameters
    ----------
    weights : FixedWeights
    centre : float [-]              Poisson's ratio at the minimum
    half_width : float [-]          of the near part
    enough : float                  height that both ends must exceed, unless they are bounds

    Returns
    -------
    ProfileCurve
    """
    low, high = weights.poisson_range
    near = (max(low, centre - half_width), min(high, centre + half_width))
    curve = _curve(weights, np.linspace(near[0], near[1], _NEAR_POINTS))
    open_end = (near[0] > low and curve.height[0] < enough) or (
        near[1] < high and curve.height[-1] < enough
    )
    # A second valley elsewhere would be missed by the near part alone.
    return _curve(weights, np.linspace(low, high, _FAR_POINTS)) if open_end else curve


def profile_intervals(
    curve: ProfileCurve, allowed: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Interval of each constant: where the profile stays below its allowed height.

    Parameters
    ----------
    curve : ProfileCurve
    allowed : constant's name -> height

    Returns
    -------
    constant's name -> (low, high)      moduli in Pa; high is infinite where the data do not exclude
                                        1 / G = 0
    """
    nu = curve.poisson_ratio
    intervals = {"poisson_ratio": crossings(nu, curve.height, allowed["poisson_ratio"])}
    factor = {"shear_modulus": np.ones_like(nu), "young_modulus": 2 * (1 + nu)}
    for name, scale in factor.items():
        stiff, soft = _edges(curve, allowed[name])
        inside = np.isfinite(stiff)
        place = nu[inside]
        _, low = refined_minimum(place, np.log(scale[inside] / soft[inside]))
        _, high = refined_minimum(place, -np.log(scale[inside] / stiff[inside]))
        ceiling = np.inf if curve.no_signal <= allowed[name] else float(np.exp(-high))
        intervals[name] = (float(np.exp(low)), ceiling)
    return intervals


def _curve(weights: FixedWeights, grid: np.ndarray) -> ProfileCurve:
    """Valley on a grid of Poisson's ratios, its height above the minimum between grid points."""
    probes = weights.at(grid)
    compliance, height = best_compliance(probes)
    _, lowest = refined_minimum(grid, height)
    no_signal = float(probes.yy.sum(0).min()) - lowest
    return ProfileCurve(probes, grid, compliance, np.maximum(height - lowest, 0.0), no_signal)


def crossings(
    place: Float[np.ndarray, " g"], height: Float[np.ndarray, " g"], allowed: float
) -> tuple[float, float]:
    """First and last crossing of a curve and a height, interpolated linearly in its square root.

    Parameters
    ----------
    place : (g,) float          ascending
    height : (g,) float         >= 0
    allowed : float             >= 0

    Returns
    -------
    (float, float)              an end of the table where the curve does not rise so high; the place
                                of the minimum, twice, if the curve is nowhere below
    """
    root, level = np.sqrt(height), np.sqrt(allowed)
    inside = np.flatnonzero(root <= level).tolist()
    if not inside:
        best = float(place[int(np.argmin(height))])
        return best, best

    def edge(last: int, outside: int) -> float:
        if not 0 <= outside < len(place):
            return float(place[last])
        fraction = (level - root[last]) / (root[outside] - root[last])
        return float(place[last] + fraction * (place[outside] - place[last]))

    return edge(inside[0], inside[0] - 1), edge(inside[-1], inside[-1] + 1)


def _edges(curve: ProfileCurve, allowed: float) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest 1 / G below a height at every Poisson's ratio, NaN where none is; at the
    lowest point of the valley there always is one."""
    headroom = np.maximum(allowed - curve.height, 0.0)
    inside = headroom > 0
    inside[np.argmin(curve.height)] = True
    floor, _, curvature = deviance_of(curve.probes, curve.compliance)
    reach = np.sqrt(2 * headroom / np.maximum(curvature, np.finfo(float).tiny))
    edges = []
    for sign in (-1.0, 1.0):
        step = sign * np.minimum(reach, _FIRST_REACH)
        for _ in range(_EDGE_STEPS):
            value, first, _ = deviance_of(curve.probes, curve.compliance * np.exp(step))
            shortfall = headroom - (value - floor)
            slope = np.where(np.abs(first) > 0, first, np.inf)
            step = step + np.clip(shortfall / slope, -_LONGEST_STEP, _LONGEST_STEP)
            step = sign * np.clip(sign * step, 0.0, _FARTHEST_EDGE)
        edges.append(np.where(inside, curve.compliance * np.exp(step), np.nan))
    return edges[0], edges[1]
