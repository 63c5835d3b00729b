"""How thick a body is behind each of its triangles."""

import numpy as np
from scipy.spatial import cKDTree

from palpate.geometry.triangle_mesh import TriangleMesh, half_edges, unit_normals
from palpate.shapes import PointScalars

# Cosine from which normals face away from each other; that across an edge of less than 70 degrees.
_FACING, _KNIFE = 0.7, -0.34
_NEIGHBOURS = 40


def wall_thickness(mesh: TriangleMesh) -> PointScalars:
    """Distance of each triangle's centre to the nearest one that faces the other way behind it.

    Parameters
    ----------
    mesh : TriangleMesh             closed, outward, m triangles

    Returns
    -------
    (m,) float [m]                  infinite where none of the 40 nearest triangles is such a one,
                                    so a wall is found up to about two edges thick, and along a
                                    knife's edge, where both sides meet
    """
    centre, normal = mesh.vertices[mesh.triangles].mean(axis=1), unit_normals(mesh)
    gap, other = cKDTree(centre).query(centre, k=min(_NEIGHBOURS, len(centre)))
    away = centre[other] - centre[:, None]
    behind = np.einsum("kja,ka->kj", away, normal) < -_FACING * gap
    opposite = np.einsum("kja,ka->kj", normal[other], normal) < -_FACING
    thickness = np.where(behind & opposite, gap, np.inf).min(axis=1)
    # The two sides of a knife's edge meet there: no sheet.
    halves = half_edges(mesh.triangles)
    a, b = halves.pairs().T
    knife = np.einsum("ka,ka->k", normal[a // 3], normal[b // 3]) < _KNIFE
    if knife.any():
        middle = mesh.vertices[halves.ends[halves.edge[a[knife]]]].mean(axis=1)
        length = np.linalg.norm(np.diff(mesh.vertices[halves.ends], axis=1)[:, 0], axis=1)
        close, _ = cKDTree(middle).query(centre)
        thickness[close < 3.0 * float(np.median(length))] = np.inf
    return thickness
