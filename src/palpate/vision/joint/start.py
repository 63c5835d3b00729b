"""Where the points of a scene may be found in the next pictures, from whole pictures."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float

from palpate.vision.cameras import triangulate
from palpate.vision.joint.scene import Scene, pixels
from palpate.vision.matching import Scatter, dense_start, local_field

# The dense start is good to about half a pixel; cameras that contradict each other by more than
# four times that were misled.
_START_ERROR = 0.5
_CONTRADICTION = 2.0
# The field that carries starts over gaps is smoothed over so many half windows.
_SMOOTHING = 3.0


def flow_start(
    scene: Scene,
    motion: Float[np.ndarray, "n 6 3"],
    before: Sequence[Float[np.ndarray, "_ _"]],
    now: Sequence[Float[np.ndarray, "_ _"]],
) -> Float[np.ndarray, "n 6 3"]:
    """Motion of every point from the first instant to now, good to a pixel or so.

    Parameters
    ----------
    scene : Scene
    motion : (n, 6, 3) float [m]    from the first instant to `before`; NaN where not known
    before, now : sequences of c (rows, columns) float [grey levels]

    Returns
    -------
    (n, 6, 3) float [m]             NaN where nothing around is known either
    """
    if len(scene.point) == 0:
        return motion
    was = scene.point + motion[:, 0]
    old = pixels(scene.rig, np.where(np.isfinite(was), was, scene.point))
    target = np.full(old.shape, np.nan)
    for c, (first, second) in enumerate(zip(before, now, strict=True)):
        start = dense_start(np.asarray(first), np.asarray(second))
        at = old[c].astype(np.float32)[None]
        step = cv2.remap(start.flow, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
        sure = cv2.remap(start.trusted.astype(np.float32), at, None, cv2.INTER_LINEAR)[0]
        known = scene.seen[:, c] & np.isfinite(was).all(axis=1) & (sure > 0.5)
        target[c, known] = old[c, known] + step[known]
    found = triangulate(scene.rig, target, _START_ERROR)
    good = (found.cameras >= 2) & (found.residual < _CONTRADICTION)
    return _smooth(scene, found.point - scene.point, found.covariance, good)


def _smooth(
    scene: Scene,
    displacement: Float[np.ndarray, "n 3"],
    covariance: Float[np.ndarray, "n 3 3"],
    good: np.ndarray,
) -> Float[np.ndarray, "n 6 3"]:
    """The start with its gradient, from a local plane through what is known around."""
    result = np.full((len(displacement), 6, 3), np.nan)
    if not good.any():
        return result
    reach = _SMOOTHING * float(np.median(scene.extent))
    spread = covariance[good]
    scatter = Scatter(
        scene.point[good], scene.pixel[good], displacement[good], spread, 0.0 * spread, 1
    )
    field = local_field(scatter, scene.point, scene.tangent, reach=reach, order=1)
    result[:, 0] = field.displacement
    result[:, 1:3] = field.gradient * scene.extent[:, None, None]
    result[:, 3:] = np.where(
        np.isfinite(field.displacement).all(axis=1)[:, None, None], 0.0, np.nan
    )
    return result
