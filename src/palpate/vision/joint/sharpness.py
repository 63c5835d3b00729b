"""Equalising the sharpness of two pictures, one of which is blurred by defocus or motion.

A window that has lost its fine structure still matches, but with an error of a fraction of the blur
width, because stretch and illumination absorb what no motion explains. Blurring by a Gaussian adds
half its variance times the Laplacian to a picture. So regressing the difference of the two pictures
on the Laplacian gives the difference of their blur variances, and the sharper one is blurred by it.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, Int

from palpate.threads import in_threads
from palpate.vision.images.spline import SplinePicture, make_spline_picture, spline_pictures
from palpate.vision.joint.window_blur import CameraInstants, MovedWindows, window_variances_kernel
from palpate.vision.range_flow.flow import Outcome
from palpate.vision.refinement.refinement import refine_joint
from palpate.vision.refinement.scene import Scene
from palpate.vision.refinement.window_match import Limits, Match

# Number of windows used: enough for the blur to 0.1 px, few compared with those of the flow.
_WINDOWS = 100
# Fewer windows do not represent the whole picture.
_MIN_WINDOWS = 8
# Iterations on the remaining difference: a picture is not linear in a wide blur.
_ROUNDS = 6
# A difference of variances is applied if it exceeds this many of its standard errors.
_SIGNIFICANT = 4.0
# Smoothing of the pictures whose Laplacian is taken, against noise [px].
_SMOOTHING = 1.0

Greys = Sequence[Float[np.ndarray, "_ _"]]


def equally_sharp(
    scene: Scene, now: Greys, start: Float[np.ndarray, "n 6 3"]
) -> tuple[Scene, tuple[SplinePicture, ...]]:
    """Prepare a scene and the later pictures for matching, equally sharp in each camera.

    Parameters
    ----------
    scene : Scene                       of n points in c cameras
    now : sequence of c (rows, columns) float [grey levels]     the later pictures, unprocessed
    start : (n, 6, 3) float [m]         initial motion; NaN where there is none

    Returns
    -------
    Scene                               its pictures blurred where the later one is less sharp; its
                                        `smoothing` stays that of the picture that is not blurred,
                                        which has nearly all of the noise
    tuple of c SplinePicture            smoothed like the scene's; blurred where the first one is
                                        less sharp
    """
    variance_difference = np.zeros(len(now))
    there, later = scene, spline_pictures(now, scene.smoothing)
    known = np.flatnonzero(np.isfinite(start).all(axis=(1, 2)))
    rows = known[:: max(len(known) // _WINDOWS, 1)]
    if len(rows) < _MIN_WINDOWS:
        return there, later
    for _ in range(_ROUNDS):
        seen = there, later
        if scene.smoothing < _SMOOTHING:
            seen = _blurred(scene, now, variance_difference, _SMOOTHING)
        found, error = _relative_variance(*seen, rows, start[rows])
        sure = np.abs(found) > _SIGNIFICANT * error
        if not sure.any():
            break
        variance_difference += np.where(sure, found, 0.0)
        there, later = _blurred(scene, now, variance_difference, scene.smoothing)
    return there, later


def _blurred(
    scene: Scene, now: Greys, variance_difference: Float[np.ndarray, " c"], smoothing: float
) -> tuple[Scene, tuple[SplinePicture, ...]]:
    """Both instants' pictures, smoothed; `variance_difference` [px^2] is extra blur variance for
    the first where positive, for the later where negative."""
    first, later = (
        tuple(
            make_spline_picture(grey, smoothing=float(np.sqrt(smoothing**2 + max(more, 0.0))))
            for grey, more in zip(pictures, sign * variance_difference, strict=True)
        )
        for pictures, sign in ((scene.grey, 1.0), (now, -1.0))
    )
    blur_variance = (
        scene.blur_variance
        + smoothing**2
        - scene.smoothing**2
        + np.maximum(variance_difference, 0.0)
    )
    return replace(scene, pictures=first, blur_variance=blur_variance), later


def _relative_variance(
    scene: Scene,
    later: Sequence[SplinePicture],
    rows: Int[np.ndarray, " k"],
    start: Float[np.ndarray, "k 6 3"],
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Blur variance of the later pictures minus that of the first ones, and its standard error
    [px^2]; the error is infinite where too few windows are found."""
    limits = Limits(scene.subset // 2)
    noise = np.ones(len(later))
    match = refine_joint(scene, rows, later, start, scene.seen[rows], noise, limits)
    found, error = np.zeros(len(later)), np.full(len(later), np.inf)
    for c, picture in enumerate(later):
        each = _window_variances(scene, picture, rows, match, c)
        if len(each) >= _MIN_WINDOWS:
            found[c] = np.median(each)
            # Standard error of the median, from the interquartile range.
            sigma = np.subtract(*np.quantile(each, [0.75, 0.25])) / 1.349
            error[c] = 1.2533 * sigma / np.sqrt(len(each))
    return found, error


def _window_variances(
    scene: Scene, later: SplinePicture, rows: Int[np.ndarray, " k"], match: Match, camera: int
) -> Float[np.ndarray, " w"]:
    """Relative blur variance in one camera, estimated from each window found [px^2]."""
    kept = np.flatnonzero((match.outcome == Outcome.VALID) & match.cameras[:, camera])
    grey, chosen = scene.pictures[camera].grey, rows[kept]
    instants = CameraInstants(
        scene.packed[camera], grey, cv2.Laplacian(grey, cv2.CV_32F), scene.surface[camera],
        scene.interior[camera], later.coefficients,
        # A spline's Laplacian at the pixel centres has the Laplacian of its coefficients.
        cv2.Laplacian(later.coefficients, cv2.CV_32F),
    )  # fmt: skip
    windows = MovedWindows(
        scene.point[chosen], scene.tangent[chosen], scene.half_window[chosen], match.motion[kept]
    )
    found = np.empty(len(kept))
    in_threads(
        window_variances_kernel, len(kept), instants, windows, scene.subset // 2, found,
        min_items=_MIN_WINDOWS,
    )  # fmt: skip
    return found
