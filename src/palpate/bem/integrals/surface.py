"""Discretised surface of the boundary integrals, and the quadrature rules on its triangles.

Triangles have six nodes, for displacement and for traction. Symmetric rules serve distant
collocation points, conical products near ones.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import roots_jacobi, roots_legendre

from palpate.errors import InputError
from palpate.geometry import (
    QuadraticNodes,
    Sides,
    TriangleMesh,
    displacement_nodes,
    element_points,
    linear_nodes,
    quadratic_shapes,
    side_nodes,
    split_sides,
    triangle_areas,
)


@dataclass(frozen=True, slots=True, eq=False)
class BoundarySurface:
    """Closed surface of six-node triangles, part of which is held.

    Attributes
    ----------
    mesh : TriangleMesh
    sides : Sides
    held : (m,) bool                  triangles of the support
    held_directions : (m, 3, 3) float projector onto the directions in which each triangle is held:
                                      the identity where it is fixed, of rank 1 or 2 on a roller,
                                      zero where it is free
    element_nodes : (m, 6, 3) float   [m]
    displacement : QuadraticNodes     continuous, one node per vertex
    traction : QuadraticNodes         one node per side of a vertex
    held_length : float [m]           square root of the mean area of the held triangles: scales
                                      tractions to displacements
    corrects_indentation : bool       whether midside nodes near a load are corrected for the local
                                      indentation (`local_indentation`)
    """

    mesh: TriangleMesh
    sides: Sides
    held: Bool[np.ndarray, " m"]
    held_directions: Float[np.ndarray, "m 3 3"]
    element_nodes: Float[np.ndarray, "m 6 3"]
    displacement: QuadraticNodes
    traction: QuadraticNodes
    held_length: float
    corrects_indentation: bool


def make_surface(
    mesh: TriangleMesh,
    held_triangles: Int[np.ndarray, " k"],
    *,
    directions: Float[np.ndarray, "k 3 3"] | None = None,
    smooth: bool = True,
    quadratic: bool = True,
    rings: int = 1,
) -> BoundarySurface:
    """Prepare a closed mesh and its support for the boundary integrals.

    Parameters
    ----------
    mesh : TriangleMesh               closed, outward
    held_triangles : (k,) int         triangles of the support
    directions : (k, 3, 3) float      projector onto the directions in which each of them is held;
                                      None: all directions
    smooth : bool                     True: the mesh samples a smooth object, and curved triangles
                                      interpolate it; False: the object has exactly the flat facets
                                      of the mesh
    quadratic : bool                  True: fields are quadratic on each triangle, with midside
                                      values fitted to the surrounding vertices; False: linear
                                      elements, as in the paper
    rings : int                       rings of neighbours of an edge that the quadratics are fitted
                                      to, 1 or 2; the difference between the two estimates the
                                      interpolation error

    Returns
    -------
    BoundarySurface

    Raises
    ------
    InputError                        nothing is held, or everything is
    """
    held = np.zeros(mesh.triangles.shape[0], dtype=bool)
    held[held_triangles] = True
    if held.all() or not held.any():
        raise InputError(
            f"the support has {held.sum()} of {held.size} triangles; it must hold a part of "
            "the surface and leave a part free; check the selectors of [support]"
        )
    held_directions = np.zeros((held.size, 3, 3))
    held_directions[held_triangles] = np.eye(3) if directions is None else directions
    # The traction of a roller ends where it meets another support or the free surface.
    _, region = np.unique(held_directions.reshape(-1, 9), axis=0, return_inverse=True)
    sides = split_sides(mesh, region.ravel())
    displacement = displacement_nodes(mesh, sides, rings=rings)
    traction = side_nodes(mesh, sides, rings=rings)
    geometry = displacement if smooth else linear_nodes(displacement)
    if not quadratic:
        displacement, traction = linear_nodes(displacement), linear_nodes(traction)
    position = np.concatenate([mesh.vertices, geometry.weights @ mesh.vertices])
    nodes = position[geometry.element]
    length = float(np.sqrt(triangle_areas(mesh)[held].mean()))
    return BoundarySurface(
        mesh, sides, held, held_directions, nodes, displacement, traction, length,
        corrects_indentation=smooth and quadratic,
    )  # fmt: skip


def integral_weights(
    surface: BoundarySurface, triangles: Int[np.ndarray, " k"]
) -> Float[np.ndarray, " s"]:
    """Weights that integrate a field, given at the sides of vertices, over some triangles.

    Parameters
    ----------
    surface : BoundarySurface
    triangles : (k,) int

    Returns
    -------
    (s,) float [m^2]          one per side of a vertex; integral = weights @ values
    """
    corner_integrals, midside_integrals = _element_integrals(surface.element_nodes[triangles])
    nodes = surface.traction
    weights = np.zeros(nodes.n_nodes)
    np.add.at(weights, nodes.element[triangles, :3], corner_integrals)
    midside = np.zeros(nodes.weights.shape[0])
    np.add.at(midside, nodes.element[triangles, 3:] - nodes.n_nodes, midside_integrals)
    return weights + nodes.weights.T @ midside


@dataclass(frozen=True, slots=True)
class Quadrature:
    """How the boundary integrals are evaluated.

    Attributes
    ----------
    tolerance : float [-]     target relative error of each integral over one triangle; together
                              with the distance of the collocation point over the triangle's radius
                              it selects the rule
    degrees : tuple of int    degrees of the regular rules, ascending
    polar_points : (int, int) radial and angular Gauss points of the singular integrals
    """

    tolerance: float = 1e-5
    degrees: tuple[int, ...] = (2, 4, 5, 7, 9, 11, 13, 15, 19)
    polar_points: tuple[int, int] = (4, 12)

    def ratios(self) -> Float[np.ndarray, " k"]:
        """Distance over triangle radius above which each rule meets the tolerance.

        Returns
        -------
        (k,) float [-]            decreasing with the degree; a rule of degree d has a relative
                                  error of (radius / distance)^(d + 1)
        """
        return np.array([self.ratio(degree) for degree in self.degrees])

    def ratio(self, degree: int) -> float:
        """Distance over triangle radius above which a rule of some degree meets the tolerance.

        Parameters
        ----------
        degree : int              of any rule, whether or not it is one of `degrees`

        Returns
        -------
        float [-]
        """
        return float(self.tolerance ** (-1.0 / (degree + 1)))


# Cached, as are those below: each rule takes an eigenvalue problem, and every load of every model
# asks for the same few.
@cache
def triangle_rule(degree: int) -> tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, " q"]]:
    """A rule with positive weights that is exact up to at least the given degree.

    Parameters
    ----------
    degree : int              at least 1

    Returns
    -------
    (q, 3) float [-]          barycentric coordinates of 3, 6 or 7 points for degrees 2, 4 and 5,
                              else of a conical product of n^2 points; read-only
    (q,) float [-]            weights that sum to 1/2, the area of the reference triangle

    Source
    ------
    Hammer, Marlowe and Stroud (1956) for degrees 2 and 5; Dunavant (1985) for degree 4; Stroud
    (1971) for the products.
    """
    if degree <= 2:
        return _symmetric([(1 / 6, 1 / 3)], 0.0)
    if degree <= 4:
        root = np.sqrt(38 - 44 * np.sqrt(2 / 5))
        base = np.sqrt(213125 - 53320 * np.sqrt(10))
        orbits = [
            ((8 - np.sqrt(10) + root) / 18, (620 + base) / 3720),
            ((8 - np.sqrt(10) - root) / 18, (620 - base) / 3720),
        ]
        return _symmetric(orbits, 0.0)
    if degree <= 5:
        root = np.sqrt(15)
        orbits = [((6 - root) / 21, (155 - root) / 1200), ((6 + root) / 21, (155 + root) / 1200)]
        return _symmetric(orbits, 9 / 40)
    return _conical(degree // 2 + 1)


@cache
def unit_gauss(n: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Gauss-Legendre points and weights on [0, 1].

    Parameters
    ----------
    n : int                   number of points

    Returns
    -------
    (n,) float, (n,) float    points; weights that sum to 1; read-only
    """
    x, w = roots_legendre(n)
    return _read_only(0.5 * (x + 1), 0.5 * w)


