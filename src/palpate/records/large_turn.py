"""Whether measured points turned as a whole, farther than small displacements allow."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.errors import InputError

# Linear in a turn, displacements leave half its square as a false strain: 2 % and 12 % here. The
# free end of a beam that bends turns by 20 degrees, and looks much like a body that is turned.
LARGE_TURN, _LARGEST_TURN = 0.2, 0.5
# Of what the points moved beside a shift, the turn must explain all but this, or it is no turn.
_LEFT = 0.5
# Points nearer to one line than this part of their length say nothing about a turn around it.
_ON_A_LINE = 1e-2


def check_turn(
    points: Float[np.ndarray, "n 3"], displacement: Float[np.ndarray, "n 3"], place: str
) -> None:
    """Refuse displacements that are mostly a large rigid turn.

    Parameters
    ----------
    points : (n, 3) float [m]           at rest
    displacement : (n, 3) float [m]     of each, finite
    place : str                         file or pictures they come from, for the message

    Raises
    ------
    InputError                          the text gives the turn
    """
    turn = whole_turn(points, displacement)
    if turn > _LARGEST_TURN:
        raise InputError(
            f"{place}: the measured points turned by {np.degrees(turn):.0f} degrees as a whole"
            " between rest and load; displacements must be small, turns"
            f" {np.degrees(_LARGEST_TURN):.0f} degrees at most: did the object or the cameras move"
            " in between? Bring the loaded points back onto the resting ones by what did not deform"
            " (the support), or measure again with the object held"
        )


def whole_turn(points: Float[np.ndarray, "n 3"], displacement: Float[np.ndarray, "n 3"]) -> float:
    """The rigid turn that brings points nearest to where they moved, if that is most of the motion.

    Parameters
    ----------
    points : (n, 3) float [m]
    displacement : (n, 3) float [m]     finite

    Returns
    -------
    float [rad]                         0 to pi; 0 where the motion is something else, or the points
                                        say nothing about turns

    Source
    ------
    Kabsch, Acta Cryst. A 32 (1976) 922, in scipy.
    """
    if len(points) < 3:
        return 0.0
    before = points - points.mean(axis=0)
    after = before + displacement - displacement.mean(axis=0)
    spread = np.linalg.svd(before, compute_uv=False)
    if not spread[1] > _ON_A_LINE * spread[0]:
        return 0.0
    rotation, left = Rotation.align_vectors(after, before)
    moved = float(np.linalg.norm(after - before))
    return float(rotation.magnitude()) if left < _LEFT * moved else 0.0
