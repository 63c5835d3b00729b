"""Displacement and stress inside a loaded object: where it strains.

The solved surface says everything about the inside (Somigliana's identity, `somigliana.py`). Points
may come within 5 % of a triangle's radius of the surface; closer than that, and outside, they are
refused.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array

from palpate.bem.elastic_map import ElasticMap, ElasticState, load_shape
from palpate.bem.integrals import Quadrature, triangle_rule
from palpate.bem.interior.somigliana import displaced_surface_values, force_values, solid_angle
from palpate.bem.loads import LoadCells, SurfaceLoad, load_points
from palpate.errors import InputError
from palpate.geometry import QuadraticNodes, element_points, quadratic_shapes, quartered

# Over the radius of a triangle: the integrals of closer points are not to be trusted.
_MIN_CLEARANCE = 0.05
_QUADRATURE = Quadrature(tolerance=1e-8)
# Divisions in four of a triangle that is too close for its last rule.
_MOST_LEVELS = 10
_LOAD_CELLS = LoadCells(degree=7, coarsest=2, finest_rim=5, finest=9)


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
) -> InteriorState:
    """Displacement and stress inside an object under one load.

    Body forces are not part of it: what gravity alone does is not added.

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

    Source
    ------
    Brebbia, Telles and Wrobel, Boundary Element Techniques (1984), eq. 5.4.5 and 5.6.6
    """
    surface = elastic_map.system.surface
    material = {
        "shear_modulus": elastic_map.shear_modulus, "poisson_ratio": elastic_map.poisson_ratio
    }  # fmt: skip
    (state,) = elastic_map.respond([load], force[None])
    inside = interior_values(_solved_fields(elastic_map, state, load, force), points, **material)
    pushed = load_points(surface, load, cells=_LOAD_CELLS, near=points)
    forces = pushed.weight[:, None] * force
    added = [force_values(point, pushed.position, forces, **material) for point in points]
    displacement, stress = (np.array(part) for part in zip(*added, strict=True))
    return InteriorState(inside.displacement + displacement, inside.stress + stress)


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
    quadrature : Quadrature

    Returns
    -------
    InteriorState

    Raises
    ------
    InputError                        a point is outside the object, or too close to its surface
    """
    displacement, stress = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
    angle, clearance = np.empty(len(points)), np.empty(len(points))
    material = {"shear_modulus": shear_modulus, "poisson_ratio": poisson_ratio}
    for k, point in enumerate(points):
        source, u, t, clearance[k] = _surface_seen_from(fields, point)
        area = np.linalg.norm(source[:, 3:], axis=1)
        loaded = t.any(axis=1)
        pushed = force_values(point, source[loaded, :3], t[loaded] * area[loaded, None], **material)
        displaced = displaced_surface_values(point, source, u, **material)
        displacement[k], stress[k] = (a + b for a, b in zip(pushed, displaced, strict=True))
        angle[k] = solid_angle(point, source)
    _refuse(
        clearance < _MIN_CLEARANCE, points,
        f"within {_MIN_CLEARANCE:.0%} of a triangle's radius of the surface",
        "move them inward, refine the mesh there, or use the displacement of the surface itself",
    )  # fmt: skip
    _refuse(
        ~(angle > 0.5), points, "outside the object",
        "check their frame and that they are in metres",
    )  # fmt: skip
    return InteriorState(displacement, stress)


def _surface_seen_from(
    fields: BoundaryFields, point: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "q 6"], Float[np.ndarray, "q 3"], Float[np.ndarray, "q 3"], float]:
    """Quadrature points of the whole surface, closer where the point is near, as places and
    weighted normals; displacement and traction there; the point's clearance, to about a tenth."""
    rules = [triangle_rule(degree) for degree in _QUADRATURE.degrees]
    ratios = _QUADRATURE.ratios()
    values = np.concatenate([fields.displacement, fields.traction], axis=2)
    triangle = np.arange(len(values))
    corners = np.tile(np.eye(3), (len(values), 1, 1))
    sources, found, clearance = [], [], np.inf
    for level in range(_MOST_LEVELS + 1):
        corner = element_points(fields.element_nodes[triangle], corners)[:, :, :3]
        centre = corner.mean(axis=1)
        radius = np.linalg.norm(corner - centre[:, None], axis=2).max(axis=1)
        ratio = np.linalg.norm(point - centre, axis=1) / radius
        near = (ratio < ratios[-1]) & (level < _MOST_LEVELS)
        clearance = min(clearance, float(np.where(near, np.inf, ratio).min()) * 0.5**level)
        # Rules count from the coarsest, whose ratio is the largest.
        chosen = np.minimum((ratio[:, None] < ratios).sum(axis=1), len(rules) - 1)
        for k, rule in enumerate(rules):
            mine = np.flatnonzero(~near & (chosen == k))
            barycentric = rule.barycentric @ corners[mine]
            source = element_points(fields.element_nodes[triangle[mine]], barycentric)
            source[:, :, 3:] *= rule.weight[:, None] * 0.25**level
            shapes = np.moveaxis(quadratic_shapes(barycentric), 0, -1)
            sources.append(source.reshape(-1, 6))
            found.append((shapes @ values[triangle[mine]]).reshape(-1, 6))
        triangle, corners = quartered(triangle[near], corners[near])
        if not triangle.size:
            break
    at_sources = np.concatenate(found)
    return np.concatenate(sources), at_sources[:, :3], at_sources[:, 3:], clearance


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
