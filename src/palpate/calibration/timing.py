"""Detection of timing errors while boards move: a rolling shutter, or unsynchronised cameras.

The motion of the board need not be known. The residuals of a view are compared with those that a
velocity of its board would cause: with a rolling shutter, each row is shifted by the time at which
it is read; if a camera is late, all its corners are shifted.
"""

import numpy as np
from jaxtyping import Float

from palpate.calibration.adjustment import view_jacobians
from palpate.calibration.calibrate import Calibration

# Minimum fraction of the residual variance explained by velocities, adjusted for their number; and
# its minimum excess for rows over columns, because a bent board is fitted equally well by both.
_MUCH, _MORE = 0.3, 0.1
_POSE, _VELOCITY = 6, 3
_ROLLS = (
    "boards that move while rows are read one after another explain {fraction:.0%} of the variance"
    " of the corners: a shutter rolls; hold the board still for a second in each place"
)
_LATE = (
    "boards that move between the cameras' pictures explain {fraction:.0%} of the variance of the"
    " corners: {who} not at one instant; start the cameras by one trigger, or hold the board still"
    " for a second in each place"
)


def timing_note(calibration: Calibration) -> str:
    """Note on timing errors, if velocities of the boards explain the residuals of the corners.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    str                             cause and remedy; empty if they do not
    """
    names, sizes = calibration.found.cameras, calibration.found.sizes
    corners = calibration.corners
    late = corners.pixel / np.array(sizes, dtype=np.float64)[corners.camera] - 0.5
    by_column, by_row = (explained_by_velocity(calibration, late[:, k]) for k in range(2))
    fractions = [by_row if by_row - by_column > _MORE else 0.0]
    if len(names) > 1:
        fractions += [
            explained_by_velocity(calibration, (corners.camera == c).astype(np.float64))
            for c in range(len(names))
        ]
    best = int(np.argmax(fractions))
    if not fractions[best] > _MUCH:
        return ""
    who = f"'{names[best - 1]}' and the others take theirs"
    if len(names) == 2:
        who = f"'{names[0]}' and '{names[1]}' take theirs"
    return (_LATE if best else _ROLLS).format(fraction=fractions[best], who=who)


def explained_by_velocity(calibration: Calibration, late: Float[np.ndarray, " m"]) -> float:
    """Fraction of the residual variance of the corners explained by a velocity of each board.

    Parameters
    ----------
    calibration : Calibration
    late : (m,) float               time at which each corner was recorded, in any unit

    Returns
    -------
    float [-]                       relative to the variance left by a pose per view, adjusted for
                                    degrees of freedom; 0 (no more than as many arbitrary terms
                                    would explain) to 1
    """
    adjusted, corners = calibration.adjusted, calibration.corners
    unit = 1.0 / adjusted.noise[corners.camera]
    jacobian = unit[:, None, None] * view_jacobians(adjusted.bundle, corners)
    residual = unit[:, None] * adjusted.residual
    squares, freedom = np.zeros(2), np.zeros(2)
    for view in range(len(adjusted.bundle.view)):
        rows = (corners.view == view) & adjusted.good
        if rows.sum() <= _POSE + _VELOCITY:
            continue
        pose = jacobian[rows].reshape(-1, _POSE)
        moved = (late[rows, None, None] * jacobian[rows, :, -_VELOCITY:]).reshape(-1, _VELOCITY)
        for k, terms in enumerate((pose, np.hstack([pose, moved]))):
            base = _independent(terms)
            remainder = residual[rows].ravel()
            remainder = remainder - base @ (base.T @ remainder)
            squares[k] += remainder @ remainder
            freedom[k] += len(remainder) - base.shape[1]
    if not (freedom > 0.0).all():
        return 0.0
    before, after = squares / freedom
    return float(max(1.0 - after / before, 0.0))


def _independent(terms: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n r"]:
    """Orthonormal basis of the span of all terms. They may be dependent: if one camera alone sees a
    view, its delay is already part of the pose."""
    size = np.linalg.norm(terms, axis=0)
    base, values, _ = np.linalg.svd(terms[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    return base[:, values > 1e-9 * values[0]]
