"""Linear elasticity of a solid in quadratic tetrahedra: how the virtual specimens deform.

Elements, quadrature and assembly are scikit-fem's. Nothing of the boundary element model is used:
the model that estimates the constants must not have generated the data.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import skfem
from jaxtyping import Bool, Float, Int
from scipy.sparse import bsr_array, csr_array, kron
from scipy.spatial.distance import cdist

from palpate.errors import InputError, SingularSystemError
from palpate.geometry import (
    BESIDE,
    ELEMENT_NODES,
    closest_points,
    piece_middles,
    quadratic_shapes,
)
from palpate.machine import check_memory_for
from palpate.shapes import Points, Vector3
from palpate.solids.sizes import body_memory
from palpate.solids.sparse_cholesky import Cholesky, factorise
from palpate.solids.tetrahedra import QUARTERS, Solid, boundary_surface

# Held nodes closer to a common line than this fraction of the body's size count as collinear: only
# rounding errors would keep the body from turning about that line.
_IN_LINE = 1e-6
# Quadrature points along a side of a face, for the integral of a pressure over it.
_SAMPLES = 14
# Parts along its side into which a half space's load is cut.
_PARTS = 5
# Variance of a place in an equilateral triangle, along an axis, over its area: side^2 / 24.
_TRIANGLE = 1.0 / (6.0 * np.sqrt(3.0))


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A supported solid of one material with its factorised stiffness.

    Parameters
    ----------
    solid : Solid
    held : (n,) bool                fixed nodes; none on an elastic foundation
    shear_modulus : float [Pa]
    poisson_ratio : float [-]
    factor : Cholesky               of the stiffness matrix of the free nodes
    """

    solid: Solid
    held: Bool[np.ndarray, " n"]
    shear_modulus: float
    poisson_ratio: float
    factor: Cholesky

    @property
    def lame(self) -> tuple[float, float]:
        """Lame's constants mu and lambda [Pa]."""
        mu, nu = self.shear_modulus, self.poisson_ratio
        return mu, 2.0 * mu * nu / (1.0 - 2.0 * nu)


