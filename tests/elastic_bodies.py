"""Elastic bodies with known solutions, for tests of the boundary element model."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from surfaces import box

from palpate.bem import (
    BoundarySurface,
    BoundarySystem,
    SurfaceLoad,
    boundary_system,
    factorise,
    make_surface,
    solve,
    support_columns,
)
from palpate.bem.integrals.surface import Quadrature
from palpate.bem.loads.right_hand import traction_column
from palpate.geometry import TriangleMesh, unit_normals
from palpate.geometry.midside_nodes import ELEMENT_NODES, element_points

DEFAULT = Quadrature()


@dataclass(frozen=True)
class Material:
    """Isotropic elastic constants."""

    shear: float
    poisson: float

    def stress(self, gradient: np.ndarray) -> np.ndarray:
        """Hooke's law for displacement gradients (..., 3, 3)."""
        strain = 0.5 * (gradient + np.swapaxes(gradient, -1, -2))
        trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
        lame = 2 * self.shear * self.poisson / (1 - 2 * self.poisson)
        return 2 * self.shear * strain + lame * trace * np.eye(3)


@dataclass(frozen=True)
class KnownField:
    """A displacement that is in equilibrium without body force, and its stress."""

    displacement: Callable[[np.ndarray], np.ndarray]
    stress: Callable[[np.ndarray], np.ndarray]


def linear_field(gradient: np.ndarray, material: Material) -> KnownField:
    """u = gradient x: uniform strain."""
    sigma = material.stress(gradient)
    return KnownField(lambda x: x @ gradient.T, lambda x: np.broadcast_to(sigma, (*x.shape, 3)))


def point_source(source: np.ndarray, force: np.ndarray, material: Material) -> KnownField:
    """Kelvin's solution: a point force in unbounded space, written by hand, not by the package."""
    nu, shear = material.poisson, material.shear
    scale = 1 / (16 * np.pi * shear * (1 - nu))

    def displacement(x):
        r = x - source
        d = np.linalg.norm(r, axis=-1, keepdims=True)
        return scale * ((3 - 4 * nu) * force / d + r * (r @ force)[..., None] / d**3)

    def stress(x):
        r = x - source
        d = np.linalg.norm(r, axis=-1)[..., None, None]
        along = (r @ force)[..., None, None]
        outer = r[..., :, None] * r[..., None, :]
        mixed = r[..., :, None] * force + force[:, None] * r[..., None, :]
        part = (1 - 2 * nu) * (mixed - along * np.eye(3)) / d**3 + 3 * outer * along / d**5
        return -part / (8 * np.pi * (1 - nu))

    return KnownField(displacement, stress)


def cube_with_faces(cells: int) -> tuple[TriangleMesh, np.ndarray]:
    """Unit cube and the number of the face of each triangle: 2 axis + (1 on the far side)."""
    mesh = box(cells=cells)
    normal = unit_normals(mesh)
    axis = np.abs(normal).argmax(axis=1)
    return mesh, 2 * axis + (normal[np.arange(axis.size), axis] > 0)


def element_traction(surface: BoundarySurface, triangles: np.ndarray, field: KnownField):
    """Traction of a known field at the six nodes of some elements."""
    points = element_points(surface.element_nodes[triangles], ELEMENT_NODES)
    normal = points[..., 3:] / np.linalg.norm(points[..., 3:], axis=-1, keepdims=True)
    return np.einsum("mqij,mqj->mqi", field.stress(points[..., :3]), normal)


def solve_known(
    system: BoundarySystem,
    field: KnownField,
    material: Material,
    *,
    quadrature: Quadrature = DEFAULT,
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of every vertex and traction at the held sides, from a field's own boundary
    data."""
    surface = system.surface
    vertices = surface.mesh.vertices
    free = np.flatnonzero(~surface.held)
    traction = element_traction(surface, free, field) / material.shear
    exact = field.displacement(vertices)
    right = traction_column(system, free, traction, quadrature=quadrature).at(material.poisson)
    right = right + support_columns(system, exact[:, :, None]).at(material.poisson)
    x = solve(factorise(system, material.poisson), right)[:, 0]
    count = 3 * system.unknowns.free_vertices.size
    displacement = exact.copy()
    displacement[system.unknowns.free_vertices] = x[:count].reshape(-1, 3)
    scale = material.shear / system.traction_length
    return displacement, x[count:-3].reshape(-1, 3) * scale


def held_part(mesh: TriangleMesh, chosen: np.ndarray, **options) -> BoundarySystem:
    """System of a mesh held at the chosen triangles (flags or numbers)."""
    quadrature = options.pop("quadrature", Quadrature())
    held = np.flatnonzero(chosen) if np.asarray(chosen).dtype == bool else np.asarray(chosen)
    surface = make_surface(mesh, held, **options)
    return boundary_system(surface, quadrature=quadrature)


def bump_load(mesh: TriangleMesh, centre: np.ndarray, radius: float) -> SurfaceLoad:
    """A smooth round load, (1 - s^2)^2, without the contact's own dip."""
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    edge = np.linalg.norm(np.ptp(mesh.vertices[mesh.triangles], axis=1), axis=1).max()
    triangles = np.flatnonzero(np.linalg.norm(middle - centre, axis=1) < radius + edge)

    def density(triangle, barycentric, position):
        square = ((position - centre) ** 2).sum(axis=1) / radius**2
        return np.clip(1 - square, 0, None) ** 2

    return SurfaceLoad(triangles, density)
