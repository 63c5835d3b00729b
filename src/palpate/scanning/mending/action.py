"""Record of repairs to a surface, for the user."""

from dataclasses import dataclass

import numpy as np

from palpate.shapes import Vector3


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


def place_text(point: Vector3) -> str:
    """Coordinates in millimetres, for a message.

    Parameters
    ----------
    point : (3,) float [m]

    Returns
    -------
    str                             e.g. `(1.25, 0, 40) mm`
    """
    return "(" + ", ".join(f"{x:.5g}" for x in np.round(1e3 * np.asarray(point), 2) + 0.0) + ") mm"
