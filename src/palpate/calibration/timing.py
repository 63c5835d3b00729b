"""Whether boards moved while cameras took them: a shutter that rolls, or no common instant.

Nobody needs to tell how a board moved. What the adjustment leaves of a view is compared with what a
velocity of its board would leave: where rows are read one after another, each row is shifted by the
time at which it is read; where a camera is late, all of its corners are.
"""

import numpy as np
from jaxtyping import Float

from palpate.calibration.adjustment import view_slopes
from palpate.calibration.calibrate import Calibration

# Velocities explain so much of the variance that is left, their number taken into account; and by
# rows so much more than by columns: what a bent board leaves they follow, too, by both alike.
_MUCH, _MORE = 0.3, 0.1
_POSE, _VELOCITY = 6, 3
_ROLLS = (
    "boards that move while rows are read one after another explain {share:.0%} of the variance of"
    " the corners: a shutter rolls; hold the board still for a second in each place"
)
_LATE = (
    "boards that move between the cameras' pictures explain {share:.0%} of the variance of the"
    " corners: {who} not at one instant; start the cameras by one trigger, or hold the board still"
    " for a second in each place"
)


def timing_note(calibration: Calibration) -> str:
    """Whether velocities of the boards explain what is left of the corners.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    str                             empty where they do not; else the cause and the cure
    """
    names, sizes = calibration.found.cameras, calibration.found.sizes
    corners = calibration.corners
    late = corners.pixel / np.array(sizes, dtype=np.float64)[corners.camera] - 0.5
    by_column, by_row = (explained_by_velocity(calibration, late[:, k]) for k in range(2))
    shares = [by_row if by_row - by_column > _MORE else 0.0]
    if len(names) > 1:
        shares += [
            explained_by_velocity(calibration, (corners.camera == c).astype(np.float64))
            for c in range(len(names))
        ]
    best = int(np.argmax(shares))
    if not shares[best] > _MUCH:
        return ""
    who = f"'{names[best - 1]}' and the others take theirs"
    if len(names) == 2:
        who = f"'{names[0]}' and '{names[1]}' take theirs"
    return (_LATE if best else _ROLLS).format(share=shares[best], who=who)


def explained_by_velocity(calibration: Calibration, late: Float[np.ndarray, " m"]) -> float:
    """Share of the variance of the corners that a velocity of every view's board takes away.

    Parameters
    ----------
    calibration : Calibration
    late : (m,) float               when each corner was seen, in any unit

    Returns
    -------
    float                           of the variance left by a pose a view, 0 where velocities take
                                    away no more than as many other numbers would; at most 1
    """
    adjusted, corners = calibration.adjusted, calibration.corners
    unit = 1.0 / adjusted.noise[corners.camera]
    slope = unit[:, None, None] * view_slopes(adjusted.bundle, corners)
    residual = unit[:, None] * adjusted.residual
    squares, freedom = np.zeros(2), np.zeros(2)
    for view in range(len(adjusted.bundle.view)):
        rows = (corners.view == view) & adjusted.good
        if rows.sum() <= _POSE + _VELOCITY:
            continue
        pose = slope[rows].reshape(-1, _POSE)
        moved = (late[rows, None, None] * slope[rows, :, -_VELOCITY:]).reshape(-1, _VELOCITY)
        for k, terms in enumerate((pose, np.hstack([pose, moved]))):
            base = _independent(terms)
            left = residual[rows].ravel()
            left = left - base @ (base.T @ left)
            squares[k] += left @ left
            freedom[k] += len(left) - base.shape[1]
    if not (freedom > 0.0).all():
        return 0.0
    before, after = squares / freedom
    return float(max(1.0 - after / before, 0.0))


def _independent(terms: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n r"]:
    """Orthogonal columns that span all terms; what a camera that alone sees a view is late by is
    part of the pose already."""
    size = np.linalg.norm(terms, axis=0)
    base, values, _ = np.linalg.svd(terms[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    return base[:, values > 1e-9 * values[0]]
