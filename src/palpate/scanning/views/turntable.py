"""A table that turns the object before a scanner that stands still."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.errors import InputError
from palpate.shapes import Vector3


@dataclass(frozen=True, slots=True, eq=False)
class Turntable:
    """The axis that the object turns about, in the frame of the scanner.

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
        """T_object_view where the table stands at an angle; the object's frame is that at 0.

        Parameters
        ----------
        angle : float [rad]
        """
        pose = np.eye(4)
        # The table has turned the object; turned back, its points are where they are at 0.
        pose[:3, :3] = Rotation.from_rotvec(-angle * self.axis).as_matrix()
        pose[:3, 3] = self.point - pose[:3, :3] @ self.point
        return pose
