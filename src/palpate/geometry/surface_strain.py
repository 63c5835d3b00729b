"""Strain in a surface, from the displacement of its points."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from palpate.shapes import Points

# Points of a window, the middle one included: two rings of neighbours would average more.
_WINDOW = 13


def surface_strain(points: Points, displacement: Points) -> Float[np.ndarray, "n 2"]:
    """Principal strains in the surface (Green and Lagrange), which rigid motions leave at zero.

    As programs of image correlation compute it: a plane through the nearest points, and the
    displacement linear in it. Windows that reach over a sharp edge are wrong.

    Parameters
    ----------
    points : (n, 3) float [m]           at rest, n >= 3
    displacement : (n, 3) float [m]     NaN: a component that is not known, taken as zero

    Returns
    -------
    (n, 2) float [-]                    the larger and the smaller
    """
    near = cKDTree(points).query(points, min(_WINDOW, len(points)))[1]
    rest, moved = points[near], np.nan_to_num(displacement)[near]
    rest, moved = (vectors - vectors.mean(axis=1, keepdims=True) for vectors in (rest, moved))
    across = np.linalg.svd(rest, full_matrices=False)[2][:, :2]
    flat = np.einsum("nkc,nbc->nkb", rest, across)
    slope = np.linalg.pinv(flat) @ moved
    within = np.einsum("nac,nbc->nab", slope, across)
    strain = 0.5 * (within + np.swapaxes(within, 1, 2) + slope @ np.swapaxes(slope, 1, 2))
    return np.linalg.eigvalsh(strain)[:, ::-1]
