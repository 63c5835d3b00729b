"""Quadrature rules on the reference triangle: symmetric rules for distant collocation points,
conical products for near ones."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.special import roots_jacobi, roots_legendre


@dataclass(frozen=True, slots=True, eq=False)
class TriangleRule:
    """Points and weights on a triangle.

    Attributes
    ----------
    degree : int                   polynomials up to this degree are integrated exactly
    barycentric : (q, 3) float [-] points
    weight : (q,) float [-]        sum to 1/2, the area of the reference triangle
    """

    degree: int
    barycentric: Float[np.ndarray, "q 3"]
    weight: Float[np.ndarray, " q"]


@dataclass(frozen=True, slots=True)
class Quadrature:
    """How the boundary integrals are evaluated.

    Attributes
    ----------
    tolerance : float [-]     target relative error of each integral over one triangle; together
                              with the distance of the collocation point over the triangle's radius
                              it selects the rule
    degrees : tuple of int    degrees of the regular rules, ascending
    polar_points : (int, int) radial and angular Gauss points of the singular integrals
    """

    tolerance: float = 1e-5
    degrees: tuple[int, ...] = (2, 4, 5, 7, 9, 11, 13, 15, 19)
    polar_points: tuple[int, int] = (4, 12)

    def ratios(self) -> Float[np.ndarray, " k"]:
        """Distance over triangle radius above which each rule meets the tolerance.

        Returns
        -------
        (k,) float [-]            decreasing with the degree; a rule of degree d has a relative
                                  error of (radius / distance)^(d + 1)
        """
        return np.array([self.ratio(degree) for degree in self.degrees])

    def ratio(self, degree: int) -> float:
        """Distance over triangle radius above which a rule of some degree meets the tolerance.

        Parameters
        ----------
        degree : int              of any rule, whether or not it is one of `degrees`

        Returns
        -------
        float [-]
        """
        return float(self.tolerance ** (-1.0 / (degree + 1)))


# Cached, as are those below: each rule takes an eigenvalue problem, and every load of every model
# asks for the same few.
@cache
def triangle_rule(degree: int) -> TriangleRule:
    """A rule with positive weights that is exact up to at least the given degree.

    Parameters
    ----------
    degree : int              at least 1

    Returns
    -------
    TriangleRule              3, 6 or 7 points for degrees 2, 4 and 5, else a conical product of n^2
                              points; read-only

    Source
    ------
    Hammer, Marlowe and Stroud (1956) for degrees 2 and 5; Dunavant (1985) for degree 4; Stroud
    (1971) for the products.
    """
    if degree <= 2:
        return _symmetric(2, [(1 / 6, 1 / 3)], 0.0)
    if degree <= 4:
        root = np.sqrt(38 - 44 * np.sqrt(2 / 5))
        base = np.sqrt(213125 - 53320 * np.sqrt(10))
        orbits = [
            ((8 - np.sqrt(10) + root) / 18, (620 + base) / 3720),
            ((8 - np.sqrt(10) - root) / 18, (620 - base) / 3720),
        ]
        return _symmetric(4, orbits, 0.0)
    if degree <= 5:
        root = np.sqrt(15)
        orbits = [((6 - root) / 21, (155 - root) / 1200), ((6 + root) / 21, (155 + root) / 1200)]
        return _symmetric(5, orbits, 9 / 40)
    return _conical(degree // 2 + 1)


def _symmetric(
    degree: int, orbits: list[tuple[float, float]], centre_weight: float
) -> TriangleRule:
    points, weights = [], []
    for a, weight in orbits:
        b = 1 - 2 * a
        points += [(a, a, b), (a, b, a), (b, a, a)]
        weights += [weight] * 3
    if centre_weight:
        points.append((1 / 3, 1 / 3, 1 / 3))
        weights.append(centre_weight)
    return TriangleRule(degree, *_read_only(np.array(points), 0.5 * np.array(weights)))


def _conical(n: int) -> TriangleRule:
    radial, radial_weight = roots_jacobi(n, 0.0, 1.0)
    s, w_s = 0.5 * (radial + 1), 0.25 * radial_weight
    t, w_t = unit_gauss(n)
    s, t = (grid.ravel() for grid in np.meshgrid(s, t, indexing="ij"))
    barycentric = np.stack([1 - s, s * (1 - t), s * t], axis=1)
    return TriangleRule(2 * n - 1, *_read_only(barycentric, np.outer(w_s, w_t).ravel()))


@cache
def unit_gauss(n: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Gauss-Legendre points and weights on [0, 1].

    Parameters
    ----------
    n : int                   number of points

    Returns
    -------
    (n,) float, (n,) float    points; weights that sum to 1; read-only
    """
    x, w = roots_legendre(n)
    return _read_only(0.5 * (x + 1), 0.5 * w)


def _read_only(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    points.flags.writeable = weights.flags.writeable = False
    return points, weights
