"""Discretised surface of the boundary integrals: six-node triangles, with the nodes of displacement
and of traction."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.bem.integrals.quadrature import triangle_rule
from palpate.errors import InputError
from palpate.geometry import (
    CREASE_ANGLE,
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


@dataclass(frozen=True, slots=True)
class SurfaceSettings:
    """Interpolation of geometry and fields between the vertices.

    Attributes
    ----------
    smooth : bool             True: the mesh samples a smooth object, and curved triangles
                              interpolate it; False: the object has exactly the flat facets of the
                              mesh
    quadratic : bool          True: fields are quadratic on each triangle, with midside values
                              fitted to the surrounding vertices; False: linear elements, as in the
                              paper
    crease_angle : float [rad] angle between the normals of adjacent triangles above which their
                              edge is an edge of the object
    rings : int               rings of neighbours of an edge that the quadratics are fitted to, 1 or
                              2; the difference between the two estimates the interpolation error
    """

    smooth: bool = True
    quadratic: bool = True
    crease_angle: float = CREASE_ANGLE
    rings: int = 1


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
    settings: SurfaceSettings = SurfaceSettings(),
) -> BoundarySurface:
    """Prepare a closed mesh and its support for the boundary integrals.

    Parameters
    ----------
    mesh : TriangleMesh               closed, outward
    held_triangles : (k,) int         triangles of the support
    directions : (k, 3, 3) float      projector onto the directions in which each of them is held;
                                      None: all directions
    settings : SurfaceSettings

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
    sides = split_sides(mesh, region.ravel(), crease_angle=settings.crease_angle)
    displacement = displacement_nodes(mesh, sides, rings=settings.rings)
    traction = side_nodes(mesh, sides, rings=settings.rings)
    geometry = displacement if settings.smooth else linear_nodes(displacement)
    if not settings.quadratic:
        displacement, traction = linear_nodes(displacement), linear_nodes(traction)
    position = np.concatenate([mesh.vertices, geometry.weights @ mesh.vertices])
    nodes = position[geometry.element]
    length = float(np.sqrt(triangle_areas(mesh)[held].mean()))
    corrects_indentation = settings.smooth and settings.quadratic
    return BoundarySurface(
        mesh,
        sides,
        held,
        held_directions,
        nodes,
        displacement,
        traction,
        length,
        corrects_indentation,
    )


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


def _element_integrals(
    nodes: Float[np.ndarray, "k 6 3"],
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    rule = triangle_rule(7)
    area = np.linalg.norm(element_points(nodes, rule.barycentric)[:, :, 3:], axis=2)
    integrals = np.einsum("q,aq,kq->ka", rule.weight, quadratic_shapes(rule.barycentric), area)
    return integrals[:, :3], integrals[:, 3:]
