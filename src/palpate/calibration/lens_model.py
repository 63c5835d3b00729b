"""Camera model with lens distortion, and its derivatives with respect to all parameters."""

import numpy as np
from jaxtyping import Float

from palpate.shapes import Points

# OpenCV's model with five distortion terms; focal lengths and principal point in pixels.
LENS_TERMS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


def seen_points(
    intrinsics: Float[np.ndarray, "n 9"], points: Points
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 9"], Float[np.ndarray, "n 2 3"]]:
    """Project points, with derivatives with respect to lens terms and points.

    Parameters
    ----------
    intrinsics : (n, 9) float       `LENS_TERMS` of the camera that sees each point
    points : (n, 3) float [m]       frame of that camera, in front of it

    Returns
    -------
    pixel : (n, 2) float [px]
    by_intrinsics : (n, 2, 9) float  derivative with respect to `LENS_TERMS`
    by_point : (n, 2, 3) float [px/m]   derivative with respect to the point

    Source
    ------
    OpenCV, Camera calibration and 3D reconstruction, detailed description.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics.T
    x, y = (points[:, :2] / points[:, 2:]).T
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    one, zero = np.ones_like(x), np.zeros_like(x)
    bent = np.stack([r2, r2 * r2, r2**3])
    along_x = [xd, zero, one, zero, *(fx * x * bent[:2]), 2.0 * fx * x * y,
               fx * (r2 + 2.0 * x * x), fx * x * bent[2]]  # fmt: skip
    along_y = [zero, yd, zero, one, *(fy * y * bent[:2]), fy * (r2 + 2.0 * y * y),
               2.0 * fy * x * y, fy * y * bent[2]]  # fmt: skip
    by_intrinsics = np.stack([np.stack(along_x, axis=-1), np.stack(along_y, axis=-1)], axis=1)
    xx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    yy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    lens = np.stack([np.stack([fx * xx, fx * xy], -1), np.stack([fy * xy, fy * yy], -1)], axis=1)
    pinhole = np.stack([np.stack([one, zero, -x], -1), np.stack([zero, one, -y], -1)], axis=1)
    by_point = lens @ pinhole / points[:, 2, None, None]
    return np.stack([fx * xd + cx, fy * yd + cy], axis=1), by_intrinsics, by_point
