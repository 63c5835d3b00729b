"""A surface through stereo points, for objects of which there is no mesh."""

import numpy as np

from palpate.shapes import Triangles, Vertices
from palpate.vision import StereoPoints
from palpate.vision.range_flow import grid_triangles

# Length over width of what is seen at 80 degrees: flatter, it shows no texture to be matched.
_MAX_STRETCH = 5.8


def triangulated_surface(stereo: StereoPoints) -> tuple[Vertices, Triangles]:
    """Stereo points joined to an open surface that faces the reference camera.

    Parameters
    ----------
    stereo : StereoPoints           n points

    Returns
    -------
    vertices : (n, 3) float [m]     all points, also those of no triangle
    triangles : (m, 3) int          two for every cell of the grid whose corners are all there and
                                    none of whose sides is a jump, steeper than 80 degrees
    """
    triangles = grid_triangles(stereo.pixel, stereo.step)
    corner = stereo.point[triangles]
    side = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)
    # One of the sides is the diagonal of the cell.
    flat = stereo.spacing[triangles] * np.sqrt(2.0)
    whole = (side <= _MAX_STRETCH * flat).all(axis=1)
    # Both halves of a cell, or none.
    both = whole.reshape(2, -1).all(axis=0)
    return stereo.point, triangles.reshape(2, -1, 3)[:, both].reshape(-1, 3)