def held_nodes(solid: Solid, triangles: Int[np.ndarray, " k"]) -> Bool[np.ndarray, " n"]:
    """Nodes of the outer faces that lie on given triangles of the surface.

    Parameters
    ----------
    solid : Solid
    triangles : (k,) int            indices into the surface that was filled, e.g. its held ones

    Returns
    -------
    (n,) bool                       for all nodes

    Raises
    ------
    InputError                      no outer face lies on these triangles
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
    solid: Solid,
    held: Bool[np.ndarray, " n"],
    *,
    shear_modulus: float,
    poisson_ratio: float,
    support_stiffness: float | None = None,
) -> Body:
    """Assemble and factorise the stiffness of a supported solid, once for any number of loads.

    Parameters
    ----------
    solid : Solid
    held : (n,) bool                nodes that are fixed, or on an elastic foundation
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu < 0.5; quadratic elements lock little up to 0.499
    support_stiffness : float [N/m^3]    modulus of the foundation under the faces whose nodes are
                                    all held, the same along all directions; None: rigid

    Returns
    -------
    Body

    Raises
    ------
    InputError                      constants out of range, no or all nodes held, a factor that
                                    memory cannot hold
    SingularSystemError             the held nodes are collinear: the body can turn about them
    """
    if not (np.isfinite(shear_modulus) and shear_modulus > 0.0):
        raise InputError(f"shear_modulus is {shear_modulus}; must be positive, in pascals")
    if not -1.0 < poisson_ratio < 0.5:
        raise InputError(
            f"poisson_ratio is {poisson_ratio}; must be in (-1, 0.5): for an incompressible body"
            " take 0.499"
        )
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
    what = f"the factor of a stiffness matrix of {len(held)} nodes"
    check_memory_for(what, body_memory(float(len(held))), "use larger elements")
    moduli, basis = hooke_moduli(shear_modulus, poisson_ratio), quadratic_basis(solid)
    stiffness = stiffness_matrix(basis, moduli)
    if support_stiffness is not None:
        stiffness = csr_array(stiffness + support_stiffness * _bed(basis, held))
        held = np.zeros_like(held)
    factor = factorise(free_part(stiffness, held), solid.nodes[~held])
    return Body(solid, held, shear_modulus, poisson_ratio, factor)


def _bed(basis: Any, held: Bool[np.ndarray, " n"]) -> csr_array:
    """Foundation of unit modulus under the outer faces whose nodes are all held, (3 n, 3 n) [m^2].

    Source
    ------
    Winkler's foundation: its energy is half the integral of k u.u over the faces.
    """
    mesh = basis.mesh
    below = mesh.boundary_facets()
    below = below[held[mesh.facets[:, below]].all(axis=0)]
    # Products of two shape functions of degree 2.
    faces = skfem.FacetBasis(mesh, skfem.ElementTetP2(), facets=below, intorder=4)
    mass = skfem.BilinearForm(lambda u, v, _: u * v).assemble(faces)
    return csr_array(kron(mass, np.eye(3)))


def quadratic_basis(solid: Solid) -> Any:
    """scikit-fem's ten-node tetrahedra over a solid, with the four-point quadrature of degree 2.

    Four points integrate straight-sided elements exactly and leave a ten-node tetrahedron without
    zero-energy modes. The unknowns are numbered like `solid.nodes`.

    Parameters
    ----------
    solid : Solid

    Returns
    -------
    skfem.Basis                     scalar: one unknown per node

    """
    nodes, corners = (np.ascontiguousarray(a.T) for a in (solid.nodes, solid.elements[:, :4]))
    return skfem.Basis(skfem.MeshTet2(nodes, corners), skfem.ElementTetP2(), intorder=2)


def hooke_moduli(shear_modulus: float, poisson_ratio: float) -> Float[np.ndarray, "3 3 3 3"]:
    """Elasticity tensor: derivative of the stress aA with respect to the displacement gradient bB.

    Parameters
    ----------
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu < 0.5

    Returns
    -------
    (3, 3, 3, 3) float [Pa]         indices a, A, b, B

    Source
    ------
    Hooke's law: lambda delta_aA delta_bB + mu (delta_ab delta_AB + delta_aB delta_bA).
    """
    lame = 2.0 * shear_modulus * poisson_ratio / (1.0 - 2.0 * poisson_ratio)
    unit = np.eye(3)
    return lame * np.einsum("aA,bB->aAbB", unit, unit) + shear_modulus * (
        np.einsum("ab,AB->aAbB", unit, unit) + np.einsum("aB,bA->aAbB", unit, unit)
    )


def stiffness_matrix(basis: Any, moduli: Float[np.ndarray, "3 3 3 3 *quadrature"]) -> csr_array:
    """Stiffness matrix: second derivative of the energy with respect to the nodal displacements.

    Parameters
    ----------
    basis : skfem.Basis             of `quadratic_basis`
    moduli : (3, 3, 3, 3) or (3, 3, 3, 3, m, q) float [Pa]   derivative of the stress aA with
                                    respect to the displacement gradient bB, with major symmetry
                                    (aA, bB); uniform, or at the q quadrature points of m elements

    Returns
    -------
    (3 n, 3 n) sparse [N/m]         three unknowns per node, node by node
    """
    slope = np.stack([shape[0].grad for shape in basis.basis]).transpose(3, 2, 0, 1)
    moduli = moduli.reshape(3, 3, 3, 3, *(moduli.shape[4:] or (1, 1)))
    # In 64 bits: pairs of nodes are counted below.
    count, dofs = basis.N, basis.element_dofs.T.astype(np.int64)
    block: Any = 0.0
    # Of every element, for two of its nodes and two components.
    for k, (gradient, size) in enumerate(zip(slope, basis.dx.T, strict=True)):
        here = moduli[..., k % moduli.shape[-1]].transpose(4, 1, 0, 2, 3).reshape(-1, 27, 3)
        half = (here @ gradient.transpose(0, 2, 1)).reshape(len(gradient), 3, -1)
        block = block + (size[:, None, None] * gradient) @ half
    block = block.reshape(*dofs.shape, 3, 3, -1).transpose(0, 1, 4, 2, 3).reshape(-1, 9)
    pair = (count * dofs[:, :, None] + dofs[:, None, :]).ravel()
    order = np.argsort(pair, kind="stable")
    first = np.flatnonzero(np.diff(pair[order], prepend=-1))
    added = csr_array((np.ones(len(pair)), order, np.append(first, len(pair)))) @ block
    row, column = np.divmod(pair[order[first]], count)
    start = np.searchsorted(row, np.arange(count + 1))
    shape = 3 * count, 3 * count
    return csr_array(bsr_array((added.reshape(-1, 3, 3), column, start), shape=shape).tocsr())


def free_part(stiffness: csr_array, held: Bool[np.ndarray, " n"]) -> csr_array:
    """Rows and columns of a matrix that belong to the free nodes.

    Parameters
    ----------
    stiffness : (3 n, 3 n) sparse   three unknowns per node, node by node
    held : (n,) bool                fixed nodes

    Returns
    -------
    (3 f, 3 f) sparse               of the f free nodes, in their order
    """
    free = np.repeat(~held, 3)
    return stiffness[free][:, free]


def solve_load(body: Body, load: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Displacement of all nodes under nodal forces.

    Parameters
    ----------
    body : Body
    load : (n, 3) float [N]         nodal forces; those on fixed nodes have no effect

    Returns
    -------
    (n, 3) float [m]
    """
    return solve_free(body.held, body.factor, load.reshape(-1, 1)).reshape(-1, 3)


