"""Wall thickness of a body behind each of its triangles."""

import numpy as np
from scipy.spatial import cKDTree

from palpate.geometry.triangle_mesh import TriangleMesh, half_edges, unit_normals
from palpate.shapes import PointScalars

# Cosine from which two normals count as opposite; cosine of the normals at an edge of 70 degrees.
_FACING, _KNIFE = 0.7, -0.34
_NEIGHBOURS = 40


def wall_thickness(mesh: TriangleMesh) -> PointScalars:
    """Distance of each triangle's centroid to the nearest opposite one behind it.

    Parameters
    ----------
    mesh : TriangleMesh             closed, outward, m triangles

    Returns
    -------
    (m,) float [m]                  infinite where none of the 40 nearest triangles is opposite, so
                                    that walls are found up to about two edge lengths thick, and
                                    close to a knife edge, where both faces meet

    Raises
    ------
    MeshError                       a triangle of zero area
    """
    centre, normal = mesh.vertices[mesh.triangles].mean(axis=1), unit_normals(mesh)
    gap, other = cKDTree(centre).query(centre, k=min(_NEIGHBOURS, len(centre)))
    away = centre[other] - centre[:, None]
    behind = np.einsum("kja,ka->kj", away, normal) < -_FACING * gap
    opposite = np.einsum("kja,ka->kj", normal[other], normal) < -_FACING
    thickness = np.where(behind & opposite, gap, np.inf).min(axis=1)
    # The two faces of a knife edge meet there: this is not a thin wall.
    halves = half_edges(mesh.triangles)
    a, b = halves.pairs().T
    knife = np.einsum("ka,ka->k", normal[a // 3], normal[b // 3]) < _KNIFE
    if knife.any():
        middle = mesh.vertices[halves.ends[halves.edge[a[knife]]]].mean(axis=1)
        length = np.linalg.norm(np.diff(mesh.vertices[halves.ends], axis=1)[:, 0], axis=1)
        close, _ = cKDTree(middle).query(centre)
        thickness[close < 3.0 * float(np.median(length))] = np.inf
    return thickness
