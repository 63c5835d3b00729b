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

from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float

from palpate.bem.integrals import (
    Quadrature,
    element_points,
    element_spheres,
    quadratic_shapes,
    surface_point,
    triangle_rule,
)

VALUES = 10
DEEPEST = 8
LARGEST_STACK = 3 * DEEPEST + 4


@dataclass(frozen=True, slots=True, eq=False)
class BoundaryFields:
    """Displacement and traction of a closed surface, quadratic on each triangle.

    The traction may jump between triangles.

    Attributes
    ----------
    element_nodes : (m, 6, 3) float [m]   corners, then midpoints of edges 01, 12, 20
    displacement : (m, 6, 3) float [m]    at these nodes
    traction : (m, 6, 3) float [Pa]       at these nodes
    """

    element_nodes: Float[np.ndarray, "m 6 3"]
    displacement: Float[np.ndarray, "m 6 3"]
    traction: Float[np.ndarray, "m 6 3"]


@dataclass(frozen=True, slots=True, eq=False)
class InnerValues:
    """Somigliana's integrals at some points, and where these lie.

    Attributes
    ----------
    displacement : (n, 3) float [m]
    stress : (n, 3, 3) float [Pa]
    solid_angle : (n,) float [-]          over 4 pi: 1 inside, 0 outside
    clearance : (n,) float [-]            distance from the surface over the radius of the nearest
                                          triangle, to about a tenth; infinite where none is near
    """

    displacement: Float[np.ndarray, "n 3"]
    stress: Float[np.ndarray, "n 3 3"]
    solid_angle: Float[np.ndarray, " n"]
    clearance: Float[np.ndarray, " n"]


def integrate_surface(
    fields: BoundaryFields,
    points: Float[np.ndarray, "n 3"],
    *,
    shear_modulus: float,
    poisson_ratio: float,
    quadrature: Quadrature,
) -> InnerValues:
    """What displacement and traction of a surface mean at points inside.

    Parameters
    ----------
    fields : BoundaryFields
    points : (n, 3) float [m]
    shear_modulus : float [Pa]
    poisson_ratio : float [-]             -1 < nu <= 0.5
    quadrature : Quadrature               a triangle too close for its last rule is divided, up to
                                          8 times

    Returns
    -------
    InnerValues
    """
    nodes = np.ascontiguousarray(fields.element_nodes)
    rules = [triangle_rule(degree) for degree in quadrature.degrees]
    barycentric = np.concatenate([rule.barycentric for rule in rules])
    weight = np.concatenate([rule.weight for rule in rules])
    start = np.cumsum([0] + [rule.weight.size for rule in rules])
    sources = element_points(nodes, barycentric)
    sources[:, :, 3:] *= weight[:, None]
    values = np.concatenate([fields.displacement, fields.traction], axis=2)
    at_points = np.einsum("aq,mai->mqi", quadratic_shapes(barycentric), values)
    near = np.concatenate([rules[-1].barycentric, rules[-1].weight[:, None]], axis=1)
    centre, radius = element_spheres(nodes)
    out = np.zeros((points.shape[0], VALUES))
    clearance = np.full(points.shape[0], np.inf)
    _integrate(
        np.ascontiguousarray(points), nodes, values, sources, at_points, start,
        quadrature.ratios(), centre, radius, near, shear_modulus, poisson_ratio, out, clearance,
    )  # fmt: skip
    out /= 8 * np.pi * (1 - poisson_ratio)
    angle = out[:, 9] * 2 * (1 - poisson_ratio)
    return InnerValues(out[:, :3].copy(), _as_tensor(out[:, 3:9]), angle, clearance)


def integrate_forces(
    position: Float[np.ndarray, "q 3"],
    force: Float[np.ndarray, "q 3"],
    points: Float[np.ndarray, "n 3"],
    *,
    shear_modulus: float,
    poisson_ratio: float,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
    """Displacement and stress of point forces in unbounded elastic space.

    A load given by its points adds these to what the rest of the surface does.

    Parameters
    ----------
    position : (q, 3) float [m]
    force : (q, 3) float [N]
    points : (n, 3) float [m]             none of the positions
    shear_modulus : float [Pa]
    poisson_ratio : float [-]             -1 < nu <= 0.5

    Returns
    -------
    (n, 3) float [m], (n, 3, 3) float [Pa]
    """
    out = np.zeros((points.shape[0], VALUES))
    _sum_forces(
        np.ascontiguousarray(points), np.ascontiguousarray(position),
        np.ascontiguousarray(force), shear_modulus, poisson_ratio, out,
    )  # fmt: skip
    out /= 8 * np.pi * (1 - poisson_ratio)
    return out[:, :3].copy(), _as_tensor(out[:, 3:9])


def _as_tensor(six: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "n 3 3"]:
    return six[:, np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])]


