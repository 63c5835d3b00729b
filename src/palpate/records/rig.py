"""Calibrated cameras around the object, and matched points in their pictures; their covariance,
which is in `rig_covariance.npz` in the same folder as `rig.toml`.
"""

import os
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.arrays import LARGEST_NUMBER, fix_fields
from palpate.errors import CalibrationError, InputError
from palpate.files import stored_arrays
from palpate.records.text.text_file import check_file_names
from palpate.shapes import Matrix3, PointScalars, Vector3

DISTORTION_TERMS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_ROTATION_TOLERANCE = 1e-6
# Baselines below this fraction of the farthest camera's distance are rounding errors.
_SAME_POSITION = 1e-6
# Least focal length, as a fraction of the longer side of the picture: 168 degrees across it.
_SHORTEST_FOCAL = 0.05
# Largest ratio of the two focal lengths: 2 with every second row or column left out.
_MOST_UNLIKE = 2.5
# Offset of the principal point from the middle, over the longer side, that may be an exchange.
_NOTED_OFF = 0.05
# A root counts as real if its imaginary part is a smaller fraction of its modulus; numpy's roots
# are accurate to about 1e-12.
_MAX_IMAGINARY = 1e-9
# A denominator below is zero but for rounding.
_ROUNDING = 1e-6
_COVARIANCE_FORMAT = "palpate-rig-covariance/1"
_FILE = "rig_covariance.npz"
# Largest size [bytes]: the covariance of three thousand parameters; four cameras have eighty.
_MAX_BYTES = 2**26
_CURE = "calibrate again, or remove it: then lengths are known as [errors] says"


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A pinhole camera with lens distortion, OpenCV's model; the first pixel's centre is (0, 0).

    Parameters
    ----------
    name : str                      replaces `{camera}` in the patterns of image files; files are
                                    named after it
    size : (columns, rows) or None  of its pictures [px]; None if the calibration does not give it
    matrix : (3, 3) float [px]      [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], fx, fy > 0
    distortion : (8,) float [-]     k1 k2 p1 p2 k3 k4 k5 k6; a shorter list is padded with zeros
    T_camera_object : (4, 4) float [m]  x_camera = T_camera_object x_object, a rigid motion

    Raises
    ------
    CalibrationError                focal lengths or size not positive, more than eight distortion
                                    terms, a pose or matrix not of the form above
    InputError                      wrong shapes, numbers that are not finite
    """

    name: str
    size: tuple[int, int] | None
    matrix: Matrix3
    distortion: Float[np.ndarray, " terms"]
    T_camera_object: Float[np.ndarray, "4 4"]

    def __post_init__(self) -> None:
        given = np.asarray(self.distortion, dtype=np.float64).ravel()
        if given.size > len(DISTORTION_TERMS):
            raise CalibrationError(
                f"camera '{self.name}': distortion has {given.size} terms; at most 8 are known"
                f" ({' '.join(DISTORTION_TERMS)})"
            )
        terms = np.zeros(len(DISTORTION_TERMS))
        terms[: given.size] = given
        object.__setattr__(self, "distortion", terms)
        fix_fields(self, matrix=(3, 3), distortion=(8,), T_camera_object=(4, 4))
        _check_matrix(self.name, self.matrix)
        _check_pose(self.name, self.T_camera_object)
        if self.size is not None and min(self.size) < 1:
            raise CalibrationError(f"camera '{self.name}': size is {self.size}; must be positive")


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Two or more cameras in the object frame.

    Parameters
    ----------
    cameras : tuple of Camera       names distinct
    reference : int                 index of the reference camera, at whose pixels range flow is
                                    evaluated
    source : str                    file they came from, for messages

    Raises
    ------
    CalibrationError                fewer than two cameras, names that files cannot have or that
                                    are not distinct, no such reference
    """

    cameras: tuple[Camera, ...]
    reference: int
    source: str

    def __post_init__(self) -> None:
        names = [camera.name for camera in self.cameras]
        if len(names) < 2:
            raise CalibrationError(
                f"{self.source}: has {len(names)} camera; depth needs at least two"
            )
        check_file_names(names, what=f"{self.source}: camera", kind=CalibrationError)
        if not 0 <= self.reference < len(names):
            raise CalibrationError(
                f"{self.source}: reference is camera {self.reference} of {len(names)}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class RigCovariance:
    """Calibrated camera parameters with their joint covariance.

    Parameters
    ----------
    names : tuple of p str          "CAMERA.TERM": intrinsic terms fx fy cx cy k1 k2 p1 p2 k3 of
                                    every camera; rx ry rz [rad] and tx ty tz [m] of every camera
                                    but the first, for its pose relative to the first
    value : (p,) float              calibrated values; a pose as rotation vector (axis times angle)
                                    and translation from the first camera's frame to its own
    covariance : (p, p) float       of the errors; that of a rotation is a rotation vector applied
                                    after the pose's own rotation
    source : str                    file it came from, for messages

    Raises
    ------
    InputError                      inconsistent shapes, not finite
    CalibrationError                a covariance that is not symmetric, negative variances
    """

    names: tuple[str, ...]
    value: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    source: str

    def __post_init__(self) -> None:
        size = len(self.names)
        fix_fields(self, value=(size,), covariance=(size, size))
        largest = float(np.abs(self.covariance).max(initial=0.0))
        if np.any(np.abs(self.covariance - self.covariance.T) > 1e-9 * largest) or np.any(
            np.diag(self.covariance) < 0.0
        ):
            raise CalibrationError(
                f"{self.source}: the covariance is not symmetric, or a variance is negative;"
                " calibrate again"
            )


def _check_matrix(name: str, matrix: Matrix3) -> None:
    if not (matrix[0, 0] > 0.0 and matrix[1, 1] > 0.0):
        raise CalibrationError(
            f"camera '{name}': focal lengths are {matrix[0, 0]:g} and {matrix[1, 1]:g};"
            " must be positive, in pixels"
        )
    below = (matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2] - 1.0)
    if np.any(np.abs(below) > 1e-9):
        raise CalibrationError(
            f"camera '{name}': K is {matrix.tolist()}; must be [[fx, skew, cx], [0, fy, cy],"
            " [0, 0, 1]]"
        )


