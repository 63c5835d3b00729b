"""Intervals from the profile of the misfit: honest where Poisson's ratio ends at a bound.

The profile is that of the misfit with the final weights held fixed, for which the shear modulus and
the forces are eliminated in closed form. Its height is calibrated: a constant's interval is where
the profile stays below quantile^2 times (variance of the constant / variance that the bare
curvature claims).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.responses import NodeProducts
from palpate.estimation.search import ProjectedProbes, best_compliance, deviance_of, projected

_NEAR, _FAR = 65, 161
_EDGE_STEPS = 4


@dataclass(frozen=True, slots=True, eq=False)
class FixedWeights:
    """A misfit with its robust weights held fixed, for any set of probings.

    Parameters
    ----------
    products : NodeProducts             of these probings
    force : (k, 3) float [N]
    force_root : (k, 3) float [N]       1 sigma over the root of the force's robust weight
    poisson_range : (float, float) [-]
    """

    products: NodeProducts
    force: Float[np.ndarray, "k 3"]
    force_root: Float[np.ndarray, "k 3"]
    poisson_range: tuple[float, float]

    def at(self, poisson_ratio: Float[np.ndarray, " g"]) -> ProjectedProbes:
        """Probings with their forces eliminated."""
        return projected(self.products.at(poisson_ratio), self.force, self.force_root)

    def only(self, index: int) -> "FixedWeights":
        """One probing as a set of its own."""
        chosen = slice(index, index + 1)
        return FixedWeights(
            self.products.only(index),
            self.force[chosen],
            self.force_root[chosen],
            self.poisson_range,
        )


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
    """The valley about a minimum, over the whole range where the near part does not suffice.

    Parameters
    ----------
    weights : FixedWeights
    centre : float [-]              Poisson's ratio at the minimum
    half_width : float [-]          of the near part
    enough : float                  height that both ends must exceed, unless they are bounds
    """
    low, high = weights.poisson_range
    near = (max(low, centre - half_width), min(high, centre + half_width))
    curve = _curve(weights, np.linspace(near[0], near[1], _NEAR))
    open_end = (near[0] > low and curve.height[0] < enough) or (
        near[1] < high and curve.height[-1] < enough
    )
    # A second valley elsewhere would be missed by the near part alone.
    return _curve(weights, np.linspace(low, high, _FAR)) if open_end else curve


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
    constant's name -> (low, high)      moduli in Pa; infinite where no signal is allowed
    """
    nu = curve.poisson_ratio
    intervals = {"poisson_ratio": _crossings(nu, curve.height, allowed["poisson_ratio"])}
    factor = {"shear_modulus": np.ones_like(nu), "young_modulus": 2 * (1 + nu)}
    for name, scale in factor.items():
        stiff, soft = _edges(curve, allowed[name])
        inside = np.isfinite(stiff)
        place = nu[inside]
        low = _extreme(place, np.log(scale[inside] / soft[inside]), -1.0)
        high = _extreme(place, np.log(scale[inside] / stiff[inside]), 1.0)
        ceiling = np.inf if curve.no_signal <= allowed[name] else float(np.exp(high))
        intervals[name] = (float(np.exp(low)), ceiling)
    return intervals


def _curve(weights: FixedWeights, grid: np.ndarray) -> ProfileCurve:
    """Valley on a grid of Poisson's ratios, its height above the minimum between grid points."""
    probes = weights.at(grid)
    compliance, height = best_compliance(probes)
    lowest = _lowest(height[0])
    no_signal = float(weights.products.measured_measured.sum()) - lowest
    above = np.maximum(height[0] - lowest, 0.0)
    return ProfileCurve(probes, grid, compliance[0], above, no_signal)


def _lowest(height: np.ndarray) -> float:
    """Minimum of a sampled curve, sharpened by a parabola."""
    best = int(np.argmin(height))
    if best in (0, len(height) - 1):
        return float(height[best])
    left, middle, right = height[best - 1 : best + 2]
    bend = left - 2 * middle + right
    return float(middle - (left - right) ** 2 / (8 * bend)) if bend > 0 else float(middle)


def _crossings(place: np.ndarray, height: np.ndarray, allowed: float) -> tuple[float, float]:
    """First and last place where the curve crosses a height, linear in the root of the height."""
    root, level = np.sqrt(height), np.sqrt(allowed)
    inside = np.flatnonzero(root <= level)
    if not len(inside):
        best = float(place[int(np.argmin(height))])
        return best, best
    first, last = int(inside[0]), int(inside[-1])
    low, high = float(place[first]), float(place[last])
    if first > 0:
        share = (level - root[first]) / (root[first - 1] - root[first])
        low -= float(share * (place[first] - place[first - 1]))
    if last < len(place) - 1:
        share = (level - root[last]) / (root[last + 1] - root[last])
        high += float(share * (place[last + 1] - place[last]))
    return low, high


def _edges(curve: ProfileCurve, allowed: float) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest 1 / G below a height at every Poisson's ratio, NaN where none is."""
    spare = allowed - curve.height
    inside = spare > 0
    best = curve.compliance[None]
    floor, _, bend = deviance_of(curve.probes, best)
    reach = np.sqrt(2 * np.maximum(spare, 0.0) / np.maximum(bend[0], np.finfo(float).tiny))
    edges = []
    for sign in (-1.0, 1.0):
        step = sign * np.minimum(reach, 3.0)
        for _ in range(_EDGE_STEPS):
            value, first, _ = deviance_of(curve.probes, best * np.exp(step)[None])
            short = spare - (value[0] - floor[0])
            slope = np.where(np.abs(first[0]) > 0, first[0], np.inf)
            step = step + np.clip(short / slope, -0.5, 0.5)
            step = sign * np.clip(sign * step, 0.0, 20.0)
        edges.append(np.where(inside, best[0] * np.exp(step), np.nan))
    return edges[0], edges[1]


def _extreme(place: np.ndarray, height: np.ndarray, sign: float) -> float:
    """Largest (sign 1) or smallest (-1) value of a sampled curve, sharpened by a parabola."""
    if not len(place):
        return np.nan
    best = sign * height
    top = int(np.argmax(best))
    if top in (0, len(best) - 1):
        return float(height[top])
    return -sign * _lowest(-best)
