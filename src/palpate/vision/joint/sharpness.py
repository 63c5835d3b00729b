"""Equalising the sharpness of two pictures, one of which is blurred by defocus or motion.

A window that has lost its fine structure still matches, but with an error of a fraction of the blur
width, because stretch and illumination absorb what no motion explains. Blurring by a Gaussian adds
half its variance times the Laplacian to a picture. So regressing the difference of the two pictures
on the Laplacian gives the difference of their blur variances, and the sharper one is blurred by it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Int
from numba import njit

from palpate.threads import in_threads
from palpate.vision.matching.refinement import refine_joint, surface_points
from palpate.vision.matching.scene import Limits, Match, Scene
from palpate.vision.projection import project_kernel
from palpate.vision.range_flow import Outcome
from palpate.vision.spline import SplinePicture, make_spline_picture, sample_kernel

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
_Greys = Sequence[Float[np.ndarray, "_ _"]]
# What gain, offset and shading multiply: 1, the grey level, column and row of a pixel.
_ILLUMINATION = 4


def blur_difference(
    scene: Scene,
    now: _Greys,
    later: Sequence[SplinePicture],
    start: Float[np.ndarray, "n 6 3"],
) -> Float[np.ndarray, " c"]:
    """Blur variance of later pictures minus that of a scene's.

    Parameters
    ----------
    scene : Scene                       of n points in c cameras
    now : sequence of c (rows, columns) float [grey levels]     the later pictures, unprocessed
    later : sequence of c SplinePicture     of these, smoothed like the scene's
    start : (n, 6, 3) float [m]         initial motion; NaN where there is none

    Returns
    -------
    (c,) float [px^2]                   0 where the difference is not significant
    """
    difference = np.zeros(len(now))
    known = np.flatnonzero(np.isfinite(start).all(axis=(1, 2)))
    rows = known[:: max(len(known) // _WINDOWS, 1)]
    if len(rows) < _MIN_WINDOWS:
        return difference
    prepared = scene, later
    for _ in range(_ROUNDS):
        if scene.smoothing < _SMOOTHING:
            prepared = _blurred(scene, now, difference, _SMOOTHING)
        variance, error = _relative_variance(*prepared, rows, start[rows])
        sure = np.abs(variance) > _SIGNIFICANT * error
        if not sure.any():
            break
        difference += np.where(sure, variance, 0.0)
        prepared = _blurred(scene, now, difference, scene.smoothing)
    return difference


def equally_sharp(
    scene: Scene,
    now: _Greys,
    later: tuple[SplinePicture, ...],
    difference: Float[np.ndarray, " c"],
) -> tuple[Scene, tuple[SplinePicture, ...]]:
    """Prepare a scene and later pictures for matching, equally sharp in each camera.

    Parameters
    ----------
    scene, now, later                   as `blur_difference`
    difference : (c,) float [px^2]      the later pictures' blur variance minus that of the scene's

    Returns
    -------
    Scene                               its pictures blurred where the later one is less sharp; its
                                        `smoothing` stays that of the picture that is not blurred,
                                        which has nearly all of the noise
    tuple of c SplinePicture            blurred where the first one is less sharp
    """
    if not difference.any():
        return scene, later
    return _blurred(scene, now, difference, scene.smoothing)


def _blurred(
    scene: Scene, now: _Greys, variance_difference: Float[np.ndarray, " c"], smoothing: float
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
    variance, error = np.zeros(len(later)), np.full(len(later), np.inf)
    for c, picture in enumerate(later):
        variances = _window_variances(scene, picture, rows, match, c)
        if len(variances) >= _MIN_WINDOWS:
            variance[c] = np.median(variances)
            # Standard error of the median, from the interquartile range.
            sigma = np.subtract(*np.quantile(variances, [0.75, 0.25])) / 1.349
            error[c] = 1.2533 * sigma / np.sqrt(len(variances))
    return variance, error


def _window_variances(
    scene: Scene, later: SplinePicture, rows: Int[np.ndarray, " k"], match: Match, camera: int
) -> Float[np.ndarray, " w"]:
    """Relative blur variance in one camera, estimated from each window found [px^2]."""
    valid = np.flatnonzero((match.outcome == Outcome.VALID) & match.cameras[:, camera])
    grey = scene.pictures[camera].grey
    instants = _CameraInstants(
        scene.packed[camera], grey, cv2.Laplacian(grey, cv2.CV_32F), scene.surface[camera],
        scene.interior[camera], later.coefficients,
        # A spline's Laplacian at the pixel centres has the Laplacian of its coefficients.
        cv2.Laplacian(later.coefficients, cv2.CV_32F),
    )  # fmt: skip
    variance = np.empty(len(valid))
    in_threads(
        _window_variances_kernel, len(valid), instants, surface_points(scene, rows[valid]),
        match.motion[valid], scene.subset // 2, variance, min_items=_MIN_WINDOWS,
    )  # fmt: skip
    return variance


class _CameraInstants(NamedTuple):
    """One camera's first picture and a later one.

    Attributes
    ----------
    camera : (25,) float                    `packed_camera`
    grey, laplacian : (rows, columns) float32     of the first picture
    surface : (rows, columns, 3) float32 [m]      point behind each pixel
    interior : (rows, columns) float32      > 0 where a pixel shows only one part of the surface
    later, later_laplacian : (rows + 10, columns + 10) float32     spline coefficients
    """

    camera: np.ndarray
    grey: np.ndarray
    laplacian: np.ndarray
    surface: np.ndarray
    interior: np.ndarray
    later: np.ndarray
    later_laplacian: np.ndarray


@njit(cache=True, nogil=True, error_model="numpy")
def _window_variances_kernel(begin, end, instants, points, motion, half, variance):
    """Later blur variance minus that of the first picture, for the windows from `begin` to `end`.

    Parameters
    ----------
    begin, end : int
    instants : _CameraInstants
    points : SurfacePoints                  of w windows
    motion : (w, 6, 3) float [m]            see `Match`
    half : int [px]                         half the side of a window, rounded down
    variance : (w,) float [px^2]               filled: the later picture regressed on half the
                                            Laplacian, without what illumination explains
    """
    pixels = (2 * half + 1) ** 2
    column, row = np.empty(pixels, dtype=np.float32), np.empty(pixels, dtype=np.float32)
    later, theirs = np.empty(pixels, dtype=np.float32), np.empty(pixels, dtype=np.float32)
    ours = np.empty(pixels)
    basis = np.empty((_ILLUMINATION, pixels))
    for w in range(begin, end):
        count = _load_window(instants, points, w, motion[w], half, column, row, ours, basis)
        sample_kernel(instants.later, column[:count], row[:count], later[:count])
        sample_kernel(instants.later_laplacian, column[:count], row[:count], theirs[:count])
        laplacian, difference = np.empty(count), np.empty(count)
        for p in range(count):
            laplacian[p], difference[p] = 0.5 * (ours[p] + theirs[p]), later[p]
        for a in range(_ILLUMINATION):
            for b in range(a):
                _remove(basis[b, :count], basis[a, :count])
            _remove(basis[a, :count], laplacian)
            _remove(basis[a, :count], difference)
        variance[w] = 2.0 * _product(laplacian, difference) / _product(laplacian, laplacian)


@njit(cache=True, error_model="numpy")
def _load_window(instants, points, w, q, half, column, row, ours, basis):
    """Where the surface points of a window appear later, and the first picture there; how many."""
    camera, point = instants.camera, points.point[w]
    tangent, scale = points.tangent[w], 1.0 / points.half_window[w]
    x, y = project_kernel(camera, point[0], point[1], point[2])
    rows, columns = instants.grey.shape
    count = 0
    for down in range(-half, half + 1):
        for right in range(-half, half + 1):
            i, k = int(np.rint(y)) + down, int(np.rint(x)) + right
            if not (0 <= i < rows and 0 <= k < columns and instants.interior[i, k] > 0.0):
                continue
            shown = instants.surface[i, k]
            xi = eta = 0.0
            for a in range(3):
                xi += (shown[a] - point[a]) * tangent[0, a] * scale
                eta += (shown[a] - point[a]) * tangent[1, a] * scale
            column[count], row[count] = project_kernel(
                camera,
                shown[0] + q[0, 0] + xi * q[1, 0] + eta * q[2, 0],
                shown[1] + q[0, 1] + xi * q[1, 1] + eta * q[2, 1],
                shown[2] + q[0, 2] + xi * q[1, 2] + eta * q[2, 2],
            )
            ours[count] = instants.laplacian[i, k]
            basis[0, count], basis[1, count] = 1.0, instants.grey[i, k]
            basis[2, count], basis[3, count] = right, down
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _product(a, b):
    total = 0.0
    for p in range(len(a)):
        total += a[p] * b[p]
    return total


@njit(cache=True, error_model="numpy")
def _remove(direction, values):
    """Subtract the component along a direction; nothing where that has vanished."""
    square = _product(direction, direction)
    if square > 0.0:
        share = _product(direction, values) / square
        for p in range(len(values)):
            values[p] -= share * direction[p]
