"""Displacement and stress inside a loaded object.

They follow from displacement and traction on its surface (Somigliana's identity, `somigliana.py`).
Points outside the object, or closer to its surface than 5 % of a triangle's radius, are refused.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array

from palpate.bem.elastic_map import ElasticMap, ElasticState
from palpate.bem.integrals.assembly import all_rules
from palpate.bem.integrals.quadrature import Quadrature
from palpate.bem.interior.somigliana import VALUES, sum_forces, sum_surface
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
    inside = interior_values(fields, points, shear_modulus=modulus, poisson_ratio=nu)
    load_samples = load_points(elastic_map.system.surface, load, cells=_LOAD_CELLS, near=points)
    forces = load_samples.weight[:, None] * force
    out = np.zeros((len(points), VALUES))
    in_threads(
        sum_forces, len(points), np.array(points), load_samples.position, forces, modulus, nu, out
    )
    added = _as_state(out, nu)
    return InteriorState(inside.displacement + added.displacement, inside.stress + added.stress)


def interior_values(
    fields: BoundaryFields,
    points: Float[np.ndarray, "n 3"],
    *,
    shear_modulus: float,
    poisson_ratio: float,
) -> InteriorState:
    """Displacement and stress inside a closed surface of known displacement and traction.

    Parameters
    ----------
    fields : BoundaryFields
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
    values = np.concatenate([fields.displacement, fields.traction], axis=2)
    # NaN counts as outside; the kernels would subdivide every triangle to the last level for it.
    positions = np.where(np.isfinite(points).all(axis=1)[:, None], points, _FAR_AWAY)
    in_threads(
        sum_surface, len(points), positions, np.array(fields.element_nodes), values,
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
) -> BoundaryFields:
    """Displacement of all elements and traction of the support, as interpolated in the solution."""
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
    return BoundaryFields(
        surface.element_nodes,
        displacement[surface.displacement.element],
        traction[surface.traction.element],
    )


def _with_midside_values(
    nodes: QuadraticNodes, values: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "p 3"]:
    return np.concatenate([values, csr_array(nodes.weights) @ values])
