"""Kelvin's fundamental solution, split into parts that are free of the material.

With r = x - y from the load point y to the point x on the surface, n the outward normal there, i
the direction of the load and j the component, multiplied by 8 pi (1 - nu):

    traction      (1 - 2 nu) A_ij + B_ij      A_ij = (r_i n_j - r_j n_i - delta_ij r.n) / r^3
                                              B_ij = -3 r_i r_j (r.n) / r^5
    displacement  [(3 - 4 nu) delta_ij / r + r_i r_j / r^3] / (2 G)

Only 15 scalars are independent: the vector r x n / r^3 and the symmetric 3 r_i r_j (r.n) / r^5 give
A and B (the trace of the second is 3 r.n / r^3), the symmetric r_i r_j / r^3 gives the displacement
(its trace is 1 / r).

Source: Lang and Pai (2001), eq. 2 and 3; Brebbia, Telles and Wrobel, Boundary Element Techniques
(1984), chapter 5.
"""

import numba
import numpy as np
from jaxtyping import Float

from palpate.errors import InputError

LANES = 32
TRACTION_FIELDS = 9
DISPLACEMENT_FIELDS = 6


def kelvin_displacement(
    r: Float[np.ndarray, "n 3"], shear_modulus: float, poisson_ratio: float
) -> Float[np.ndarray, "n 3 3"]:
    """Displacement at x per unit point force at y in unbounded elastic space.

    Parameters
    ----------
    r : (n, 3) float [m]            x - y, non-zero
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu <= 0.5

    Returns
    -------
    (n, 3, 3) float [m/N]           entry [n, i, j]: force along i, component j; symmetric

    Raises
    ------
    InputError                      modulus or ratio out of range

    Source
    ------
    Lang and Pai (2001), eq. 3
    """
    check_material(shear_modulus, poisson_ratio)
    distance = np.linalg.norm(r, axis=1)[:, None, None]
    outer = r[:, :, None] * r[:, None, :]
    part = (3 - 4 * poisson_ratio) * np.eye(3) / distance + outer / distance**3
    return part / (16 * np.pi * shear_modulus * (1 - poisson_ratio))


def kelvin_traction(
    r: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "n 3"], poisson_ratio: float
) -> Float[np.ndarray, "n 3 3"]:
    """Traction at x on a plane of given normal per unit point force at y in unbounded elastic
    space.

    Parameters
    ----------
    r : (n, 3) float [m]            x - y, non-zero
    normal : (n, 3) float [-]       unit normals at x
    poisson_ratio : float [-]       -1 < nu <= 0.5

    Returns
    -------
    (n, 3, 3) float [1/m^2]         entry [n, i, j]: force along i, component j

    Raises
    ------
    InputError                      ratio out of range

    Source
    ------
    Lang and Pai (2001), eq. 2
    """
    check_material(1.0, poisson_ratio)
    distance = np.linalg.norm(r, axis=1)[:, None, None]
    outer = r[:, :, None] * r[:, None, :]
    skew = r[:, :, None] * normal[:, None, :] - normal[:, :, None] * r[:, None, :]
    flux = np.einsum("ni,ni->n", r, normal)[:, None, None]
    a = (skew - np.eye(3) * flux) / distance**3
    b = -3 * outer * flux / distance**5
    return ((1 - 2 * poisson_ratio) * a + b) / (8 * np.pi * (1 - poisson_ratio))


def check_material(shear_modulus: float, poisson_ratio: float) -> None:
    """Refuse constants that no isotropic elastic solid has.

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


@numba.njit(fastmath=True, error_model="numpy", inline="always")
def _reciprocal_root(square):
    # One Newton step from single precision: 5e-15 relative, at half the cost of a double square
    # root and division.
    start = np.float64(np.float32(1.0) / np.sqrt(np.float32(square)))
    return start * (1.5 - 0.5 * square * start * start)


@numba.njit(fastmath=True, error_model="numpy", cache=True)
def traction_fields(points, source, out):
    """The nine fields of the traction kernel, from LANES load points to one surface point.

    Parameters
    ----------
    points : (3 LANES,) float [m]   load points y, coordinate-major
    source : (6,) float             surface point x [m], normal times weight [m^2]
    out : (9 LANES,) float          overwritten: r x n / r^3 (x, y, z), then 3 r_i r_j r.n / r^5 (xx
                                    yy zz yz zx xy)
    """
    px, py, pz = source[0], source[1], source[2]
    nx, ny, nz = source[3], source[4], source[5]
    for i in range(LANES):
        rx = px - points[i]
        ry = py - points[LANES + i]
        rz = pz - points[2 * LANES + i]
        s = _reciprocal_root(rx * rx + ry * ry + rz * rz)
        s3 = s * s * s
        flux = 3.0 * (rx * nx + ry * ny + rz * nz) * s3 * s * s
        out[i] = (ry * nz - rz * ny) * s3
        out[LANES + i] = (rz * nx - rx * nz) * s3
        out[2 * LANES + i] = (rx * ny - ry * nx) * s3
        out[3 * LANES + i] = rx * rx * flux
        out[4 * LANES + i] = ry * ry * flux
        out[5 * LANES + i] = rz * rz * flux
        out[6 * LANES + i] = ry * rz * flux
        out[7 * LANES + i] = rz * rx * flux
        out[8 * LANES + i] = rx * ry * flux


@numba.njit(fastmath=True, error_model="numpy", cache=True)
def displacement_fields(points, source, out):
    """The six fields of the displacement kernel, from LANES load points to one surface point.

    Parameters
    ----------
    points : (3 LANES,) float [m]   load points y, coordinate-major
    source : (6,) float             surface point x [m], normal times weight [m^2]
    out : (6 LANES,) float          overwritten: area r_i r_j / r^3 (xx yy zz yz zx xy)
    """
    px, py, pz = source[0], source[1], source[2]
    area = np.sqrt(source[3] * source[3] + source[4] * source[4] + source[5] * source[5])
    for i in range(LANES):
        rx = px - points[i]
        ry = py - points[LANES + i]
        rz = pz - points[2 * LANES + i]
        s = _reciprocal_root(rx * rx + ry * ry + rz * rz)
        s3 = s * s * s * area
        out[i] = rx * rx * s3
        out[LANES + i] = ry * ry * s3
        out[2 * LANES + i] = rz * rz * s3
        out[3 * LANES + i] = ry * rz * s3
        out[4 * LANES + i] = rz * rx * s3
        out[5 * LANES + i] = rx * ry * s3