@numba.njit(error_model="numpy", cache=True)
def add_traction(point, source, t, shear_modulus, nu, out):
    """Add a force's displacement and stress at a point.

    Parameters
    ----------
    point : (3,) float [m]
    source : (3,) or longer float           place of the force [m] first
    t : (3,) float [N]                      traction times area
    shear_modulus, nu : float
    out : (10,) float                       added to: displacement (3), stress xx yy zz yz zx xy;
                                            the last stays
    """
    x, y, z = source[0] - point[0], source[1] - point[1], source[2] - point[2]
    s = 1.0 / np.sqrt(x * x + y * y + z * z)
    x, y, z = x * s, y * s, z * s
    along = x * t[0] + y * t[1] + z * t[2]
    scale = 0.5 * s / shear_modulus
    out[0] += scale * ((3 - 4 * nu) * t[0] + x * along)
    out[1] += scale * ((3 - 4 * nu) * t[1] + y * along)
    out[2] += scale * ((3 - 4 * nu) * t[2] + z * along)
    a = (1 - 2 * nu) * s * s
    b = 3 * along * s * s
    out[3] += a * (2 * t[0] * x - along) + b * x * x
    out[4] += a * (2 * t[1] * y - along) + b * y * y
    out[5] += a * (2 * t[2] * z - along) + b * z * z
    out[6] += a * (t[1] * z + t[2] * y) + b * y * z
    out[7] += a * (t[2] * x + t[0] * z) + b * z * x
    out[8] += a * (t[0] * y + t[1] * x) + b * x * y


@numba.njit(error_model="numpy", cache=True)
def subtract_displacement(point, source, u, shear_modulus, nu, out):
    """Subtract what a displaced piece of surface gives at a point, and add its solid angle.

    Parameters
    ----------
    point : (3,) float [m]
    source : (6,) float                     place [m], outward normal times area [m^2]
    u : (3,) float [m]
    shear_modulus, nu : float
    out : (10,) float                       changed: displacement (3), stress xx yy zz yz zx xy,
                                            solid angle
    """
    x, y, z = source[0] - point[0], source[1] - point[1], source[2] - point[2]
    n0, n1, n2 = source[3], source[4], source[5]
    s = 1.0 / np.sqrt(x * x + y * y + z * z)
    x, y, z = x * s, y * s, z * s
    a = 1 - 2 * nu
    flux = x * n0 + y * n1 + z * n2
    eu = x * u[0] + y * u[1] + z * u[2]
    un = u[0] * n0 + u[1] * n1 + u[2] * n2
    s2 = s * s
    b = 3 * eu * flux
    out[0] -= s2 * (a * (x * un - n0 * eu - u[0] * flux) - b * x)
    out[1] -= s2 * (a * (y * un - n1 * eu - u[1] * flux) - b * y)
    out[2] -= s2 * (a * (z * un - n2 * eu - u[2] * flux) - b * z)
    out[9] += s2 * flux
    c = 2 * shear_modulus * s2 * s
    same = a * b - (1 - 4 * nu) * un
    pair = 3 * a * un - 5 * b
    p, q = 3 * nu * flux, 3 * nu * eu
    out[3] -= c * (same + pair * x * x + 2 * (p * u[0] * x + q * n0 * x + a * n0 * u[0]))
    out[4] -= c * (same + pair * y * y + 2 * (p * u[1] * y + q * n1 * y + a * n1 * u[1]))
    out[5] -= c * (same + pair * z * z + 2 * (p * u[2] * z + q * n2 * z + a * n2 * u[2]))
    out[6] -= c * (
        pair * y * z
        + p * (u[1] * z + u[2] * y)
        + q * (n1 * z + n2 * y)
        + a * (n1 * u[2] + n2 * u[1])
    )
    out[7] -= c * (
        pair * z * x
        + p * (u[2] * x + u[0] * z)
        + q * (n2 * x + n0 * z)
        + a * (n2 * u[0] + n0 * u[2])
    )
    out[8] -= c * (
        pair * x * y
        + p * (u[0] * y + u[1] * x)
        + q * (n0 * y + n1 * x)
        + a * (n0 * u[1] + n1 * u[0])
    )


