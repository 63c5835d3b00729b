"""Displacement of the whole surface, under tools or under forces at any of its points."""

import numpy as np
from jaxtyping import Float, Int

from palpate.errors import InputError
from palpate.geometry import closest_points
from palpate.shapes import Points, Vertices
from palpate.simulation.contact import ContactState
from palpate.simulation.green_functions import GreenFunctions
from palpate.simulation.kernels.linear import move_surface


def surface_displacement(green: GreenFunctions, state: ContactState) -> Vertices:
    """Displacement of the whole surface under tools.

    Parameters
    ----------
    green : GreenFunctions
    state : ContactState

    Returns
    -------
    (v, 3) float [m]
    """
    return _displacement_under_forces(green, state.touching, state.force)


def displacement_under(
    green: GreenFunctions, points: Points, forces: Float[np.ndarray, "n 3"]
) -> Vertices:
    """Displacement of the whole surface under forces at points of it.

    A force is distributed over the hat functions of the corners of its triangle by its barycentric
    coordinates.

    Parameters
    ----------
    green : GreenFunctions
    points : (n, 3) float [m]           projected on the surface if they are off it
    forces : (n, 3) float [N]           on the object

    Returns
    -------
    (v, 3) float [m]

    Raises
    ------
    InputError                          a point whose Green's functions are not known
    """
    closest = closest_points(green.mesh, points)
    corner = green.mesh.triangles[closest.triangle]
    known = np.isin(corner, green.nodes)
    outside = np.flatnonzero((~known & (closest.barycentric > 0.0)).any(axis=1))
    if outside.size:
        raise InputError(
            f"{outside.size} of {len(points)} points lie outside the part of the surface whose"
            f" Green's functions are known (first: {points[outside[0]].tolist()} m); make them of"
            " more vertices"
        )
    nodal = np.zeros((len(green.nodes), 3))
    node = np.searchsorted(green.nodes, corner[known])
    weight = closest.barycentric[:, :, None] * forces[:, None]
    np.add.at(nodal, node, weight[known])
    return _displacement_under_forces(green, np.unique(node), nodal)


def _displacement_under_forces(
    green: GreenFunctions, nodes: Int[np.ndarray, " k"], force: Float[np.ndarray, "n 3"]
) -> Vertices:
    """Displacement of the whole surface under forces on some nodes."""
    count, _, vertices, _ = green.surface.shape
    out = np.empty(3 * vertices)
    move_surface(green.surface.reshape(count, 3, 3 * vertices), nodes, force, out)
    return out.reshape(vertices, 3)
