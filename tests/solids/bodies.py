"""Bodies for tests of the finite elements."""

import numpy as np
import skfem
from scipy.spatial import Delaunay
from surfaces import joined, sphere

from palpate.geometry import TriangleMesh
from palpate.solids.tetrahedra import Solid, make_solid, quadratic_solid


def half_ball(shared_data, name, **options):
    """Data of a case of halfball_facets, its body and the triangles of its support."""
    with np.load(shared_data / "halfball_facets" / f"{name}.npz") as case:
        data = {key: case[key] for key in case.files}
    vertices, triangles = data["V"].astype(float), data["F"].astype(np.int64)
    support = np.flatnonzero((vertices[triangles][:, :, 2] <= 1e-6).all(axis=1))
    return data, make_solid(TriangleMesh(vertices, triangles), **options), support


def traction_load(solid: Solid, traction, where=None, order: int = 2) -> np.ndarray:
    """Nodal forces (n, 3) of a traction on outer faces.

    `traction` takes positions (3, faces, points) to tractions of that shape, `where` the middles of
    faces (3, faces) to those that carry it, `order` is the degree that is integrated exactly.
    """
    nodes, corners = (np.ascontiguousarray(a.T) for a in (solid.nodes, solid.elements[:, :4]))
    mesh = skfem.MeshTet2(nodes, corners)
    facets = mesh.boundary_facets() if where is None else mesh.facets_satisfying(where, True)
    basis = skfem.FacetBasis(mesh, skfem.ElementTetP2(), facets=facets, intorder=order)
    forms = [skfem.LinearForm(lambda v, w, i=i: traction(w.x)[i] * v) for i in range(3)]
    return np.stack([form.assemble(basis) for form in forms], axis=1)


def even_traction(vector):
    """The same traction everywhere."""
    return lambda x: np.broadcast_to(np.reshape(vector, (3, 1, 1)), x.shape)


def smooth_patch(solid: Solid, point, radius: float, force) -> np.ndarray:
    """Nodal forces of a pressure (1 - s^2)^2 around a point, s the distance over the radius."""

    def traction(x):
        s2 = ((x - np.reshape(point, (3, 1, 1))) ** 2).sum(axis=0) / radius**2
        return np.clip(1.0 - s2, 0.0, None) ** 2 * np.reshape(force, (3, 1, 1))

    load = traction_load(solid, traction, order=12)
    return load * (np.linalg.norm(force) / np.linalg.norm(load.sum(axis=0)))


def shell(inner: float, outer: float, subdivisions: int, layers: int) -> tuple[Solid, np.ndarray]:
    """Hollow ball of even layers, and which of its facets lie on the inner sphere."""
    layer = sphere(subdivisions).vertices
    # Layers turned against each other, or Delaunay meets four points on a circle everywhere.
    turned = []
    for k, radius in enumerate(np.linspace(inner, outer, layers + 1)):
        c, s = np.cos(0.3 * k), np.sin(0.3 * k)
        turned.append(radius * layer @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))
    points = np.concatenate(turned)
    cells = Delaunay(points).simplices.astype(np.int64)
    hollow = (cells < len(layer)).all(axis=1)
    side = points[cells[:, 1:]] - points[cells[:, :1]]
    volume = np.abs(np.linalg.det(side))
    cells = cells[~hollow & (volume > 1e-9 * volume.max())]
    fine = sphere(subdivisions + 2)
    inside = sphere(subdivisions + 2, inner)
    mesh = joined(type(fine)(outer * fine.vertices, fine.triangles), inside)
    solid = quadratic_solid(points, cells, mesh=mesh)
    return solid, solid.facet_triangle >= len(fine.triangles)