@numba.njit(error_model="numpy", cache=True)
def _add_surface_point(point, source, value, shear_modulus, nu, scaled, out):
    """Both kernels at one surface point whose normal carries its weight; value is displacement,
    then traction."""
    subtract_displacement(point, source, value[:3], shear_modulus, nu, out)
    if value[3] != 0 or value[4] != 0 or value[5] != 0:
        area = np.sqrt(source[3] ** 2 + source[4] ** 2 + source[5] ** 2)
        for i in range(3):
            scaled[i] = value[3 + i] * area
        add_traction(point, source, scaled, shear_modulus, nu, out)


@numba.njit(parallel=True, error_model="numpy", cache=True)
def _integrate(
    points, nodes, values, sources, at_points, start, ratios, centre, radius, near,
    shear_modulus, nu, out, clearance,
):  # fmt: skip
    for k in numba.prange(points.shape[0]):
        point, target = points[k], out[k]
        scaled = np.empty(3)
        for e in range(nodes.shape[0]):
            square = 0.0
            for i in range(3):
                square += (point[i] - centre[e, i]) ** 2
            ratio = np.sqrt(square) / radius[e]
            if ratio < ratios[-1]:
                distance = _add_divided(
                    point, nodes[e], values[e], near, ratios[-1], shear_modulus, nu, target
                )
                clearance[k] = min(clearance[k], distance / radius[e])
                continue
            rule = 0
            while rule < ratios.size - 1 and ratio < ratios[rule]:
                rule += 1
            for q in range(start[rule], start[rule + 1]):
                _add_surface_point(
                    point, sources[e, q], at_points[e, q], shear_modulus, nu, scaled, target
                )


@numba.njit(error_model="numpy", cache=True)
def _add_divided(point, nodes, values, rule, ratio, shear_modulus, nu, out):
    """Divide a triangle until the rule may be used on each part; returns the distance of the
    nearest part's centre."""
    shape, source, value, scaled = np.empty(6), np.empty(6), np.empty(6), np.empty(3)
    stack = np.empty((LARGEST_STACK, 10))
    stack[0] = np.array([1.0, 0, 0, 0, 1, 0, 0, 0, 1, 0.0])
    top, nearest = 1, np.inf
    corner, middle = np.empty((3, 3)), np.empty((3, 3))
    while top > 0:
        top -= 1
        part = stack[top].copy()
        level = part[9]
        for k in range(3):
            surface_point(nodes, part[3 * k], part[3 * k + 1], part[3 * k + 2], shape, source)
            corner[k] = source[:3]
        distance, size = _distance_and_radius(point, corner)
        if distance < ratio * size and level < DEEPEST:
            _push_parts(part, middle, stack, top)
            top += 4
            continue
        nearest = min(nearest, distance)
        for q in range(rule.shape[0]):
            b0 = rule[q, 0] * part[0] + rule[q, 1] * part[3] + rule[q, 2] * part[6]
            b1 = rule[q, 0] * part[1] + rule[q, 1] * part[4] + rule[q, 2] * part[7]
            surface_point(nodes, b0, b1, 1 - b0 - b1, shape, source)
            for i in range(6):
                value[i] = 0.0
                for a in range(6):
                    value[i] += shape[a] * values[a, i]
            for i in range(3):
                source[3 + i] *= rule[q, 3] * 0.25**level
            _add_surface_point(point, source, value, shear_modulus, nu, scaled, out)
    return nearest


@numba.njit(error_model="numpy", cache=True)
def _distance_and_radius(point, corner):
    distance, size = 0.0, 0.0
    for i in range(3):
        distance += (point[i] - (corner[0, i] + corner[1, i] + corner[2, i]) / 3) ** 2
    for k in range(3):
        square = 0.0
        for i in range(3):
            square += (corner[k, i] - (corner[0, i] + corner[1, i] + corner[2, i]) / 3) ** 2
        size = max(size, square)
    return np.sqrt(distance), np.sqrt(size)


@numba.njit(error_model="numpy", cache=True)
def _push_parts(part, middle, stack, top):
    """Put the four quarters of a part on the stack."""
    for k in range(3):
        for i in range(3):
            middle[k, i] = 0.5 * (part[3 * k + i] + part[3 * ((k + 1) % 3) + i])
    for k in range(3):
        for i in range(3):
            stack[top + k, i] = part[3 * k + i]
            stack[top + k, 3 + i] = middle[k, i]
            stack[top + k, 6 + i] = middle[(k + 2) % 3, i]
            stack[top + 3, 3 * k + i] = middle[k, i]
    for k in range(4):
        stack[top + k, 9] = part[9] + 1


@numba.njit(parallel=True, error_model="numpy", cache=True)
def _sum_forces(points, position, force, shear_modulus, nu, out):
    for k in numba.prange(points.shape[0]):
        for q in range(position.shape[0]):
            add_traction(points[k], position[q], force[q], shear_modulus, nu, out[k])
