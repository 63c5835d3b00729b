"""Consistency check of a rig with its pictures, by feature matches between cameras.

The match of a feature must lie on its epipolar line, and the triangulated point in front of both
cameras. Otherwise, other assignments of pictures to cameras are tried.
"""

from itertools import combinations, permutations

import cv2
import numpy as np
from jaxtyping import Float

from palpate.errors import CalibrationError, InputError
from palpate.records import Camera, Rig
from palpate.shapes import Matrix3, PointScalars
from palpate.vision.matching.features import PreparedPictures, Samples, match_features
from palpate.vision.projection import normalised
from palpate.vision.triangulation import triangulate

# Half a speckle: with larger epipolar errors, windows around one point show different speckles.
_MAX_RESIDUAL_PX = 2.0
# The rig is rejected only for errors of several times those of the features themselves.
_MAX_RESIDUAL_NOISE = 4.0
# Errors above this, ten times that of a window match, give a note.
_NOTED_RESIDUAL_PX = 0.5
# Fewer feature matches may be due to chance.
_MIN_MATCHES = 12
# With more cameras there are too many permutations to try.
_MAX_REORDERED_CAMERAS = 4

_Pairs = dict[tuple[int, int], Samples]


def check_rig(
    pictures: PreparedPictures,
) -> tuple[tuple[float, ...], tuple[int, ...], tuple[str, ...]]:
    """Check the rig against the pictures of one instant.

    Parameters
    ----------
    pictures : PreparedPictures     of c cameras

    Returns
    -------
    residual : tuple of float [px]  median distance of features from their epipolar lines, for each
                                    camera except the reference; NaN with too few matches
    matches : tuple of int          number of feature matches behind each residual
    notes : tuple of str            what could not be checked, or fits badly

    Raises
    ------
    CalibrationError                features lie more than two pixels off their epipolar lines, or
                                    behind the cameras; the message says whether swapped pictures
                                    explain it
    InputError                      a picture has no texture
    """
    rig = pictures.rig
    pairs = _all_matches(pictures)
    order = tuple(range(len(rig.cameras)))
    residual, count, notes = [], [], []
    worst, whose = 0.0, ""
    for c in order:
        if c == rig.reference:
            continue
        pair = (rig.reference, c)
        names = " and ".join(f"'{rig.cameras[k].name}'" for k in pair)
        count.append(len(pairs[pair].point))
        if count[-1] < _MIN_MATCHES:
            residual.append(float("nan"))
            notes.append(
                f"the pictures of cameras {names} have only {count[-1]} features in common; the"
                " rig could not be checked with them"
            )
            continue
        residual.append(_misfit(rig, order, pairs, pair))
        limit = max(_MAX_RESIDUAL_PX, _MAX_RESIDUAL_NOISE * _feature_error(rig, pairs, pair))
        if residual[-1] > limit:
            worst, whose = max((worst, whose), (residual[-1], names))
        elif residual[-1] > _NOTED_RESIDUAL_PX:
            notes.append(
                f"the rig fits the pictures of cameras {names} to {residual[-1]:.1f} px only:"
                " depths are off by a part of that"
            )
    if worst > 0.0:
        raise CalibrationError(_explanation(rig, pairs, worst, whose))
    return tuple(residual), tuple(count), tuple(notes)


def _all_matches(pictures: PreparedPictures) -> _Pairs:
    """Feature matches of every pair of pictures, in both orders."""
    cameras = pictures.rig.cameras
    for camera, picture, features in zip(cameras, pictures.grey, pictures.features, strict=True):
        if len(features.point) == 0:
            raise InputError(
                f"the picture of camera '{camera.name}' shows no texture (grey levels"
                f" {picture.min():.0f} to {picture.max():.0f}); nothing can be followed in it."
                " Speckles need three times the contrast of the noise: paint, light, focus"
            )
    pairs = {}
    for i, j in combinations(range(len(cameras)), 2):
        matches = match_features(pictures.features[i], pictures.features[j])
        consistent = _consistent(cameras[i], cameras[j], matches)
        pairs[i, j], pairs[j, i] = consistent, consistent.reversed()
    return pairs


def _consistent(first: Camera, second: Camera, matches: Samples) -> Samples:
    """The matches consistent with a common epipolar geometry of any kind; none if most are not.

    Any seven matches fit some epipolar geometry, but few further random ones do.
    """
    flat = [_undistorted(first, matches.point), _undistorted(second, matches.moved)]
    known = np.flatnonzero(np.isfinite(np.hstack(flat)).all(axis=1))
    nothing = matches.chosen(known[:0])
    if len(known) < _MIN_MATCHES:
        return nothing
    a, b = (pixels[known] for pixels in flat)
    _, inlier = cv2.findFundamentalMat(a, b, cv2.FM_RANSAC, _MAX_RESIDUAL_PX, 0.999)
    if inlier is None or inlier.sum() - 7 < 0.5 * (len(known) - 7):
        return nothing
    return matches.chosen(known[inlier.ravel() > 0])


