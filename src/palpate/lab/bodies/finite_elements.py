"""Linear elasticity of a solid by quadratic tetrahedra: how the virtual specimens give way.

Nothing of the boundary elements is used: what estimates a specimen's constants must not have made
the specimen.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import bsr_array, csr_array

from palpate.errors import InputError, SingularSystemError
from palpate.geometry import TriangleMesh, area_vectors, closest_points
from palpate.lab.bodies.quadratic_elements import (
    NodePairs,
    block_matrix,
    node_pairs,
    shape_gradients,
    triangle_rule,
    triangle_shapes,
)
from palpate.lab.bodies.sparse_cholesky import Cholesky, factorise
from palpate.lab.bodies.tetrahedra import QUARTERS, Solid, skin
from palpate.records import PRESSURES, Contact
from palpate.shapes import Points, Vector3

# Barycentric coordinates of a six-node triangle's nodes.
_NODE_PLACE = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]], dtype=float
)  # Of the body's size: held nodes nearer to a line than this hold it by rounding only.
_IN_LINE = 1e-6

Density = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A solid of one material, held at some nodes, ready for loads.

    Parameters
    ----------
    solid : Solid
    held : (n,) bool                nodes that cannot move
    shear_modulus : float [Pa]
    poisson_ratio : float [-]
    pairs : NodePairs               structure of the stiffness
    stiffness : (3 n, 3 n) [N/m]    of all nodes, in blocks of three
    factor : Cholesky               of the free nodes' part
    """

    solid: Solid
    held: Bool[np.ndarray, " n"]
    shear_modulus: float
    poisson_ratio: float
    pairs: NodePairs
    stiffness: bsr_array
    factor: Cholesky


def held_nodes(solid: Solid, triangles: Int[np.ndarray, " k"]) -> Bool[np.ndarray, " n"]:
    """Nodes on outer faces that lie on some triangles of the given surface.

    Parameters
    ----------
    solid : Solid
    triangles : (k,) int            of the surface that was filled, e.g. a session's support

    Raises
    ------
    InputError                      no outer face lies there
    """
    facets = np.isin(solid.facet_triangle, triangles)
    if not facets.any():
        raise InputError(
            f"none of the body's {len(facets)} outer faces lies on the {len(triangles)} held"
            " triangles; without a support it would float away: hold more, or use smaller elements"
        )
    held = np.zeros(len(solid.nodes), dtype=bool)
    held[solid.facets[facets]] = True
    return held


def make_body(
    solid: Solid, held: Bool[np.ndarray, " n"], *, shear_modulus: float, poisson_ratio: float
) -> Body:
    """Stiffness of a held solid, factorised once for any number of loads.

    Parameters
    ----------
    solid : Solid
    held : (n,) bool                nodes that cannot move
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu < 0.5; quadratic elements lock little up to 0.499

    Raises
    ------
    InputError                      constants out of range, no or all nodes held
    SingularSystemError             the held nodes leave the body free to turn
    """
    check_constants(shear_modulus, poisson_ratio)
    if not held.any() or held.all():
        raise InputError(
            f"{int(held.sum())} of {len(held)} nodes are held; must be some of them, not all"
        )
    spread = np.linalg.svd(solid.nodes[held] - solid.nodes[held].mean(axis=0), compute_uv=False)
    if len(spread) < 2 or spread[1] <= _IN_LINE * np.ptp(solid.nodes, axis=0).max():
        raise SingularSystemError(
            f"the {int(held.sum())} held nodes lie in a line: the body is free to turn about it;"
            " hold more of its surface"
        )
    pairs = node_pairs(solid)
    stiffness = block_matrix(pairs, _element_matrices(solid, shear_modulus, poisson_ratio))
    factor = factorise(free_part(stiffness, held), solid.nodes[~held])
    return Body(solid, held, shear_modulus, poisson_ratio, pairs, stiffness, factor)


def check_constants(shear_modulus: float, poisson_ratio: float) -> None:
    """Refuse constants that no elastic solid has, or that the elements cannot carry."""
    if not (np.isfinite(shear_modulus) and shear_modulus > 0.0):
        raise InputError(f"shear_modulus is {shear_modulus}; must be positive, in pascals")
    if not -1.0 < poisson_ratio < 0.5:
        raise InputError(
            f"poisson_ratio is {poisson_ratio}; must be in (-1, 0.5): for an incompressible body"
            " take 0.499"
        )


def _element_matrices(
    solid: Solid, shear_modulus: float, poisson_ratio: float
) -> Float[np.ndarray, "m 10 3 10 3"]:
    """Stiffness of every element between (node, component) and (node, component) [N/m]."""
    lame = 2.0 * shear_modulus * poisson_ratio / (1.0 - 2.0 * poisson_ratio)
    slopes = shape_gradients(solid)
    count, points = slopes.volume.shape
    root = np.sqrt(slopes.volume)[:, :, None]
    flat = slopes.gradient.reshape(count, points, 30) * root
    product = np.matmul(flat.transpose(0, 2, 1), flat).reshape(count, 10, 3, 10, 3)
    matrix = lame * product + shear_modulus * product.transpose(0, 1, 4, 3, 2)
    same = np.einsum("micjc->mij", product)
    for a in range(3):
        matrix[:, :, a, :, a] += shear_modulus * same
    return matrix


