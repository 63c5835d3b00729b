"""Kelvin's fundamental solution, split into material-independent parts.

With r = x - y from the load point y to the point x on the surface, n the outward normal at x, i
the direction of the load and j the component, both kernels multiplied by 8 pi (1 - nu):

    traction      (1 - 2 nu) A_ij + B_ij      A_ij = (r_i n_j - r_j n_i - delta_ij r.n) / r^3
                                              B_ij = -3 r_i r_j (r.n) / r^5
    displacement  [(3 - 4 nu) delta_ij / r + r_i r_j / r^3] / (2 G)

Only 15 scalars ("fields") are independent: the vector r x n / r^3 and the symmetric
3 r_i r_j (r.n) / r^5 give A and B (the trace of the second is 3 r.n / r^3), the symmetric
r_i r_j / r^3 gives the displacement (its trace is 1 / r).

This file defines the whole interface between a kernel and the assembly: the layout of its fields,
their values for many load points (`lane_fields`) and for one (`add_point_fields`), and the tensors
that they form (`traction_parts`, `displacement_parts`). A kernel is selected by its number of
fields: numba does not cache a function that takes another function as an argument, and would
recompile it in every process.

Source: Lang and Pai (2001), eq. 2 and 3; Brebbia, Telles and Wrobel, Boundary Element Techniques
(1984), chapter 5.
"""

import numba
import numpy as np
from jaxtyping import Float

from palpate.errors import InputError

# Load points that are processed together, so that the inner loops vectorise.
LANES = 32


# Fields of each kernel: x, y, z of a vector, only that of tractions has one; then xx, yy, zz, yz,
# zx, xy of a symmetric tensor.
TRACTION, DISPLACEMENT = 9, 6
# Position of each entry [i, j] in the stored symmetric tensor.
_ENTRY = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])


def check_material(shear_modulus: float, poisson_ratio: float) -> None:
    """Refuse elastic constants outside the range of stable isotropic materials.

    Parameters
    ----------
    shear_modulus : float [Pa]
    poisson_ratio : float [-]

    Raises
    ------
    InputError                      shear_modulus not positive, or poisson_ratio outside (-1, 0.5]
    """
    if not (np.isfinite(shear_modulus) and shear_modulus > 0):
        raise InputError(f"shear_modulus is {shear_modulus}; must be positive and finite, in Pa")
    if not -1 < poisson_ratio <= 0.5:
        raise InputError(
            f"poisson_ratio is {poisson_ratio}; must be in (-1, 0.5]; "
            "0.5 is incompressible, rubbers lie near 0.49"
        )


def traction_parts(
    fields: Float[np.ndarray, "9 ..."],
) -> tuple[Float[np.ndarray, "3 3 ..."], Float[np.ndarray, "3 3 ..."]]:
    """The tensors A and B of the traction kernel (1 - 2 nu) A + B from its fields.

    Parameters
    ----------
    fields : (9, ...) float [1/m^2]     ordered as `TRACTION`, or their integrals

    Returns
    -------
    (3, 3, ...), (3, 3, ...) float      entry [i, j]: load along i, component j; in the unit of
                                        the fields

    Source
    ------
    Lang and Pai (2001), eq. 2, split by powers of (1 - 2 nu)
    """
    x, y, z = fields[:3]
    zero = np.zeros_like(x)
    skew = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]])
    flux = fields[3:6].sum(axis=0) / 3
    return skew - np.multiply.outer(np.eye(3), flux), -fields[3:][_ENTRY]


def displacement_parts(
    fields: Float[np.ndarray, "6 ..."],
) -> tuple[Float[np.ndarray, "3 3 ..."], Float[np.ndarray, "3 3 ..."]]:
    """Constant and slope in Poisson's ratio of the displacement kernel, for a unit shear modulus.

    Parameters
    ----------
    fields : (6, ...) float [1/m]       ordered as `DISPLACEMENT`, or their integrals

    Returns
    -------
    (3, 3, ...), (3, 3, ...) float      symmetric, in the unit of the fields

    Source
    ------
    Lang and Pai (2001), eq. 3
    """
    trace = np.multiply.outer(np.eye(3), fields[:3].sum(axis=0))
    return 1.5 * trace + 0.5 * fields[_ENTRY], -2 * trace


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def lane_fields(n_fields, lanes, sources, out):
    """Kernel fields of LANES load points at some surface points, one row per surface point.

    Parameters
    ----------
    n_fields : int                          which kernel: `TRACTION` or `DISPLACEMENT`
    lanes : (3 LANES,) float [m]            load points y, coordinate-major
    sources : (q, 6) float                  surface points x [m], normals times weight [m^2]
    out : (q * n_fields * LANES,) float     overwritten; fields times weight
    """
    width = n_fields * LANES
    for q in range(sources.shape[0]):
        row = out[q * width : (q + 1) * width]
        if n_fields == TRACTION:
            _traction_lanes(lanes, sources[q], row)
        else:
            _displacement_lanes(lanes, sources[q], row)