def _element_integrals(
    nodes: Float[np.ndarray, "k 6 3"],
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    barycentric, weight = triangle_rule(7)
    area = np.linalg.norm(element_points(nodes, barycentric)[:, :, 3:], axis=2)
    integrals = np.einsum("q,aq,kq->ka", weight, quadratic_shapes(barycentric), area)
    return integrals[:, :3], integrals[:, 3:]


def _symmetric(
    orbits: list[tuple[float, float]], centre_weight: float
) -> tuple[np.ndarray, np.ndarray]:
    points, weights = [], []
    for a, weight in orbits:
        b = 1 - 2 * a
        points += [(a, a, b), (a, b, a), (b, a, a)]
        weights += [weight] * 3
    if centre_weight:
        points.append((1 / 3, 1 / 3, 1 / 3))
        weights.append(centre_weight)
    return _read_only(np.array(points), 0.5 * np.array(weights))


def _conical(n: int) -> tuple[np.ndarray, np.ndarray]:
    radial, radial_weight = roots_jacobi(n, 0.0, 1.0)
    s, w_s = 0.5 * (radial + 1), 0.25 * radial_weight
    t, w_t = unit_gauss(n)
    s, t = (grid.ravel() for grid in np.meshgrid(s, t, indexing="ij"))
    barycentric = np.stack([1 - s, s * (1 - t), s * t], axis=1)
    return _read_only(barycentric, np.outer(w_s, w_t).ravel())


def _read_only(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    points.flags.writeable = weights.flags.writeable = False
    return points, weights
