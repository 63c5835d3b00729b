"""Places on a surface: a plane, such as the support that an object stands on; a repair."""

import re
from dataclasses import dataclass

import numpy as np

from palpate.arrays import fixed_array
from palpate.errors import InputError
from palpate.shapes import Points, PointScalars, Vector3

_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane given by a point and its normal.

    Parameters
    ----------
    point : (3,) float [m]
    normal : (3,) float             normalised to unit length

    Raises
    ------
    InputError                      the normal is zero, or a number is not finite
    """

    point: Vector3
    normal: Vector3

    def __post_init__(self) -> None:
        point = fixed_array(self.point, name="point of the plane", shape=(3,))
        normal = fixed_array(self.normal, name="normal of the plane", shape=(3,))
        length = float(np.linalg.norm(normal))
        if length == 0.0:
            raise InputError("the normal of the plane is 0, 0, 0; give a direction")
        object.__setattr__(self, "point", point)
        object.__setattr__(self, "normal", fixed_array(normal / length, name="normal", shape=(3,)))

    def heights(self, points: Points) -> PointScalars:
        """Signed distance of points, (n, 3) [m], from the plane, positive on the normal's side."""
        return (points - self.point) @ self.normal

    def projected(self, points: Points) -> Points:
        """Orthogonal projection of points, (n, 3) [m], onto the plane."""
        return points - self.heights(points)[:, None] * self.normal


def plane_from_text(text: str, *, metres_per_unit: float = 1.0) -> Plane:
    """Parse a plane as given on the command line.

    Parameters
    ----------
    text : str                      `z=0` or `x=-12.5`, or a point and a normal, `0,0,0,0,0.1,1`
    metres_per_unit : float         length unit of the text [m]

    Returns
    -------
    Plane

    Raises
    ------
    InputError                      the text has neither form
    """
    words = [word for word in re.split(r"[\s,;]+", text.strip()) if word]
    axis, equals, value = text.replace(" ", "").partition("=")
    try:
        if equals and axis.lower() in _AXES:
            normal = np.eye(3)[_AXES[axis.lower()]]
            return Plane(float(value) * metres_per_unit * normal, normal)
        numbers = np.array([float(word) for word in words])
        if len(numbers) != 6:
            raise ValueError
    except ValueError:
        raise InputError(
            f'the plane "{text}" is not understood; write z=0, or a point and a normal like'
            " 0,0,0,0,0,1"
        ) from None
    return Plane(metres_per_unit * numbers[:3], numbers[3:])


def plane_text(plane: Plane) -> str:
    """Format a plane as `plane_from_text` reads it, in metres.

    Parameters
    ----------
    plane : Plane

    Returns
    -------
    str                             six numbers, point and normal
    """
    return ",".join(f"{x + 0.0:.5g}" for x in (*plane.point, *plane.normal))


@dataclass(frozen=True, slots=True, eq=False)
class Action:
    """One kind of defect and its repair.

    Attributes
    ----------
    defect : str                    name in the singular, for tables
    count : int                     number of such defects
    place : (3,) float [m]          of the first one
    done : str                      the repair, in words
    """

    defect: str
    count: int
    place: Vector3
    done: str