def _check_pose(name: str, pose: Float[np.ndarray, "4 4"]) -> None:
    rotation = pose[:3, :3]
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if error > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
        raise CalibrationError(
            f"camera '{name}': R is not a rotation (R R^T is {error:.1g} off the identity,"
            f" determinant {np.linalg.det(rotation):.3g}); give it with more digits, rows x, y, z"
            " of the camera"
        )
    if not np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]):
        raise CalibrationError(f"camera '{name}': last row of the pose must be 0 0 0 1")


def camera_centre(camera: Camera) -> Vector3:
    """Centre of projection of a camera, in the object frame.

    Parameters
    ----------
    camera : Camera

    Returns
    -------
    (3,) float [m]
    """
    pose = camera.T_camera_object
    return -pose[:3, :3].T @ pose[:3, 3]


def lens_radius_limit(distortion: Float[np.ndarray, "8"]) -> float:
    """Radius in the plane z = 1 up to which the radial distortion is invertible.

    Parameters
    ----------
    distortion : (8,) float [-]     k1 k2 p1 p2 k3 k4 k5 k6

    Returns
    -------
    float [-]                       smallest r > 0 where r radial(r^2) stops increasing or has a
                                    pole; infinite where it always increases
    """
    # Roots of polynomials whose leading term is a denormal overflow.
    terms = np.where(np.abs(distortion) < 1.0 / LARGEST_NUMBER, 0.0, distortion)
    k1, k2, _, _, k3, k4, k5, k6 = (float(term) for term in terms)
    if not any((k1, k2, k3, k4, k5, k6)):
        return float("inf")
    over, under = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
    # With u = r^2 the slope of r over / under is this polynomial, over under^2.
    u = np.poly1d([1.0, 0.0])
    slope = over * under + 2.0 * u * (over.deriv() * under - over * under.deriv())
    roots = np.concatenate([slope.roots, under.roots])
    real = roots.real[np.abs(roots.imag) <= _MAX_IMAGINARY * np.abs(roots)]
    positive = real[real > 0.0]
    return float(np.sqrt(positive.min())) if len(positive) else float("inf")


def check_cameras(rig: Rig) -> None:
    """Refuse cameras whose matrix or lens no camera has: another unit, or numbers exchanged.

    Parameters
    ----------
    rig : Rig

    Raises
    ------
    CalibrationError                the text names file, camera and key
    """
    for camera in rig.cameras:
        if fault := _matrix_fault(camera) or _lens_fault(camera):
            raise CalibrationError(f"{rig.source}: camera '{camera.name}' {fault}")


def _matrix_fault(camera: Camera) -> str:
    """What is impossible in a camera's matrix; empty if nothing is."""
    focal, middle = np.diag(camera.matrix)[:2], camera.matrix[:2, 2]
    least = 1.0 if camera.size is None else _SHORTEST_FOCAL * max(camera.size)
    if focal.min() < least:
        return (
            f"K: its focal lengths are {focal[0]:g} and {focal[1]:g}; must be {least:g} px or more:"
            " in pixels, the lens's focal length over the side of a pixel"
        )
    if focal.max() > _MOST_UNLIKE * focal.min():
        return (
            f"K: fx is {focal[0]:g} and fy is {focal[1]:g} px; pixels are nearly square, so they"
            f" must agree to a factor of {_MOST_UNLIKE:g}: correct the wrong one"
        )
    if camera.size is None:
        return ""
    half = 0.5 * (np.array(camera.size) - 1.0)
    off, exchanged = (float(abs(point - half).max()) for point in (middle, middle[::-1]))
    if off > _NOTED_OFF * max(camera.size) and exchanged < 0.25 * off:
        return (
            f"K: its principal point is ({middle[0]:g}, {middle[1]:g}) px in a picture of"
            f" {camera.size[0]} x {camera.size[1]}, with cx and cy exchanged it would be at the"
            " middle; write cx, then cy"
        )
    return ""