def solve_free(
    held: Bool[np.ndarray, " n"], factor: Cholesky, right: Float[np.ndarray, "m k"]
) -> Float[np.ndarray, "m k"]:
    """Displacement of all nodes under several loads.

    Parameters
    ----------
    held : (n,) bool                fixed nodes
    factor : Cholesky               of the stiffness matrix of the free nodes
    right : (3 n, k) float [N]      right-hand sides, three components per node, node by node; those
                                    of fixed nodes have no effect

    Returns
    -------
    (3 n, k) float [m]
    """
    free = np.repeat(~held, 3)
    moved = np.zeros_like(right)
    moved[free] = factor.solve(right[free])
    return moved


def linear_displacement(
    nodes: Points,
    tetrahedra: Int[np.ndarray, "e 4"],
    held: Bool[np.ndarray, " n"],
    load: Float[np.ndarray, "n 3"],
    *,
    shear_modulus: Float[np.ndarray, " e"],
    poisson_ratio: float,
) -> Float[np.ndarray, "n 3"]:
    """Displacement of linear tetrahedra, as simulators that know no others have them.

    Parameters
    ----------
    nodes : (n, 3) float [m]
    tetrahedra : (e, 4) int
    held : (n,) bool                fixed nodes
    load : (n, 3) float [N]         nodal forces
    shear_modulus : (e,) float [Pa] of every element
    poisson_ratio : float [-]

    Returns
    -------
    (n, 3) float [m]
    """
    mesh = skfem.MeshTet(np.ascontiguousarray(nodes.T), np.ascontiguousarray(tetrahedra.T))
    basis = skfem.Basis(mesh, skfem.ElementTetP1(), intorder=1)
    moduli = hooke_moduli(1.0, poisson_ratio)[..., None, None] * shear_modulus[:, None]
    factor = factorise(free_part(stiffness_matrix(basis, moduli), held), nodes[~held])
    return solve_free(held, factor, load.reshape(-1, 1)).reshape(-1, 3)


def pressure_load(
    solid: Solid,
    point: Vector3,
    radius: float,
    pressure: Callable[[Float[np.ndarray, "*n"]], Float[np.ndarray, "*n"]],
) -> Float[np.ndarray, " n"]:
    """Nodal weights of a force that is distributed over a circular patch of the surface.

    Parameters
    ----------
    solid : Solid
    point : (3,) float [m]          centre of the patch
    radius : float [m]              of the patch, > 0
    pressure : function             distance from the centre over the radius -> pressure, of any
                                    scale

    Returns
    -------
    (n,) float [-]                  weights that sum to 1

    Raises
    ------
    InputError                      the patch misses the surface
    """
    near, _, density, shape = _pressed(solid, point, radius, pressure, inner_points(_SAMPLES))
    share = np.zeros(len(solid.nodes))
    np.add.at(share, solid.facets[near], density @ shape)
    return share / share.sum()


def nodal_volumes(solid: Solid) -> Float[np.ndarray, " n"]:
    """Share of a body's volume that each node carries of a constant body force [m^3]; with
    quadratic elements that of corners may be negative.

    Parameters
    ----------
    solid : Solid
    """
    return np.asarray(skfem.LinearForm(lambda v, _: 1.0 * v).assemble(quadratic_basis(solid)))