def free_part(stiffness: bsr_array, held: Bool[np.ndarray, " n"]) -> bsr_array:
    """Rows and columns of the nodes that can move."""
    free = np.flatnonzero(~held)
    chosen = csr_array(
        (np.arange(1, len(stiffness.indices) + 1), stiffness.indices, stiffness.indptr),
        shape=(len(held), len(held)),
    )[free][:, free]
    blocks = stiffness.data[chosen.data - 1]
    size = 3 * len(free)
    return bsr_array((blocks, chosen.indices, chosen.indptr), shape=(size, size))


def solve_loads(body: Body, loads: Float[np.ndarray, "n 3 k"]) -> Float[np.ndarray, "n 3 k"]:
    """Displacement of all nodes under nodal forces.

    Parameters
    ----------
    body : Body
    loads : (n, 3, k) float [N]     forces on the nodes; those on held nodes move nothing

    Returns
    -------
    (n, 3, k) float [m]
    """
    displacement = np.zeros(loads.shape)
    free = ~body.held
    right = loads[free].reshape(-1, loads.shape[2])
    displacement[free] = body.factor.solve(right).reshape(-1, 3, loads.shape[2])
    return displacement


def reaction(
    body: Body, displacement: Float[np.ndarray, "n 3"], load: Float[np.ndarray, "n 3"]
) -> Vector3:
    """Force of the support on the body [N]."""
    inner = (body.stiffness @ displacement.ravel()).reshape(-1, 3)
    return (inner - load)[body.held].sum(axis=0)


def traction_load(solid: Solid, contact: Contact, force: Vector3) -> Float[np.ndarray, "n 3"]:
    """Nodal forces of a tool's traction, as a session's `contact` and `force` describe it.

    Parameters
    ----------
    solid : Solid
    contact : Contact               with a radius
    force : (3,) float [N]          total; the traction has its direction everywhere

    Returns
    -------
    (n, 3) float [N]                they add up to `force`

    Raises
    ------
    InputError                      a contact at a vertex, or one that misses the surface
    """
    if contact.radius is None:
        raise InputError(
            f"the contact profile is '{contact.profile}', which needs a boundary element"
            f" mesh; a virtual specimen takes one of {', '.join(PRESSURES)}, with a radius"
        )
    outside = skin(solid.nodes, solid.facets)
    first = closest_points(outside, contact.point[None])
    if first.distance[0] >= contact.radius:
        raise InputError(
            f"the contact point is {1e3 * first.distance[0]:.3g} mm from the body, farther than its"
            f" radius of {1e3 * contact.radius:.3g} mm; check its frame and units"
        )
    normals = area_vectors(TriangleMesh(solid.nodes, solid.facets[:, :3]))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    # A thin body's far side faces away from the tool.
    facing = normals @ normals[first.triangle[0] // 4] > -0.5
    radius, profile = contact.radius, PRESSURES[contact.profile]

    def pressure(position: np.ndarray) -> np.ndarray:
        return profile(np.linalg.norm(position - contact.point, axis=-1) / radius)

    corners = solid.nodes[solid.facets]
    middle = corners.mean(axis=1)
    reach = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    near = np.linalg.norm(middle - contact.point, axis=1) < radius + reach
    share = facet_loads(solid, np.flatnonzero(near & facing), pressure)
    return share[:, None] * (force / share.sum())


def facet_loads(
    solid: Solid, facets: Int[np.ndarray, " k"], density: Density
) -> Float[np.ndarray, " n"]:
    """Integral over outer faces of each node's shape function times a density.

    Parameters
    ----------
    solid : Solid
    facets : (k,) int
    density : (k, q, 3) positions [m] -> (k, q)   per area

    Returns
    -------
    (n,) float                      they add up to the integral of the density
    """
    place, weight = triangle_rule()
    corner = solid.nodes[solid.facets[facets]]
    shape, slope = triangle_shapes(place)
    position = np.einsum("qv,kva->kqa", shape, corner)
    along = np.einsum("qvd,kva->kqda", slope, corner)
    area = 0.5 * np.linalg.norm(np.cross(along[:, :, 0], along[:, :, 1]), axis=2)
    share = np.einsum("q,kq,kq,qv->kv", weight, area, density(position), shape)
    return np.bincount(solid.facets[facets].ravel(), share.ravel(), minlength=len(solid.nodes))


def surface_values(solid: Solid, points: Points) -> csr_array:
    """Operator from nodal values to values at points of the outer faces.

    Parameters
    ----------
    solid : Solid
    points : (p, 3) float [m]       on the body's surface, or near it: the nearest place counts

    Returns
    -------
    (p, n) sparse                   quadratic interpolation; rows add up to 1
    """
    place = closest_points(skin(solid.nodes, solid.facets), points)
    facet, quarter = np.divmod(place.triangle, 4)
    barycentric = np.einsum("nv,nvb->nb", place.barycentric, _NODE_PLACE[QUARTERS[quarter]])
    weights, _ = triangle_shapes(barycentric)
    row = np.repeat(np.arange(len(points)), 6)
    return csr_array(
        (weights.ravel(), (row, solid.facets[facet].ravel())),
        shape=(len(points), len(solid.nodes)),
    )
