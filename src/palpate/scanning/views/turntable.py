"""A turntable that rotates the object in front of a stationary scanner."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.errors import InputError
from palpate.shapes import Vector3


@dataclass(frozen=True, slots=True, eq=False)
class Turntable:
    """Rotation axis of the object, in the frame of the scanner.

    Parameters
    ----------
    point : (3,) float [m]          on the axis
    axis : (3,) float               direction; angles are right-handed about it

    Raises
    ------
    InputError                      the axis is zero
    """

    point: Vector3
    axis: Vector3

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.axis))
        if not length > 0.0:
            raise InputError("the axis is zero; give a direction")
        object.__setattr__(self, "axis", self.axis / length)

    def pose(self, angle: float) -> Float[np.ndarray, "4 4"]:
        """Pose T_object_view at an angle of the table; the object's frame is the view's at angle 0.

        Parameters
        ----------
        angle : float [rad]         right-handed about the axis

        Returns
        -------
        (4, 4) float [m]
        """
        pose = np.eye(4)
        # Undo the rotation of the table.
        pose[:3, :3] = Rotation.from_rotvec(-angle * self.axis).as_matrix()
        pose[:3, 3] = self.point - pose[:3, :3] @ self.point
        return pose