def _undistorted(camera: Camera, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Undistorted pixels relative to the principal point [px]."""
    return normalised(camera, pixels) * camera.matrix[0, 0]


def _misfit(rig: Rig, order: tuple[int, ...], pairs: _Pairs, pair: tuple[int, int]) -> float:
    """Median distance of features from their epipolar lines [px]; infinite if most lie behind.

    `order[k]` is the camera that picture k is assigned to.
    """
    chosen = pairs[pair]
    first, second = (rig.cameras[order[k]] for k in pair)
    distance = _epipolar_distance(first, second, chosen)
    known = np.isfinite(distance)
    if known.sum() < _MIN_MATCHES:
        return float("inf")
    pixels = np.stack([chosen.point[known], chosen.moved[known]])
    in_front = np.isfinite(triangulate(Rig((first, second), 0, rig.source), pixels, 1.0).residual)
    return float(np.median(distance[known])) if in_front.mean() > 0.5 else float("inf")


def _epipolar_distance(first: Camera, second: Camera, matches: Samples) -> PointScalars:
    """Distance of matches from each other's epipolar lines, mean over the two pictures [px]."""
    a, b = normalised(first, matches.point), normalised(second, matches.moved)
    between = second.T_camera_object @ np.linalg.inv(first.T_camera_object)
    x, y, z = between[:3, 3]
    essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ between[:3, :3]
    in_b = _line_distance(a, b, essential) * second.matrix[0, 0]
    in_a = _line_distance(b, a, essential.T) * first.matrix[0, 0]
    return 0.5 * (in_a + in_b)


def _line_distance(
    a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"], matrix: Matrix3
) -> PointScalars:
    """Distance of `b` from the epipolar lines of `a` by a fundamental matrix, in their unit."""
    line = np.column_stack([a, np.ones(len(a))]) @ matrix.T
    residual = np.abs((b * line[:, :2]).sum(axis=1) + line[:, 2])
    return residual / np.maximum(np.hypot(line[:, 0], line[:, 1]), 1e-12)


def _feature_error(rig: Rig, pairs: _Pairs, pair: tuple[int, int]) -> float:
    """Median distance from the epipolar lines of the geometry that fits the features best [px]."""
    chosen = pairs[pair]
    a, b = (
        _undistorted(rig.cameras[k], pixels)
        for k, pixels in zip(pair, (chosen.point, chosen.moved), strict=True)
    )
    matrix, _ = cv2.findFundamentalMat(a, b, cv2.FM_LMEDS)
    if matrix is None or matrix.shape != (3, 3):
        return 0.0
    return float(np.median(_line_distance(a, b, matrix)))


def _explanation(rig: Rig, pairs: _Pairs, worst: float, whose: str) -> str:
    """Message that the rig does not fit, naming pictures that seem to be swapped."""
    what = (
        f"features lie {worst:.1f} px off their epipolar lines"
        if np.isfinite(worst)
        else "features that two pictures share lie behind the cameras"
    )
    order = _better_order(rig, pairs)
    if order is None:
        return (
            f"{rig.source}: cameras {whose}: {what}, and no other order of the pictures makes it"
            " better; is this the calibration of these pictures (K, distortion, R and t), was a"
            " camera moved since, are the pictures cropped, scaled or turned?"
        )
    names = [camera.name for camera in rig.cameras]
    moved = [k for k in range(len(names)) if order[k] != k]
    if len(moved) == 2:
        swap = f"the pictures of '{names[moved[0]]}' and '{names[moved[1]]}' look swapped"
    else:
        swap = "the pictures look permuted: " + ", ".join(
            f"that of '{names[k]}' shows what '{names[order[k]]}' sees" for k in moved
        )
    return (
        f"{rig.source}: cameras {whose}: {what}; {swap}. Rename the files, or the cameras in the"
        " rig"
    )


def _better_order(rig: Rig, pairs: _Pairs) -> tuple[int, ...] | None:
    """Permutation of cameras under which the pictures fit; None if there is none."""
    count = len(rig.cameras)
    if count > _MAX_REORDERED_CAMERAS:
        return None
    known = [
        pair for pair in combinations(range(count), 2) if len(pairs[pair].point) >= _MIN_MATCHES
    ]
    best: tuple[float, tuple[int, ...]] = (_MAX_RESIDUAL_PX, ())
    for order in permutations(range(count)):
        if order == tuple(range(count)):
            continue
        best = min(best, (max(_misfit(rig, order, pairs, pair) for pair in known), order))
    return best[1] or None
