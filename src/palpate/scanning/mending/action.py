"""What was done to a surface, for the person who gave it."""

from dataclasses import dataclass

import numpy as np

from palpate.shapes import Vector3


@dataclass(frozen=True, slots=True, eq=False)
class Action:
    """One kind of defect and what became of it.

    Attributes
    ----------
    defect : str                    in the singular, as it stands in tables
    count : int                     how many
    place : (3,) float [m]          of the first one
    done : str
    """

    defect: str
    count: int
    place: Vector3
    done: str


def place_text(point: Vector3) -> str:
    """Coordinates in millimetres, for a message.

    Parameters
    ----------
    point : (3,) float [m]

    Returns
    -------
    str                             such as `(1.25, 0, 40) mm`
    """
    return "(" + ", ".join(f"{x:.5g}" for x in np.round(1e3 * np.asarray(point), 2) + 0.0) + ") mm"
