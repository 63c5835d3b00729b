"""A convex body as the planes of its faces."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from palpate.errors import InputError
from palpate.geometry.triangle_mesh import TriangleMesh, enclosed_volume

# Largest difference in volume between a mesh and its convex hull, relative to the latter.
_CONVEXITY_TOLERANCE = 1e-6
# Decimals, of the normal and of the offset over the body's size, to which planes are the same.
_DECIMALS = 9


def convex_planes(mesh: TriangleMesh) -> Float[np.ndarray, "p 4"]:
    """The planes of the faces of a convex mesh, coplanar triangles as one.

    Parameters
    ----------
    mesh : TriangleMesh             closed, convex

    Returns
    -------
    (p, 4) float                    outward unit normals, and their offsets from the origin [m]

    Raises
    ------
    InputError                      a mesh that is flat, open or not convex
    """
    size = float(np.ptp(mesh.vertices, axis=0).max(initial=0.0))
    try:
        hull = ConvexHull(mesh.vertices / size)
    except (QhullError, ValueError, ZeroDivisionError) as error:
        raise InputError("the tool's mesh has no volume; give a closed convex surface") from error
    volume, hull_volume = abs(enclosed_volume(mesh)), hull.volume * size**3
    if hull_volume - volume > _CONVEXITY_TOLERANCE * hull_volume:
        raise InputError(
            f"the tool's mesh holds {1e6 * volume:.4g} ml, its convex hull {1e6 * hull_volume:.4g}"
            " ml; a tool must be convex and closed: give its hull, or several convex tools"
        )
    planes = np.unique(np.round(hull.equations, _DECIMALS), axis=0)
    return np.column_stack([planes[:, :3], -size * planes[:, 3]])