def half_space_compliance(
    solid: Solid,
    point: Vector3,
    radius: float,
    pressure: Callable[[Float[np.ndarray, "*n"]], Float[np.ndarray, "*n"]],
) -> float:
    """Mean displacement of a half space under one newton of such a load, weighted with it, times
    its shear modulus over 1 - nu; where an edge of the body cuts the patch, of the rest.

    Parameters
    ----------
    solid, point, radius, pressure  as `pressure_load`

    Returns
    -------
    float [1/m]

    Source
    ------
    Boussinesq: (1 - nu) / (2 pi G r) at a distance r from one newton
    """
    _, position, density, _ = _pressed(solid, point, radius, pressure, piece_middles(_PARTS))
    # Area of each sample, from that of its facet, which is a factor of its weight.
    loaded = density.ravel() > 0.0
    points, weight = position.reshape(-1, 3)[loaded], density.ravel()[loaded]
    distance = np.linalg.norm(points - point, axis=1) / radius
    area = weight / pressure(np.minimum(distance, 1.0)) / (2.0 * position.shape[1])
    weight = weight / weight.sum()
    np.fill_diagonal(apart := cdist(points, points), 1.0)
    # The mean of 1 / r between points of two triangles, to second order in their size.
    inverse = 1.0 / apart + 0.5 * _TRIANGLE * (area[:, None] + area) / apart**3
    # And between points of a disc of one's area.
    np.fill_diagonal(inverse, 16.0 / (3.0 * np.pi) / np.sqrt(area / np.pi))
    return float(weight @ inverse @ weight) / (2.0 * np.pi)


def _pressed(
    solid: Solid,
    point: Vector3,
    radius: float,
    pressure: Callable[[Float[np.ndarray, "*n"]], Float[np.ndarray, "*n"]],
    barycentric: Float[np.ndarray, "s 3"],
) -> tuple[
    Bool[np.ndarray, " f"],
    Float[np.ndarray, "p s 3"],
    Float[np.ndarray, "p s"],
    Float[np.ndarray, "s 6"],
]:
    """Facets near a patch; samples on them, their pressure times twice the facet's area, and the
    shape functions there."""
    nodes = solid.nodes[solid.facets]
    size = np.linalg.norm(nodes[:, 1:3] - nodes[:, :1], axis=2).max(axis=1)
    side = np.cross(nodes[:, 1] - nodes[:, 0], nodes[:, 2] - nodes[:, 0])
    gap = np.linalg.norm(nodes - point, axis=2).min(axis=1)
    surface = boundary_surface(solid.nodes, solid.facets)
    under = int(closest_points(surface, point[None]).triangle[0]) // len(QUARTERS)
    normal = side / np.linalg.norm(side, axis=1)[:, None]
    near = (gap < radius + size) & (normal @ normal[under] > BESIDE)
    shape = quadratic_shapes(barycentric).T
    position = np.einsum("sv,fva->fsa", shape, nodes[near])
    distance = np.linalg.norm(position - point, axis=2)
    area = np.linalg.norm(side[near], axis=1)[:, None]
    density = np.where(distance < radius, pressure(np.minimum(distance / radius, 1.0)), 0.0) * area
    if not density.any():
        raise InputError("the tool touches no part of the surface; check its point and radius")
    return near, position, density, shape


def inner_points(count: int) -> Float[np.ndarray, "s 3"]:
    """Barycentric coordinates of evenly spaced points in a triangle.

    Parameters
    ----------
    count : int                     along a side
    """
    steps = (np.arange(count) + 0.5) / count
    a, b = (grid.ravel() for grid in np.meshgrid(steps, steps))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    return np.stack([1 - a - b, a, b], axis=1)


def surface_values(solid: Solid, points: Points) -> csr_array:
    """Interpolation matrix from nodal values to values at points of the surface.

    Parameters
    ----------
    solid : Solid
    points : (p, 3) float [m]       on the body's surface or near it; the closest point counts

    Returns
    -------
    (p, n) sparse                   quadratic interpolation; rows add up to 1
    """
    closest = closest_points(boundary_surface(solid.nodes, solid.facets), points)
    facet, quarter = np.divmod(closest.triangle, 4)
    barycentric = np.einsum("nv,nvb->nb", closest.barycentric, ELEMENT_NODES[QUARTERS[quarter]])
    row = np.repeat(np.arange(len(points)), 6)
    return csr_array(
        (quadratic_shapes(barycentric).T.ravel(), (row, solid.facets[facet].ravel())),
        shape=(len(points), len(solid.nodes)),
    )
