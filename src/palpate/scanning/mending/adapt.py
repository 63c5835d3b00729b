"""Triangles of wanted sizes over a surface, by Mmg."""

import numpy as np
from jaxtyping import Float

from palpate.geometry import CREASE_ANGLE, TriangleMesh
from palpate.optional_imports import late_import
from palpate.scanning.mending.deviation import nearest

# Mmg's own limit of how much neighbouring edges differ.
_GRADATION = 1.3


def adapted(
    mesh: TriangleMesh,
    size: Float[np.ndarray, " v"],
    *,
    onto: TriangleMesh | None = None,
    creases: bool = True,
) -> TriangleMesh:
    """The same surface in triangles with edges of wanted lengths, their vertices on it.

    Parameters
    ----------
    mesh : TriangleMesh             closed, manifold
    size : (v,) float [m]           wanted length of edges at each vertex
    onto : TriangleMesh or None     surface that the vertices are put on; None: `mesh`
    creases : bool                  keep edges where triangles turn by more than 40 degrees

    Returns
    -------
    TriangleMesh

    Source
    ------
    Dapogny, Dobrzynski, Frey, Three-dimensional adaptive domain remeshing, implicit domain meshing
    and applications to free and moving boundary problems, J. Comput. Phys. 262 (2014): Mmg.
    """
    mmg = late_import("mmgpy", extra="surface", purpose="remeshing a surface")
    body = mmg.MmgMeshS(mesh.vertices.copy(), mesh.triangles.astype(np.int32))
    body["metric"] = np.ascontiguousarray(size[:, None])
    ridges = {"ar": float(np.degrees(CREASE_ANGLE))} if creases else {"angle": 0}
    # The sizes alone say how fine: curvature is not to add to them.
    body.remesh(hgrad=_GRADATION, hausd=float(size.max()), verbose=-1, **ridges)
    # Mmg follows a smooth surface of its own, which strays by edges where sizes change quickly.
    _, place = nearest(np.array(body.get_vertices(), dtype=np.float64), onto or mesh)
    return TriangleMesh(vertices=place, triangles=np.array(body.get_triangles(), dtype=np.int64))