def _lens_fault(camera: Camera) -> str:
    """What is impossible in a lens model within its picture; empty if nothing is."""
    limit = lens_radius_limit(camera.distortion)
    if camera.size is None or not np.isfinite(limit):
        return ""
    k1, k2, _, _, k3, k4, k5, k6 = camera.distortion.tolist()
    u = limit**2
    over, under = 1.0 + u * (k1 + u * (k2 + u * k3)), 1.0 + u * (k4 + u * (k5 + u * k6))
    # Radius of the circle within the picture, in the plane z = 1.
    focal = np.diag(camera.matrix)[:2]
    inner = 0.5 * float((np.array(camera.size) / focal).min())
    cure = "; check the order k1 k2 p1 p2 k3 k4 k5 k6, or calibrate again with fewer terms"
    if abs(under) < _ROUNDING:
        if limit >= inner:
            return ""
        return (
            "distortion: its denominator 1 + k4 r^2 + k5 r^4 + k6 r^6 vanishes"
            f" {limit * focal[0]:.0f} px off the principal point, within the picture{cure}"
        )
    folded = limit * abs(over / under)
    if folded < inner:
        return (
            f"distortion: it folds the picture over {folded * focal[0]:.0f} px off the principal"
            f" point, beyond which no ray reaches a pixel{cure}"
        )
    return ""


def check_baselines(rig: Rig) -> None:
    """Refuse two cameras at the same position: without a baseline the pair gives no depth.

    Parameters
    ----------
    rig : Rig

    Raises
    ------
    CalibrationError                the text names both cameras
    """
    centre = np.array([camera_centre(camera) for camera in rig.cameras])
    tolerance = _SAME_POSITION * np.linalg.norm(centre, axis=1).max()
    for (i, first), (k, second) in combinations(enumerate(rig.cameras), 2):
        if np.linalg.norm(centre[i] - centre[k]) <= tolerance:
            position = ", ".join(f"{x:.4g}" for x in centre[i])
            raise CalibrationError(
                f"{rig.source}: cameras '{first.name}' and '{second.name}' stand at the same place,"
                f" ({position}) m: together they show no depth; correct R and t, or leave one of"
                " them out"
            )


def picture_size(camera: Camera) -> tuple[int, int]:
    """Columns and rows of a camera's pictures.

    Parameters
    ----------
    camera : Camera

    Returns
    -------
    (int, int) [px]

    Raises
    ------
    InputError                      the camera has no size
    """
    if camera.size is None:
        raise InputError(
            f"camera '{camera.name}' has no size; give the columns and rows of its pictures"
        )
    return camera.size


@dataclass(frozen=True, slots=True, eq=False)
class PictureTracks:
    """Image positions of the same points in several cameras, at rest and loaded, in pixels.

    Parameters
    ----------
    rest, loaded : (c, n, 2) float [px]     column, row; the first pixel's centre is (0, 0); NaN
                                    where a point was not found
    cameras : tuple of str          names of the c cameras, if the program gives them
    score : (n,) float or None      zero-mean normalised cross-correlation of each point's worst
                                    match
    notes : tuple of str            what was assumed, in sentences about the file
    """

    rest: Float[np.ndarray, "c n 2"]
    loaded: Float[np.ndarray, "c n 2"]
    cameras: tuple[str, ...]
    score: PointScalars | None
    notes: tuple[str, ...]


def covariance_file(rig: Path) -> Path | None:
    """File with the covariance of a rig, in the same folder as the rig.

    Parameters
    ----------
    rig : Path                      the rig's file, or its folder

    Returns
    -------
    Path or None                    None if there is none; the file is not checked
    """
    path = (rig if rig.is_dir() else rig.parent) / _FILE
    return path if os.path.lexists(path) else None


def write_rig_covariance(
    folder: Path, known: RigCovariance, corner_noise: Float[np.ndarray, " c"] | None = None
) -> None:
    """Write `rig_covariance.npz`.

    Parameters
    ----------
    folder : Path                   an existing folder
    known : RigCovariance
    corner_noise : (c,) float [px] or None  standard deviation of a corner coordinate, per camera
    """
    content: dict[str, Any] = {
        "format": np.array(_COVARIANCE_FORMAT),
        "names": np.array(known.names),
        "value": known.value,
        "covariance": known.covariance,
    }
    if corner_noise is not None:
        content["corner_noise"] = corner_noise
    np.savez_compressed(folder / _FILE, **content)


def read_rig_covariance(path: Path) -> RigCovariance:
    """Read a `rig_covariance.npz`.

    Parameters
    ----------
    path : Path

    Returns
    -------
    RigCovariance

    Raises
    ------
    RecordError                     missing, not readable, damaged, too large, of another format
    CalibrationError                as in `RigCovariance`
    """
    what = "cannot be read as the covariance of a rig"
    with stored_arrays(path, _CURE, what=what, max_bytes=_MAX_BYTES) as stored:
        file_format = str(stored["format"])
        if file_format != _COVARIANCE_FORMAT:
            raise ValueError(f"its format is {file_format!r}, not '{_COVARIANCE_FORMAT}'")
        names = tuple(map(str, stored["names"].tolist()))
        return RigCovariance(names, stored["value"], stored["covariance"], str(path))