@numba.njit(error_model="numpy", cache=True)
def add_point_fields(n_fields, point, source, weight, factor, out):
    """Add the kernel fields of one load point at one surface point, times each of several factors.

    Parameters
    ----------
    n_fields : int                          which kernel: `TRACTION` or `DISPLACEMENT`
    point : (3,) float [m]                  load point y
    source : (6,) float                     surface point x [m], normal times area [m^2]
    weight : float                          > 0
    factor : (a,) float                     such as shape function values
    out : (a, n_fields) float               added to: factor times weight times fields
    """
    x, y, z = source[0] - point[0], source[1] - point[1], source[2] - point[2]
    s = 1.0 / np.sqrt(x * x + y * y + z * z)
    if n_fields == TRACTION:
        nx, ny, nz = weight * source[3], weight * source[4], weight * source[5]
        traction = _traction_values(x, y, z, nx, ny, nz, s)
        for a in range(factor.size):
            for k in range(9):
                out[a, k] += factor[a] * traction[k]
    else:
        displacement = displacement_values(x, y, z, s * s * s * weight * _area(source))
        for a in range(factor.size):
            for k in range(6):
                out[a, k] += factor[a] * displacement[k]


@numba.njit(fastmath=True, error_model="numpy", inline="always")
def _traction_values(x, y, z, nx, ny, nz, s):
    """r x n / r^3 (x, y, z), then 3 r_i r_j r.n / r^5; s is 1 / r."""
    s3 = s * s * s
    flux = 3.0 * (x * nx + y * ny + z * nz) * s3 * s * s
    return (
        (y * nz - z * ny) * s3,
        (z * nx - x * nz) * s3,
        (x * ny - y * nx) * s3,
        x * x * flux,
        y * y * flux,
        z * z * flux,
        y * z * flux,
        z * x * flux,
        x * y * flux,
    )


@numba.njit(fastmath=True, error_model="numpy", inline="always")
def displacement_values(x, y, z, scale):
    """r_i r_j / r^3; scale is area / r^3."""
    return (
        x * x * scale,
        y * y * scale,
        z * z * scale,
        y * z * scale,
        z * x * scale,
        x * y * scale,
    )


@numba.njit(fastmath=True, error_model="numpy", inline="always")
def _area(source):
    return np.sqrt(source[3] * source[3] + source[4] * source[4] + source[5] * source[5])


@numba.njit(fastmath=True, error_model="numpy", inline="always")
def _reciprocal_root(square):
    # One Newton step from single precision: 5e-15 relative, at half the cost of a double square
    # root and division.
    start = np.float64(np.float32(1.0) / np.sqrt(np.float32(square)))
    return start * (1.5 - 0.5 * square * start * start)


@numba.njit(fastmath=True, error_model="numpy", cache=True)
def _traction_lanes(lanes, source, out):
    px, py, pz = source[0], source[1], source[2]
    nx, ny, nz = source[3], source[4], source[5]
    for i in range(LANES):
        x, y, z = px - lanes[i], py - lanes[LANES + i], pz - lanes[2 * LANES + i]
        s = _reciprocal_root(x * x + y * y + z * z)
        values = _traction_values(x, y, z, nx, ny, nz, s)
        for k in range(9):
            out[k * LANES + i] = values[k]


@numba.njit(fastmath=True, error_model="numpy", cache=True)
def _displacement_lanes(lanes, source, out):
    px, py, pz = source[0], source[1], source[2]
    area = _area(source)
    for i in range(LANES):
        x, y, z = px - lanes[i], py - lanes[LANES + i], pz - lanes[2 * LANES + i]
        s = _reciprocal_root(x * x + y * y + z * z)
        values = displacement_values(x, y, z, s * s * s * area)
        for k in range(6):
            out[k * LANES + i] = values[k]
