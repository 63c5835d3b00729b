"""Somigliana's identity: displacement and stress inside an object from those of its surface.

With r = x - y from the inner point y to the surface point x, e = r / |r|, n the outward normal at
x, t and u traction and displacement there, a = 1 - 2 nu, multiplied by 8 pi (1 - nu):

    displacement   int [(3 - 4 nu) t_i + e_i e.t] / (2 G r) - int T_ij u_j     (T as in `kelvin`)
    stress         int [a (t_i e_j + t_j e_i - delta_ij e.t) + 3 e_i e_j e.t] / r^2 - int S_ij
                   S_ij = 2 G / r^3 { 3 e.n [a delta_ij e.u + nu (u_i e_j + u_j e_i)
                                             - 5 e_i e_j e.u] + 3 nu (n_i e_j + n_j e_i) e.u
                                      + a (3 u.n e_i e_j + n_i u_j + n_j u_i)
                                      - (1 - 4 nu) u.n delta_ij }

Source: Brebbia, Telles and Wrobel, Boundary Element Techniques (1984), eq. 5.4.5, 5.6.4 to 5.6.6.
"""

import numpy as np
from jaxtyping import Float


def force_values(
    point: Float[np.ndarray, "3"],
    position: Float[np.ndarray, "q 3"],
    force: Float[np.ndarray, "q 3"],
    *,
    shear_modulus: float,
    poisson_ratio: float,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Displacement and stress that point forces give in unbounded elastic space.

    Parameters
    ----------
    point : (3,) float [m]                none of the positions
    position : (q, 3) float [m]
    force : (q, 3) float [N]              traction times area
    shear_modulus : float [Pa]
    poisson_ratio : float [-]             -1 < nu <= 0.5

    Returns
    -------
    (3,) float [m], (3, 3) float [Pa]

    Source
    ------
    Brebbia, Telles and Wrobel (1984), first terms of eq. 5.4.5 and 5.6.4
    """
    e, s = _direction(point, position)
    along = (e * force).sum(axis=1)
    displacement = s @ ((3 - 4 * poisson_ratio) * force) + (s * along) @ e
    weight = s * s
    shear = (weight[:, None] * force).T @ e
    stress = (1 - 2 * poisson_ratio) * (shear + shear.T - weight @ along * np.eye(3))
    stress += 3 * (e * (weight * along)[:, None]).T @ e
    scale = 1 / (8 * np.pi * (1 - poisson_ratio))
    return scale / (2 * shear_modulus) * displacement, scale * stress


def displaced_surface_values(
    point: Float[np.ndarray, "3"],
    source: Float[np.ndarray, "q 6"],
    u: Float[np.ndarray, "q 3"],
    *,
    shear_modulus: float,
    poisson_ratio: float,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Displacement and stress that the displacement of a closed surface gives inside.

    Parameters
    ----------
    point : (3,) float [m]
    source : (q, 6) float                 places on the surface [m], outward normals times area
                                          [m^2]
    u : (q, 3) float [m]                  displacement there
    shear_modulus : float [Pa]
    poisson_ratio : float [-]             -1 < nu <= 0.5

    Returns
    -------
    (3,) float [m], (3, 3) float [Pa]

    Source
    ------
    Brebbia, Telles and Wrobel (1984), last terms of eq. 5.4.5 and 5.6.4
    """
    nu, a = poisson_ratio, 1 - 2 * poisson_ratio
    e, s = _direction(point, source[:, :3])
    n = source[:, 3:]
    flux, eu, un = (e * n).sum(axis=1), (e * u).sum(axis=1), (u * n).sum(axis=1)
    s2, s3 = s**2, s**3
    displacement = a * ((s2 * un) @ e - (s2 * eu) @ n - (s2 * flux) @ u) - 3 * (s2 * eu * flux) @ e
    mixed = 3 * nu * ((s3 * flux)[:, None] * u + (s3 * eu)[:, None] * n).T @ e
    mixed += a * (s3[:, None] * n).T @ u
    outer = 3 * (e * (s3 * (a * un - 5 * eu * flux))[:, None]).T @ e
    same = s3 @ (3 * a * eu * flux - (1 - 4 * nu) * un)
    stress = 2 * shear_modulus * (mixed + mixed.T + outer + same * np.eye(3))
    scale = -1 / (8 * np.pi * (1 - nu))
    return scale * displacement, scale * stress


def solid_angle(point: Float[np.ndarray, "3"], source: Float[np.ndarray, "q 6"]) -> float:
    """Solid angle of a closed surface over 4 pi: 1 from inside, 0 from outside.

    Parameters
    ----------
    point : (3,) float [m]
    source : (q, 6) float                 places on the surface [m], outward normals times area
                                          [m^2]

    Returns
    -------
    float [-]
    """
    e, s = _direction(point, source[:, :3])
    return float(s**2 @ (e * source[:, 3:]).sum(axis=1)) / (4 * np.pi)


def _direction(
    point: Float[np.ndarray, "3"], position: Float[np.ndarray, "q 3"]
) -> tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, " q"]]:
    """Unit vectors from the point, and one over the distance."""
    r = position - point
    s = 1 / np.linalg.norm(r, axis=1)
    return r * s[:, None], s
