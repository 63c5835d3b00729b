"""Displacement and stress inside a loaded object, by Somigliana's identity.

Points outside the object, or closer to its surface than 5 % of a triangle's radius, are refused.
With r = x - y from an interior point y to the surface point x, e = r / |r|, n the outward normal at
x, t and u traction and displacement there, a = 1 - 2 nu, multiplied by 8 pi (1 - nu):

    displacement   int [(3 - 4 nu) t_i + e_i e.t] / (2 G r) - int T_ij u_j     (T as in `kelvin`)
    stress         int [a (t_i e_j + t_j e_i - delta_ij e.t) + 3 e_i e_j e.t] / r^2 - int S_ij
                   S_ij = 2 G / r^3 { 3 e.n [a delta_ij e.u + nu (u_i e_j + u_j e_i)
                                             - 5 e_i e_j e.u] + 3 nu (n_i e_j + n_j e_i) e.u
                                      + a (3 u.n e_i e_j + n_i u_j + n_j u_i)
                                      - (1 - 4 nu) u.n delta_ij }

Source: Brebbia, Telles and Wrobel, Boundary Element Techniques (1984), eq. 5.4.5, 5.6.4 to 5.6.6.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array

from palpate.bem.elastic_map import ElasticMap, ElasticState
from palpate.bem.integrals.assembly import all_rules
from palpate.bem.integrals.element_integrals import next_part, part_point, whole_triangle
from palpate.bem.integrals.surface import Quadrature
from palpate.bem.loads.local_indentation import indentation_corrections
from palpate.bem.loads.surface_load import LoadCells, SurfaceLoad, load_points
from palpate.errors import InputError
from palpate.geometry import QuadraticNodes
from palpate.threads import in_threads

# Smallest distance from the surface over a triangle's radius: closer, quadrature is inaccurate.
_MIN_CLEARANCE = 0.05
_QUADRATURE = Quadrature(tolerance=1e-8)
# A coordinate outside every object [m].
_FAR_AWAY = 1e6
_LOAD_CELLS = LoadCells(degree=7, rim_points=4, polar_points=8, coarsest=2, finest=9)
# Displacement, stress by rows, solid angle.
VALUES = 13


@dataclass(frozen=True, slots=True, eq=False)
class InteriorState:
    """Displacement and stress at points inside an object.

    Attributes
    ----------
    displacement : (n, 3) float [m]
    stress : (n, 3, 3) float [Pa]         symmetric, tension positive
    """

    displacement: Float[np.ndarray, "n 3"]
    stress: Float[np.ndarray, "n 3 3"]


def interior_state(
    elastic_map: ElasticMap,
    load: SurfaceLoad,
    force: Float[np.ndarray, "3"],
    points: Float[np.ndarray, "n 3"],
) -> InteriorState:
    """Displacement and stress inside an object under one load.

    Body forces are not included: the effect of gravity alone is not added.

    Parameters
    ----------
    elastic_map : ElasticMap
    load : SurfaceLoad
    force : (3,) float [N]            total force of the load on the object
    points : (n, 3) float [m]         inside, at least 5 % of a triangle's radius from the surface

    Returns
    -------
    InteriorState

    Raises
    ------
    InputError                        a point is outside the object, or too close to its surface
    NotConvergedError                 as in `ElasticMap.respond`

    Source
    ------
    Brebbia, Telles and Wrobel, Boundary Element Techniques (1984), eq. 5.4.5 and 5.6.6
    """
    (state,) = elastic_map.respond([load], force[None])
    modulus, nu = elastic_map.shear_modulus, elastic_map.poisson_ratio
    fields = _solved_fields(elastic_map, state, load, force)
    inside = interior_values(*fields, points, shear_modulus=modulus, poisson_ratio=nu)
    load = replace(load, cells=_LOAD_CELLS)
    load_samples = load_points(elastic_map.system.surface, load, near=points)
    forces = load_samples.weight[:, None] * force
    out = np.zeros((len(points), VALUES))
    in_threads(
        sum_forces, len(points), np.array(points), load_samples.position, forces, modulus, nu, out
    )
    added = _as_state(out, nu)
    return InteriorState(inside.displacement + added.displacement, inside.stress + added.stress)


def interior_values(
    element_nodes: Float[np.ndarray, "m 6 3"],
    displacement: Float[np.ndarray, "m 6 3"],
    traction: Float[np.ndarray, "m 6 3"],
    points: Float[np.ndarray, "n 3"],
    *,
    shear_modulus: float,
    poisson_ratio: float,
) -> InteriorState:
    """Displacement and stress inside a closed surface of known displacement and traction.

    Parameters
    ----------
    element_nodes : (m, 6, 3) float [m]    corners, then midpoints of edges 01, 12, 20
    displacement : (m, 6, 3) float [m]     at these nodes, quadratic on each triangle
    traction : (m, 6, 3) float [Pa]        likewise; it may jump between triangles
    points : (n, 3) float [m]         inside, at least 5 % of a triangle's radius from the surface
    shear_modulus : float [Pa]
    poisson_ratio : float [-]         -1 < nu <= 0.5

    Returns
    -------
    InteriorState

    Raises
    ------
    InputError                        a point is outside the object, or too close to its surface
    """
    out, clearance = np.zeros((len(points), VALUES)), np.full(len(points), np.inf)
    values = np.concatenate([displacement, traction], axis=2)
    # NaN counts as outside; the kernels would subdivide every triangle to the last level for it.
    positions = np.where(np.isfinite(points).all(axis=1)[:, None], points, _FAR_AWAY)
    in_threads(
        _sum_surface, len(points), positions, np.array(element_nodes), values,
        all_rules(_QUADRATURE), shear_modulus, poisson_ratio, out, clearance,
    )  # fmt: skip
    angle = out[:, 12] / (4 * np.pi)
    _refuse(
        clearance < _MIN_CLEARANCE, points,
        f"within {_MIN_CLEARANCE:.0%} of a triangle's radius of the surface",
        "move them inward, refine the mesh there, or use the displacement of the surface itself",
    )  # fmt: skip
    _refuse(
        ~(angle > 0.5), points, "outside the object",
        "check their frame and that they are in metres",
    )  # fmt: skip
    return _as_state(out, poisson_ratio)


@numba.njit(error_model="numpy", cache=True)
def add_force(point, position, force, shear_modulus, nu, out):
    """Add displacement and stress at a point due to a point force in unbounded space.

    Both are multiplied by 8 pi (1 - nu).

    Parameters
    ----------
    point : (3,) float [m]
    position : (3,) or longer float [m]     of the force, distinct from the point
    force : (3,) float [N]                  traction times area
    shear_modulus, nu : float               [Pa], [-]
    out : (13,) float                       added to: displacement (3), stress (9, by rows); the
                                            last entry, the solid angle, is unchanged
    """
    e, s = _direction(point, position)
    a, along = 1 - 2 * nu, _dot(e, force)
    for i in range(3):
        out[i] += 0.5 * s / shear_modulus * ((3 - 4 * nu) * force[i] + e[i] * along)
        out[3 + 4 * i] -= s * s * a * along
        for j in range(3):
            shear = a * (force[i] * e[j] + force[j] * e[i])
            out[3 + 3 * i + j] += s * s * (shear + 3 * e[i] * e[j] * along)


@numba.njit(error_model="numpy", cache=True)
def subtract_displaced_surface(point, source, weight, u, shear_modulus, nu, out):
    """Subtract the contribution of a displaced surface element, and add its solid angle.

    The contribution to displacement and stress at a point is multiplied by 8 pi (1 - nu).

    Parameters
    ----------
    point : (3,) float [m]
    source : (6,) float                     position [m], outward normal times area [m^2]
    weight : float                          quadrature weight of that area
    u : (3,) float [m]                      displacement there
    shear_modulus, nu : float               [Pa], [-]
    out : (13,) float                       changed: displacement (3), stress (9, by rows), solid
                                            angle
    """
    e, s = _direction(point, source)
    n = (weight * source[3], weight * source[4], weight * source[5])
    a, s2, c = 1 - 2 * nu, s * s, 2 * shear_modulus * s * s * s
    flux, eu, un = _dot(e, n), _dot(e, u), _dot(u, n)
    out[12] += s2 * flux
    p, q, outer = 3 * nu * flux, 3 * nu * eu, 3 * a * un - 15 * eu * flux
    for i in range(3):
        out[i] -= s2 * (a * (e[i] * un - n[i] * eu - u[i] * flux) - 3 * eu * flux * e[i])
        out[3 + 4 * i] -= c * (3 * a * eu * flux - (1 - 4 * nu) * un)
        for j in range(3):
            mixed = p * (u[i] * e[j] + u[j] * e[i]) + q * (n[i] * e[j] + n[j] * e[i])
            mixed += a * (n[i] * u[j] + n[j] * u[i])
            out[3 + 3 * i + j] -= c * (mixed + outer * e[i] * e[j])


@numba.njit(nogil=True, error_model="numpy", cache=True)
def sum_forces(begin, end, points, positions, forces, shear_modulus, nu, out):
    """Add all forces for the points from begin to end; see `add_force`.

    Parameters
    ----------
    points : (n, 3) float [m]
    positions : (q, 3) or wider float [m]   of the forces
    forces : (q, 3) float [N]
    shear_modulus, nu : float               [Pa], [-]
    out : (n, 13) float                     added to
    """
    for k in range(begin, end):
        for q in range(positions.shape[0]):
            add_force(points[k], positions[q], forces[q], shear_modulus, nu, out[k])


def _as_state(out: Float[np.ndarray, "n 13"], poisson_ratio: float) -> InteriorState:
    scaled = out / (8 * np.pi * (1 - poisson_ratio))
    return InteriorState(scaled[:, :3].copy(), scaled[:, 3:12].reshape(-1, 3, 3).copy())


def _refuse(
    bad: Bool[np.ndarray, " n"], points: Float[np.ndarray, "n 3"], where: str, cure: str
) -> None:
    if bad.any():
        first = np.flatnonzero(bad)
        raise InputError(
            f"{first.size} of {bad.size} points are {where} (first: number {first[0]} at "
            f"{points[first[0]].tolist()} m); interior points must lie well inside: {cure}"
        )


def _solved_fields(
    elastic_map: ElasticMap, state: ElasticState, load: SurfaceLoad, force: Float[np.ndarray, "3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes and displacement of all elements and traction of the support, as interpolated in the
    solution."""
    system, nu = elastic_map.system, elastic_map.poisson_ratio
    surface = system.surface
    displacement = _with_midside_values(surface.displacement, state.displacement)
    (local,) = indentation_corrections(surface, [load])
    if local is not None:
        correction = (
            (local.correction[0] + nu * local.correction[1]) @ force / elastic_map.shear_modulus
        )
        displacement[surface.displacement.n_nodes + local.midside_nodes] += correction
    traction = np.zeros((surface.traction.n_nodes, 3))
    traction[system.unknowns.held_sides] = state.support_traction
    traction = _with_midside_values(surface.traction, traction)
    return (
        surface.element_nodes,
        displacement[surface.displacement.element],
        traction[surface.traction.element],
    )


