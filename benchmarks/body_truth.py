"""True displacements of a body under a tool, from quadratic tetrahedra: nothing of them is shared
with the boundary elements that estimate."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from benchmarks.bodies import Shape
from palpate.geometry import TriangleMesh, unit_normals, wall_thickness
from palpate.records.contact import smooth_pressure
from palpate.shapes import Points
from palpate.solids.finite_elements import (
    Body,
    make_body,
    pressure_load,
    solve_load,
    surface_values,
)
from palpate.solids.tetrahedra import Solid, make_solid

SHEAR_MODULUS = 2e4
RADIUS = 5e-3
# A tool keeps its radius and a little more away from edges and from the support.
_CLEARANCE = 1.35
# Edges of the surface that is filled over those of the surface that estimates.
_SURFACE = 0.2
# Edge of the tetrahedra under a tool over its radius.
_FINE = 0.25
# Edge of the tetrahedra over the thickness of walls, and how much of the surface has walls so thin
# before they count: with two elements across its wall, a tube was off by 0.3 %, with three by 0.07.
_WALL, _THIN_SHARE = 1 / 3, 0.05
# Between contacts.
_APART = 15e-3
# Points along a side of a triangle, of those that stand for a line.
_ALONG = np.linspace(0, 1, 9)[:, None, None]


@dataclass(frozen=True, slots=True)
class Contact:
    """A place to press at.

    Attributes
    ----------
    point, inward : (3,) float      [m], unit vector
    """

    point: Float[np.ndarray, "3"]
    inward: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """Sides between two triangles.

    Attributes
    ----------
    ends : (e, 2, 3) float [m]
    sharp, rim, hollow : (e,) bool      faces meet at 40 degrees or more; the support ends here; the
                                        faces meet from the inside of a corner
    """

    ends: Float[np.ndarray, "e 2 3"]
    sharp: Bool[np.ndarray, " e"]
    rim: Bool[np.ndarray, " e"]
    hollow: Bool[np.ndarray, " e"]

    def points(self, chosen: Bool[np.ndarray, " e"]) -> Points:
        """Points along some of them."""
        start, end = self.ends[chosen].transpose(1, 0, 2)
        return (start * (1 - _ALONG) + end * _ALONG).reshape(-1, 3)


def _lines(mesh: TriangleMesh, held: Bool[np.ndarray, " m"]) -> _Lines:
    normals, centres = unit_normals(mesh), mesh.vertices[mesh.triangles].mean(axis=1)
    edges = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    first, other = np.repeat(np.arange(len(normals)), 3)[order].reshape(-1, 2).T
    sharp = (normals[first] * normals[other]).sum(1) < np.cos(np.radians(40))
    inside = ((centres[other] - centres[first]) * normals[first]).sum(axis=1) > 0.0
    ends = mesh.vertices[edges[order][::2]]
    return _Lines(ends, sharp, held[first] != held[other], sharp & inside)


def held_triangles(mesh: TriangleMesh, shape: Shape) -> Bool[np.ndarray, " m"]:
    """Triangles of a body's surface that its support holds."""
    return (mesh.vertices[mesh.triangles][:, :, 2] < shape.held).all(axis=1)


def contacts(mesh: TriangleMesh, shape: Shape) -> list[Contact]:
    """Vertices toward the shape's directions, away from edges, support and each other."""
    normals, held = unit_normals(mesh), held_triangles(mesh, shape)
    lines = _lines(mesh, held)
    away = np.full(len(mesh.vertices), np.inf)
    marked = lines.points(lines.sharp | lines.rim)
    if len(marked):
        away = cKDTree(marked).query(mesh.vertices)[0]
    away[np.unique(mesh.triangles[held])] = 0.0
    chosen: list[Contact] = []
    for toward in shape.towards:
        free = away > _CLEARANCE * RADIUS
        for other in chosen:
            free &= np.linalg.norm(mesh.vertices - other.point, axis=1) > _APART
        offset = mesh.vertices - mesh.vertices.mean(0)
        vertex = int(np.where(free, offset @ np.array(toward), -np.inf).argmax())
        near = (mesh.triangles == vertex).any(axis=1)
        normal = -normals[near].mean(axis=0)
        chosen.append(Contact(mesh.vertices[vertex], normal / np.linalg.norm(normal)))
    return chosen


def element_size(mesh: TriangleMesh, shape: Shape) -> float:
    """Edge of the tetrahedra [m]: that of the surface that estimates, or a third of thin walls."""
    thickness = np.sort(wall_thickness(mesh))
    return min(shape.edge, _WALL * float(thickness[int(_THIN_SHARE * len(thickness))]))


@dataclass(frozen=True, eq=False)
class Truth:
    """A held body of one material, factorised for any load.

    Attributes
    ----------
    body : Body
    """

    body: Body

    def displacement(
        self, point: Float[np.ndarray, "3"], force: Float[np.ndarray, "3"], radius: float
    ) -> Float[np.ndarray, "n 3"]:
        """Nodal displacement [m] under a pressure (1 - r^2 / a^2)^2 around a point."""
        share = pressure_load(self.body.solid, point, radius, smooth_pressure)
        return solve_load(self.body, share[:, None] * force)

    def at(self, nodal: Float[np.ndarray, "n 3"], points: Points) -> Points:
        """Displacement of points of the surface, or of the nearest places."""
        return surface_values(self.body.solid, points) @ nodal


def make_truth(
    shape: Shape, *, edge: float, rim: float, support_stiffness: float | None = None
) -> Truth:
    """A body, filled from a surface much finer than the one that estimates.

    Parameters
    ----------
    shape : Shape
    edge : float [m]            of the tetrahedra, away from the tools
    rim : float [m]             of those where the support ends and in hollow corners, where
                                stresses have no bound
    support_stiffness : float [N/m^3]    of springs under the support; None: rigid
    """
    solid, held = graded_solid(shape, edge=edge, rim=rim)
    return Truth(
        make_body(
            solid, held, shear_modulus=SHEAR_MODULUS, poisson_ratio=shape.poisson_ratio,
            support_stiffness=support_stiffness,
        )
    )  # fmt: skip


def graded_solid(shape: Shape, *, edge: float, rim: float) -> tuple[Solid, Bool[np.ndarray, " n"]]:
    """Tetrahedra of a body, filled from a surface much finer than the one that estimates.

    Parameters
    ----------
    shape, edge, rim : as `make_truth`

    Returns
    -------
    Solid
    (n,) bool                   nodes on the support
    """
    places = contacts(shape.make(shape.edge), shape)
    surface = shape.make(_SURFACE * shape.edge)
    lines = _lines(surface, held_triangles(surface, shape))
    fine = [(contact.point, 1.2 * RADIUS, _FINE * RADIUS) for contact in places]
    fine += [(point, 0.0, rim) for point in lines.points(lines.rim | lines.hollow)]
    solid = make_solid(surface, edge=edge, fine=fine)
    return solid, _held(solid, shape)


def _held(solid: Solid, shape: Shape) -> Bool[np.ndarray, " n"]:
    low = (solid.nodes[solid.facets][:, :, 2] < shape.held).all(axis=1)
    held = np.zeros(len(solid.nodes), dtype=bool)
    held[solid.facets[low]] = True
    return held
