"""A smooth displacement field in a picture, with its gradient, from scattered displacements."""

import numpy as np
from jaxtyping import Float

from palpate.shapes import Flags
from palpate.vision.matching.local_regression import Scatter, local_field

# Radius of the displacements that have a say, in half windows.
_REACH = 3.0


def planar_field(
    pixel: Float[np.ndarray, "n 2"],
    displacement: Float[np.ndarray, "n 2"],
    good: Flags,
    subset: int,
    *,
    covariance: Float[np.ndarray, "n 2 2"] | None = None,
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"]]:
    """Displacement and gradient at every point, from a plane through the good ones around it.

    Parameters
    ----------
    pixel : (n, 2) float [px]
    displacement : (n, 2) float [px]    used where good
    good : (n,) bool
    subset : int [px]                   side of the windows; its half is the unit of the reach
    covariance : (n, 2, 2) float [px^2] all alike unless given

    Returns
    -------
    value : (n, 2) float [px]           NaN where nothing is around
    gradient : (n, 2, 2) float [-]      [i, j]: of component i by coordinate j
    """
    if covariance is None:
        covariance = np.broadcast_to(0.25 * np.eye(2), (len(pixel), 2, 2))
    flat = np.pad(pixel, ((0, 0), (0, 1)))
    spread = np.pad(covariance[good], ((0, 0), (0, 1), (0, 1)))
    scatter = Scatter(
        flat[good],
        pixel[good],
        np.pad(displacement[good], ((0, 0), (0, 1))),
        spread,
        0.0 * spread,
        subset,
    )
    tangent = np.broadcast_to(np.eye(3)[:2], (len(pixel), 2, 3))
    field = local_field(scatter, flat, tangent, reach=_REACH * (subset // 2), order=1)
    return field.displacement[:, :2], np.swapaxes(field.gradient[:, :, :2], 1, 2)
