"""A camera, lens included, from one picture of points whose places are known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from palpate.errors import CalibrationError, InputError
from palpate.records import DISTORTION_TERMS, Camera
from palpate.shapes import Points
from palpate.vision.projection import project

# fx, fy, cx, cy, skew; three of a turn and three of a shift.
_INNER, _OUTER = 5, 6
# Points this flat (thickness over width) leave focal length and distance apart to the noise alone.
_FLATTEST = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Resection:
    """A camera that fits its points, and how well.

    Attributes
    ----------
    camera : Camera
    residual : (n, 2) float [px]    projection minus picture
    """

    camera: Camera
    residual: Float[np.ndarray, "n 2"]


def resected(
    start: Camera,
    points: Points,
    pixels: Float[np.ndarray, "_ 2"],
    *,
    terms: Sequence[str] = ("k1", "k2"),
) -> Resection:
    """Fit a camera to points that are known in space and in its picture.

    Least squares of the distances in the picture over focal lengths, skew, principal point, pose
    and the named terms of the lens. The points must not lie in a plane.

    Parameters
    ----------
    start : Camera                  e.g. from a direct linear transformation; within a few per cent
    points : (n, 3) float [m]       object frame
    pixels : (n, 2) float [px]      column and row
    terms : names                   of the distortion terms to find, of k1 k2 p1 p2 k3 k4 k5 k6; the
                                    others stay as they are

    Returns
    -------
    Resection

    Raises
    ------
    InputError                      an unknown term, too few points, counts that differ
    CalibrationError                points in a plane, or a start that does not see them all
    """
    chosen = _checked(start, points, pixels, terms)

    def residual(change: np.ndarray) -> np.ndarray:
        difference = project(_changed(start, change, chosen), points) - pixels
        # A step that loses points is refused by its cost.
        return np.nan_to_num(difference, nan=1e6).ravel()

    if np.isnan(project(start, points)).any():
        raise CalibrationError(
            f"camera '{start.name}': does not see all points at the start; are points and pixels of"
            " one camera, and the points in the start's object frame?"
        )
    width = float(np.ptp(points, axis=0).max())
    focal = float(start.matrix[0, 0])
    scale = np.concatenate([np.full(4, focal), [0.1 * focal], np.full(3, 0.1), np.full(3, width)])
    scale = np.concatenate([scale, np.full(len(chosen), 0.1)])
    count = _INNER + _OUTER + len(chosen)
    solution = least_squares(
        residual, np.zeros(count), x_scale=0.01 * scale, method="lm", xtol=1e-12, ftol=1e-12
    )
    return Resection(_changed(start, solution.x, chosen), solution.fun.reshape(-1, 2))


def _checked(
    start: Camera, points: Points, pixels: Float[np.ndarray, "_ 2"], terms: Sequence[str]
) -> list[int]:
    """Indices of the distortion terms; refuses what cannot be fitted."""
    unknown = [term for term in terms if term not in DISTORTION_TERMS]
    if unknown:
        raise InputError(f"unknown term '{unknown[0]}'; known are {', '.join(DISTORTION_TERMS)}")
    if len(points) != len(pixels):
        raise InputError(f"{len(points)} points but {len(pixels)} pixels; give one for each")
    count = _INNER + _OUTER + len(terms)
    if 2 * len(points) <= count:
        raise InputError(
            f"{len(points)} points for {count} unknowns; more than {count // 2} are needed"
        )
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[2] <= _FLATTEST * spread[0]:
        raise CalibrationError(
            f"camera '{start.name}': the points lie in a plane; one picture of it does not separate"
            " focal length from distance. Use a calibration object with depth"
        )
    return [DISTORTION_TERMS.index(term) for term in terms]


def _changed(start: Camera, change: np.ndarray, terms: Sequence[int]) -> Camera:
    """The camera after a small change of its unknowns."""
    matrix, distortion = start.matrix.copy(), start.distortion.copy()
    for value, entry in zip(change, ((0, 0), (1, 1), (0, 2), (1, 2), (0, 1)), strict=False):
        matrix[entry] += value
    distortion[list(terms)] += change[_INNER + _OUTER :]
    pose = start.T_camera_object.copy()
    pose[:3, :3] = cv2.Rodrigues(change[_INNER : _INNER + 3])[0] @ pose[:3, :3]
    pose[:3, 3] += change[_INNER + 3 : _INNER + _OUTER]
    return replace(start, matrix=matrix, distortion=distortion, T_camera_object=pose)
