"""Displacement and stress inside a loaded object: where it strains.

The solved surface says everything about the inside (Somigliana's identity, `somigliana.py`). Points
may come within 5 % of a triangle's radius of the surface; closer than that, and outside, they are
refused.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from palpate.bem.elastic_map import ElasticMap, ElasticState, load_shape
from palpate.bem.integrals import (
    BoundarySurface,
    Quadrature,
    quadratic_shapes,
    quadratic_slopes,
    triangle_rule,
)
from palpate.bem.interior.somigliana import BoundaryFields, integrate_forces, integrate_surface
from palpate.bem.loads import SurfaceLoad
from palpate.errors import InputError
from palpate.geometry import QuadraticNodes

SMALLEST_CLEARANCE = 0.05
INTERIOR_QUADRATURE = Quadrature(tolerance=1e-8)
LOAD_DEGREE = 7
LOAD_RATIO = 4.0
LOAD_LEVELS = (2, 5, 9)


@dataclass(frozen=True, slots=True, eq=False)
class InteriorState:
    """What happens at points inside an object.

    Attributes
    ----------
    displacement : (n, 3) float [m]
    stress : (n, 3, 3) float [Pa]         symmetric; [i, j]: along j on a plane of normal i,
                                          tension positive
    """

    displacement: Float[np.ndarray, "n 3"]
    stress: Float[np.ndarray, "n 3 3"]


def interior_state(
    elastic_map: ElasticMap,
    load: SurfaceLoad,
    force: Float[np.ndarray, "3"],
    points: Float[np.ndarray, "n 3"],
    *,
    quadrature: Quadrature = INTERIOR_QUADRATURE,
) -> InteriorState:
    """Displacement and stress inside an object under one load.

    Body forces are not part of it: what gravity alone does is not added.

    Parameters
    ----------
    elastic_map : ElasticMap
    load : SurfaceLoad
    force : (3,) float [N]            total force of the load on the object
    points : (n, 3) float [m]         inside, at least 5 % of a triangle's radius from the surface
    quadrature : Quadrature

    Returns
    -------
    InteriorState

    Raises
    ------
    InputError                        a point is outside the object, or too close to its surface

    Source
    ------
    Brebbia, Telles and Wrobel, Boundary Element Techniques (1984), eq. 5.4.5 and 5.6.6
    """
    surface = elastic_map.system.surface
    (state,) = elastic_map.respond([load], force[None])
    fields = _solved_fields(elastic_map, state, load, force)
    inside = interior_values(
        fields, points, shear_modulus=elastic_map.shear_modulus,
        poisson_ratio=elastic_map.poisson_ratio, quadrature=quadrature,
    )  # fmt: skip
    position, share = _load_points_near(surface, load, points)
    displacement, stress = integrate_forces(
        position, share[:, None] * force, points,
        shear_modulus=elastic_map.shear_modulus, poisson_ratio=elastic_map.poisson_ratio,
    )  # fmt: skip
    return InteriorState(inside.displacement + displacement, inside.stress + stress)


def interior_values(
    fields: BoundaryFields,
    points: Float[np.ndarray, "n 3"],
    *,
    shear_modulus: float,
    poisson_ratio: float,
    quadrature: Quadrature = INTERIOR_QUADRATURE,
) -> InteriorState:
    """Displacement and stress inside a closed surface of known displacement and traction.

    Parameters
    ----------
    fields : BoundaryFields
    points : (n, 3) float [m]         inside, at least 5 % of a triangle's radius from the surface
    shear_modulus : float [Pa]
    poisson_ratio : float [-]         -1 < nu <= 0.5
    quadrature : Quadrature

    Returns
    -------
    InteriorState

    Raises
    ------
    InputError                        a point is outside the object, or too close to its surface
    """
    values = integrate_surface(
        fields, points, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio,
        quadrature=quadrature,
    )  # fmt: skip
    close = values.clearance < SMALLEST_CLEARANCE
    _refuse(
        close, points, f"within {SMALLEST_CLEARANCE:.0%} of a triangle's radius of the surface",
        "move them inward, refine the mesh there, or use the displacement of the surface itself",
    )  # fmt: skip
    _refuse(
        ~(values.solid_angle > 0.5), points, "outside the object",
        "check their frame and that they are in metres",
    )  # fmt: skip
    return InteriorState(values.displacement, values.stress)


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
    """Displacement of every element and traction of the support's, as the solution had them."""
    system, nu = elastic_map.system, elastic_map.poisson_ratio
    surface = system.surface
    displacement = _with_midpoints(surface.displacement, state.displacement)
    shape = load_shape(surface, load)
    if shape is not None:
        missing = (shape.missing[0] + nu * shape.missing[1]) @ force / elastic_map.shear_modulus
        displacement[surface.displacement.n_nodes + shape.midpoints] += missing
    traction = np.zeros((surface.traction.n_nodes, 3))
    traction[system.unknowns.held_sides] = state.support_traction
    traction = _with_midpoints(surface.traction, traction)
    return BoundaryFields(
        surface.element_nodes,
        displacement[surface.displacement.element],
        traction[surface.traction.element],
    )


