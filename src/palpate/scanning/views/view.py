"""What one viewpoint saw of the surface."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from palpate.arrays import fixed_array
from palpate.errors import InputError
from palpate.shapes import Points, PointScalars, Vector3

Pose = Float[np.ndarray, "4 4"]
# Neighbours that tell the tangent plane of a point, of its own view.
_NEIGHBOURS = 24
_FEWEST = 50


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Points of the surface as one viewpoint measured them.

    Parameters
    ----------
    name : str
    points : (n, 3) float [m]       frame of the view
    normals : (n, 3) float          unit, toward the viewpoint
    sigma : (n,) float [m]          standard deviation along the normal, > 0
    eye : (3,) float [m]            viewpoint
    T_object_view : (4, 4) float or None    None where it is not known
    shared : float [m]              points nearer to each other share a part of their errors; 0:
                                    each errs by itself
    """

    name: str
    points: Points
    normals: Points
    sigma: PointScalars
    eye: Vector3
    T_object_view: Pose | None = None
    shared: float = 0.0

    def placed(self, pose: Pose) -> "View":
        """The view with points, normals and eye in the frame that a pose leads to.

        Parameters
        ----------
        pose : (4, 4) float [m]     x_new = pose x_view

        Returns
        -------
        View                        its pose is the identity
        """
        turn, shift = pose[:3, :3], pose[:3, 3]
        return replace(
            self,
            points=self.points @ turn.T + shift,
            normals=self.normals @ turn.T,
            eye=turn @ self.eye + shift,
            T_object_view=np.eye(4),
        )


def make_view(
    name: str,
    points: Points,
    *,
    sigma: PointScalars | float | None = None,
    eye: Vector3 | None = None,
    pose: Pose | None = None,
) -> View:
    """A view of points: normals from their neighbours, noise from what these leave.

    Parameters
    ----------
    name : str
    points : (n, 3) float [m]       frame of the view
    sigma : (n,) or float [m] or None   along the normal; None: the scatter of neighbours about
                                    their plane, which bends add to
    eye : (3,) float [m] or None    where they were seen from; None: the origin of the view
    pose : (4, 4) float or None     T_object_view

    Returns
    -------
    View

    Raises
    ------
    InputError                      fewer than 50 points, or points on a line; sigma not positive
    """
    points = fixed_array(points, name=f"points of view '{name}'", shape=(None, 3))
    if len(points) < _FEWEST:
        raise InputError(f"view '{name}' has {len(points)} points; it needs {_FEWEST} or more")
    eye = np.zeros(3) if eye is None else np.asarray(eye, dtype=np.float64)
    _, near = cKDTree(points).query(points, k=_NEIGHBOURS)
    offset = points[near] - points[near].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nka,nkb->nab", offset, offset) / _NEIGHBOURS)
    if not np.median(values[:, 1]) > 1e-8 * np.median(values[:, 2]):
        raise InputError(f"the points of view '{name}' lie on lines; a surface needs area")
    normals = vectors[:, :, 0]
    away = np.einsum("na,na->n", normals, eye - points) < 0.0
    normals = np.where(away[:, None], -normals, normals)
    if sigma is None:
        scatter = np.sqrt(np.maximum(values[:, 0], 0.0))
        sigma = np.full(len(points), max(float(np.median(scatter)), 1e-9))
    sigma = np.broadcast_to(np.asarray(sigma, dtype=np.float64), len(points)).copy()
    if not sigma.min() > 0.0:
        raise InputError(f"sigma of view '{name}' goes down to {sigma.min():g}; must be positive")
    return View(name, points, normals, sigma, eye, pose)
