"""Harmonic functions of clusters: equivalent charges on a sphere in place of all sources inside,
and skeleton points of a cluster, from whose values those at all others are interpolated.

Outside a sphere, sources inside it have the same potential as charges on it. Charges that match
this potential at check points on a wider sphere match it everywhere beyond. Charges and check
points are the same for all clusters up to position and size, so one pseudo-inverse serves all.

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

# Check points per charge.
_CHECK_POINTS_PER_CHARGE = 1.6
# Cutoff of the pseudo-inverse, relative to the largest singular value.
_CUTOFF = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class ChargeSphere:
    """Equivalent charges for sources in the unit sphere.

    Attributes
    ----------
    charge : (k, 3) float         positions of the charges, on the unit sphere
    check : (p, 3) float          check points on a wider sphere, at which potentials are matched
    check_to_charge : (p, k) float    charges from the potentials there: values @ check_to_charge
    """

    charge: Float[np.ndarray, "k 3"]
    check: Float[np.ndarray, "p 3"]
    check_to_charge: Float[np.ndarray, "p k"]


def charge_sphere(count: int, check_radius: float) -> ChargeSphere:
    """Charges on the unit sphere, matched on a wider one.

    Parameters
    ----------
    count : int                   number of charges
    check_radius : float          > 1, radius of the wider sphere

    Returns
    -------
    ChargeSphere
    """
    charge = points_on_sphere(count)
    check = check_radius * points_on_sphere(int(_CHECK_POINTS_PER_CHARGE * count))
    check_to_charge = np.linalg.pinv(inverse_distances(check, charge), rcond=_CUTOFF).T
    return ChargeSphere(charge, check, np.ascontiguousarray(check_to_charge))


def points_on_sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Points that are spread evenly over the unit sphere (Fibonacci's lattice).

    Parameters
    ----------
    count : int

    Returns
    -------
    (count, 3) float [-]            unit vectors
    """
    step = np.arange(count) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * step / count), np.pi * (1.0 + np.sqrt(5.0)) * step
    return np.stack(
        [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1
    )


def inverse_distances(
    first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n m"]:
    """Reciprocal distance of every pair of points, (n, m) [1/m].

    Parameters
    ----------
    first, second : (_, 3) float [m]    without common points
    """
    out = np.empty((len(first), len(second)))
    fill_inverse_distances(first, np.ascontiguousarray(second.T), out)
    return out


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def fill_inverse_distances(first, second, out):
    """`inverse_distances` written into an array.

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


def interpolative_decomposition(
    values: Float[np.ndarray, "m p"], tolerance: float
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "m k"]]:
    """Interpolative decomposition: the few rows of a matrix from which all others are interpolated.

    Parameters
    ----------
    values : (m, p) float         value of p functions at each of m points
    tolerance : float             smallest pivot that is kept, relative to the largest

    Returns
    -------
    (k,) int                      the chosen rows
    (m, k) float                  weights: values = weights @ values[rows], approximately
    """
    upper, pivot = qr(values.T, mode="r", pivoting=True, check_finite=False)
    size = np.abs(np.diag(upper))
    rank = max(1, int((size > tolerance * size[0]).sum()))
    rest = solve_triangular(upper[:rank, :rank], upper[:rank, rank:], check_finite=False)
    weights = np.empty((len(values), rank))
    weights[pivot[:rank]] = np.eye(rank)
    weights[pivot[rank:]] = rest.T
    return pivot[:rank], weights