def _with_midpoints(
    nodes: QuadraticNodes, values: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "p 3"]:
    return np.concatenate([values, csr_array(nodes.weights) @ values])


def _load_points_near(
    surface: BoundarySurface, load: SurfaceLoad, points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, " q"]]:
    """Places and shares of a load, in cells as small as the nearest point asks for."""
    rule = triangle_rule(LOAD_DEGREE)
    coarsest, rim_finest, finest = LOAD_LEVELS
    tree = cKDTree(points)
    triangle = np.asarray(load.triangles, dtype=np.int64)
    corners = np.tile(np.eye(3), (triangle.size, 1, 1))
    positions, weights = [], []
    for level in range(finest + 1):
        barycentric = np.einsum("qk,ckj->cqj", rule.barycentric, corners)
        position, area = _places(surface, triangle, barycentric)
        density = load.density(
            np.repeat(triangle, rule.weight.size),
            barycentric.reshape(-1, 3),
            position.reshape(-1, 3),
        ).reshape(area.shape)
        centre = position.mean(axis=1)
        size = np.linalg.norm(position - centre[:, None], axis=2).max(axis=1)
        rim = (density == 0).any(axis=1) & (level < rim_finest)
        far = tree.query(centre)[0] >= LOAD_RATIO * size
        done = ((level >= coarsest) & ~rim & far) | (level == finest)
        weight = density[done] * area[done] * rule.weight * 0.25**level
        kept = weight > 0
        positions.append(position[done][kept])
        weights.append(weight[kept])
        divide = ~done & ((density > 0).any(axis=1) | (level < coarsest))
        triangle, corners = _quarters(triangle[divide], corners[divide])
    weight = np.concatenate(weights)
    return np.concatenate(positions), weight / weight.sum()


def _places(
    surface: BoundarySurface,
    triangle: Int[np.ndarray, " c"],
    barycentric: Float[np.ndarray, "c q 3"],
) -> tuple[Float[np.ndarray, "c q 3"], Float[np.ndarray, "c q"]]:
    flat = barycentric.reshape(-1, 3)
    parts = np.stack([quadratic_shapes(flat), *quadratic_slopes(flat)])
    parts = parts.reshape(3, 6, *barycentric.shape[:2])
    place, along_b, along_c = np.einsum("dacq,cai->dcqi", parts, surface.element_nodes[triangle])
    return place, np.linalg.norm(np.cross(along_b, along_c), axis=2)


def _quarters(
    triangle: Int[np.ndarray, " c"], corners: Float[np.ndarray, "c 3 3"]
) -> tuple[Int[np.ndarray, " d"], Float[np.ndarray, "d 3 3"]]:
    a, b, c = corners.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.tile(triangle, 4), np.concatenate([np.stack(part, axis=1) for part in parts])
