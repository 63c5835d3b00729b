"""Harmonic functions of clusters: charges on a sphere in place of all sources inside, and the few
points of a cluster whose values tell those of all others.

Sources inside a sphere look from outside like charges on it; those that match them at the points of
a wider sphere match them everywhere beyond. The points on both are the same for all clusters, up to
place and size, so one pseudo-inverse serves them all.

Source
------
Ying, Biros and Zorin, J. Comput. Phys. 196 (2004): equivalent charges; Cheng, Gimbutas, Martinsson
and Rokhlin, SIAM J. Sci. Comput. 26 (2005): interpolative decomposition.
"""

from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import qr, solve_triangular

# Points that are matched for each charge.
_POINTS_A_CHARGE = 1.6
# Of the largest singular value: what is smaller in the pseudo-inverse is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class ChargeSphere:
    """Charges that stand for the sources in a unit sphere.

    Attributes
    ----------
    charge : (k, 3) float         places of the charges, on the unit sphere
    check : (p, 3) float          points on a wider sphere at which they are matched
    matched : (p, k) float        charges from the values there: values @ matched
    """

    charge: Float[np.ndarray, "k 3"]
    check: Float[np.ndarray, "p 3"]
    matched: Float[np.ndarray, "p k"]


def charge_sphere(count: int, apart: float) -> ChargeSphere:
    """Charges on the unit sphere, matched on one that is so many times as wide.

    Parameters
    ----------
    count : int                   of the charges
    apart : float                 > 1

    Returns
    -------
    ChargeSphere
    """
    charge = points_on_sphere(count)
    check = apart * points_on_sphere(int(_POINTS_A_CHARGE * count))
    matched = np.linalg.pinv(inverse_distances(check, charge), rcond=_ROUNDING).T
    return ChargeSphere(charge, check, np.ascontiguousarray(matched))


def points_on_sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Points that are spread evenly over the unit sphere (Fibonacci's lattice).

    Parameters
    ----------
    count : int
    """
    step = np.arange(count) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * step / count), np.pi * (1.0 + np.sqrt(5.0)) * step
    return np.stack(
        [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1
    )


def inverse_distances(
    first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n m"]:
    """One over the distance of every two points [1/m].

    Parameters
    ----------
    first, second : (_, 3) float [m]    no point in both
    """
    out = np.empty((len(first), len(second)))
    fill_inverse_distances(first, np.ascontiguousarray(second.T), out)
    return out


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def fill_inverse_distances(first, second, out):
    """The same into an array.

    Parameters
    ----------
    first : (n, 3) float
    second : (3, m) float
    out : (n, m) float            overwritten
    """
    x, y, z = second[0], second[1], second[2]
    one = out.dtype.type(1.0)
    for i in range(first.shape[0]):
        a, b, c = first[i, 0], first[i, 1], first[i, 2]
        row = out[i]
        for j in range(x.size):
            square = (x[j] - a) ** 2 + (y[j] - b) ** 2 + (z[j] - c) ** 2
            row[j] = one / np.sqrt(square)


def telling_points(
    values: Float[np.ndarray, "m p"], tolerance: float
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "m k"]]:
    """The few rows of a matrix from which all others follow.

    Parameters
    ----------
    values : (m, p) float         value at each of m points of p functions
    tolerance : float             error left, relative to the largest row

    Returns
    -------
    (k,) int                      rows
    (m, k) float                  all rows from these
    """
    upper, pivot = qr(values.T, mode="r", pivoting=True, check_finite=False)
    size = np.abs(np.diag(upper))
    rank = max(1, int((size > tolerance * size[0]).sum()))
    rest = solve_triangular(upper[:rank, :rank], upper[:rank, rank:], check_finite=False)
    weights = np.empty((len(values), rank))
    weights[pivot[:rank]] = np.eye(rank)
    weights[pivot[rank:]] = rest.T
    return pivot[:rank], weights
