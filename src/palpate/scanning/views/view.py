"""Points of a surface measured from one viewpoint."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from palpate.arrays import fixed_array
from palpate.errors import InputError
from palpate.shapes import Points, PointScalars, Vector3

Pose = Float[np.ndarray, "4 4"]
# Neighbours in its own view, itself included, that define a point's tangent plane.
_NEIGHBOURS = 24
_MIN_POINTS = 50


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Points of the surface measured from one viewpoint.

    Parameters
    ----------
    name : str
    points : (n, 3) float [m]       frame of the view
    normals : (n, 3) float          unit, towards the viewpoint
    sigma : (n,) float [m]          standard deviation along the normal, > 0
    eye : (3,) float [m]            viewpoint, frame of the view
    T_object_view : (4, 4) float [m] or None    None if unknown
    correlation_length : float [m]  distance within which errors of points are correlated; 0: they
                                    are independent
    """

    name: str
    points: Points
    normals: Points
    sigma: PointScalars
    eye: Vector3
    T_object_view: Pose | None = None
    correlation_length: float = 0.0

    def placed(self, pose: Pose) -> "View":
        """Transform points, normals and viewpoint by a pose.

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
    """Make a view from points, estimating normals and, if not given, noise from neighbours.

    Parameters
    ----------
    name : str
    points : (n, 3) float [m]       frame of the view
    sigma : (n,) or float [m] or None   standard deviation along the normal; None: the median
                                    scatter of neighbours about their tangent plane, which includes
                                    curvature
    eye : (3,) float [m] or None    viewpoint; None: the origin of the view's frame
    pose : (4, 4) float [m] or None T_object_view

    Returns
    -------
    View

    Raises
    ------
    InputError                      fewer than 50 points; collinear points; sigma not positive
    """
    points = fixed_array(points, name=f"points of view '{name}'", shape=(None, 3))
    if len(points) < _MIN_POINTS:
        raise InputError(f"view '{name}' has {len(points)} points; it needs {_MIN_POINTS} or more")
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