def _with_midside_values(
    nodes: QuadraticNodes, values: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "p 3"]:
    return np.concatenate([values, csr_array(nodes.weights) @ values])


@numba.njit(error_model="numpy", inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(error_model="numpy", inline="always")
def _direction(point, position):
    """Unit vector from a point to a place, and their reciprocal distance."""
    x, y, z = position[0] - point[0], position[1] - point[1], position[2] - point[2]
    s = 1.0 / np.sqrt(x * x + y * y + z * z)
    return (x * s, y * s, z * s), s


@numba.njit(nogil=True, error_model="numpy", cache=True)
def _sum_surface(begin, end, points, nodes, values, rules, shear_modulus, nu, out, clearance):
    """Integrate over the surface for the points from begin to end.

    Parameters
    ----------
    points : (n, 3) float [m]
    nodes : (m, 6, 3) float [m]             six-node triangles
    values : (m, 6, 6) float                displacement [m], then traction [Pa], at these nodes
    rules : Rules
    shear_modulus, nu : float               [Pa], [-]
    out : (n, 13) float                     added to (`add_force`, `subtract_displaced_surface`)
    clearance : (n,) float                  lowered to the distance from the surface over the
                                            radius of the nearest triangle, accurate to about 10 %
    """
    shape, source, part = np.empty(6), np.empty(6), np.empty(10)
    u, force = np.empty(3), np.empty(3)
    for k in range(begin, end):
        for e in range(nodes.shape[0]):
            stack = whole_triangle()
            depth = 1
            while depth > 0:
                depth, rule, ratio = next_part(
                    points[k], nodes[e], rules.ratios, stack, depth, part
                )
                clearance[k] = min(clearance[k], ratio * np.sqrt(part[9]))
                for r in range(rules.start[rule], rules.start[rule + 1]):
                    weight = part_point(nodes[e], rules.points[r], part, shape, source)
                    area = weight * np.sqrt(_dot(source[3:], source[3:]))
                    u[:], force[:] = 0.0, 0.0
                    for a in range(6):
                        for i in range(3):
                            u[i] += shape[a] * values[e, a, i]
                            force[i] += shape[a] * area * values[e, a, 3 + i]
                    subtract_displaced_surface(
                        points[k], source, weight, u, shear_modulus, nu, out[k]
                    )
                    if force[0] != 0 or force[1] != 0 or force[2] != 0:
                        add_force(points[k], source, force, shear_modulus, nu, out[k])
