"""Equations for a rig from measured points on an object of known shape, and the object's pose."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.arrays import STD_OVER_MEDIAN
from palpate.calibration.known_object.ties import Ties, jacobians, tie_points, variance_inflation
from palpate.geometry import TriangleMesh, closest_points, compact_groups, unit_normals
from palpate.records import Rig, RigCovariance
from palpate.shapes import Vector3

# Prior standard deviation of the mesh's relative size; and the distance from the mesh, in robust
# standard deviations, beyond which points belong to something else.
_SIZE_SIGMA, _MAX_DEVIATIONS = 0.003, 4.0
# Number of compact groups of points; points that share matching errors lie in the same group.
GROUPS = 64


@dataclass(frozen=True, slots=True, eq=False)
class KnownSurface:
    """Surface of the object, and points on it matched between the cameras at one instant.

    Attributes
    ----------
    mesh : TriangleMesh
    pose : (4, 4) float [m]         approximate pose: x_mesh = pose x, x in the rig's frame
    ties : Ties
    """

    mesh: TriangleMesh
    pose: Float[np.ndarray, "4 4"]
    ties: Ties


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Pose and size of the object during the adjustment.

    Attributes
    ----------
    surface : KnownSurface
    pose : (4, 4) float [m]         as in `KnownSurface`
    relative_size : float [-]       relative size of the object to its mesh, minus one
    """

    surface: KnownSurface
    pose: Float[np.ndarray, "4 4"]
    relative_size: float

    def equations(
        self, rig: Rig, prior: RigCovariance, scale: Float[np.ndarray, "p k"]
    ) -> tuple[Float[np.ndarray, "u u"], Float[np.ndarray, " u"]]:
        """Normal equations of the points' distances from the mesh, with the prior of the size.

        The unknowns are k steps of the rig, then rotation, shift and relative size of the object.

        Parameters
        ----------
        rig : Rig
        prior : RigCovariance       its p parameters and their standard deviations
        scale : (p, k) float        independent steps, see `refine`

        Returns
        -------
        (k + 7, k + 7) float, (k + 7,) float    normal matrix and right-hand side

        Raises
        ------
        CalibrationError            the covariance is of other cameras
        """
        ties, mesh = self.surface.ties, self.surface.mesh
        offset, centre = self._offsets(rig)
        place = centre + offset / (1.0 + self.relative_size)
        found = closest_points(mesh, place)
        normal = unit_normals(TriangleMesh(mesh.vertices, mesh.triangles[found.triangle]))
        gap = np.einsum("na,na->n", normal, place - found.position)
        inside = (found.barycentric > 0.0).all(axis=1)
        noise = STD_OVER_MEDIAN * float(np.median(np.abs(gap[inside])))
        _, shift = jacobians(rig, prior, scale, ties)
        rows = np.concatenate(
            [
                np.einsum("na,ab,nbk->nk", normal, self.pose[:3, :3], shift),
                np.cross(offset, normal), normal,
                -np.einsum("na,na->n", normal, offset)[:, None],
            ],
            axis=1,
        )  # fmt: skip
        weight = (inside & (np.abs(gap) < _MAX_DEVIATIONS * noise)) / noise**2
        score = (weight * gap)[:, None] * rows
        # Neighbouring points share errors, from overlapping windows and from the mesh.
        weight /= max(variance_inflation(score[:, -7:], compact_groups(offset, GROUPS)), 1.0)
        matrix = rows.T @ (weight[:, None] * rows)
        right = -rows.T @ (weight * gap)
        matrix[-1, -1] += _SIZE_SIGMA**-2
        right[-1] -= self.relative_size / _SIZE_SIGMA**2
        return matrix, right

    def moved(self, rig: Rig, change: Float[np.ndarray, "7"]) -> "Body":
        """Apply a rotation about the centroid of the points, a shift, and a change of size.

        Parameters
        ----------
        rig : Rig
        change : (7,) float         rotation [rad], shift [m], relative size

        Returns
        -------
        Body
        """
        _, centre = self._offsets(rig)
        step = np.eye(4)
        step[:3, :3] = Rotation.from_rotvec(change[:3]).as_matrix()
        step[:3, 3] = centre - step[:3, :3] @ centre + change[3:6]
        size = self.relative_size + float(change[6])
        return replace(self, pose=step @ self.pose, relative_size=size)

    def _offsets(self, rig: Rig) -> tuple[Float[np.ndarray, "n 3"], Vector3]:
        """Points relative to their centroid, and the centroid, in the frame of the mesh [m]."""
        place = tie_points(rig, self.surface.ties) @ self.pose[:3, :3].T + self.pose[:3, 3]
        centre = place.mean(axis=0)
        return place - centre, centre
