"""Bodies for tests of the finite elements."""

import numpy as np
from scipy.spatial import Delaunay
from surfaces import joined, sphere

from palpate.lab.bodies.tetrahedra import Solid, make_solid, quadratic_solid


def half_ball(shared_data, name, **options):
    """Data of a case of halfball_facets, its body and the triangles of its support."""
    with np.load(shared_data / "halfball_facets" / f"{name}.npz") as case:
        data = {key: case[key] for key in case.files}
    vertices, triangles = data["V"].astype(float), data["F"].astype(np.int64)
    support = np.flatnonzero((vertices[triangles][:, :, 2] <= 1e-6).all(axis=1))
    return data, make_solid(vertices, triangles, **options), support


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
