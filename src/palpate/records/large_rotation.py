"""Detection of a rigid rotation of the measured points that is too large for a linear model."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.errors import InputError

# Rotations that cause a warning and a refusal [rad]. A rotation has a spurious linearised strain of
# half its square: 2 % and 12 % here. The refusal is not at less since the free end of a bent beam
# may rotate by 20 degrees, and looks much like a rotated body.
LARGE_ROTATION, _LARGEST_ROTATION = 0.2, 0.5
# A motion counts as a rotation if at most this fraction of it, without its translation, is left
# after the best rotation.
_MAX_UNEXPLAINED = 0.5
# Points closer to a line than this fraction of their extent do not determine the rotation about it.
_COLLINEAR = 1e-2


def check_rotation(
    points: Float[np.ndarray, "n 3"], displacement: Float[np.ndarray, "n 3"], place: str
) -> None:
    """Refuse displacements that are mostly a large rigid rotation.

    Parameters
    ----------
    points : (n, 3) float [m]           at rest
    displacement : (n, 3) float [m]     of each, finite
    place : str                         file or pictures they come from, for the message

    Raises
    ------
    InputError                          a rotation of more than 0.5 rad; the text gives its angle
    """
    angle = rigid_rotation_angle(points, displacement)
    if angle > _LARGEST_ROTATION:
        raise InputError(
            f"{place}: the measured points turned by {np.degrees(angle):.0f} degrees as a whole"
            " between rest and load; displacements must be small, turns"
            f" {np.degrees(_LARGEST_ROTATION):.0f} degrees at most: did the object or the cameras"
            " move in between? Bring the loaded points back onto the resting ones by what did not"
            " deform (the support), or measure again with the object held"
        )


def rigid_rotation_angle(
    points: Float[np.ndarray, "n 3"], displacement: Float[np.ndarray, "n 3"]
) -> float:
    """Angle of the best-fitting rigid rotation of the points, if that explains most of the motion.

    Parameters
    ----------
    points : (n, 3) float [m]           at rest
    displacement : (n, 3) float [m]     finite

    Returns
    -------
    float [rad]                         0 to pi; 0 if the motion is not mainly a rotation, or the
                                        points are too few or collinear

    Source
    ------
    Kabsch, Acta Cryst. A 32 (1976) 922, in scipy.
    """
    if len(points) < 3:
        return 0.0
    before = points - points.mean(axis=0)
    after = before + displacement - displacement.mean(axis=0)
    spread = np.linalg.svd(before, compute_uv=False)
    if not spread[1] > _COLLINEAR * spread[0]:
        return 0.0
    rotation, residual = Rotation.align_vectors(after, before)
    moved = float(np.linalg.norm(after - before))
    return float(rotation.magnitude()) if residual < _MAX_UNEXPLAINED * moved else 0.0
