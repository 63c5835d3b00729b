"""What the readers of calibration files share: units, angles, poses, complaints with the file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from palpate.errors import CalibrationError, InputError
from palpate.records.rig import DISTORTION_TERMS, Camera, Rig
from palpate.records.text import nearest_word
from palpate.shapes import Matrix3, Vector3

METRES_PER_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
# A printed rotation is this far from one at most; `Camera` refuses what is farther.
_PRINTED = 1e-6


def metres_per_unit(path: Path, length_unit: str | None, *, usual: str | None) -> float:
    """Length of the unit of a calibration file.

    Parameters
    ----------
    path : Path
    length_unit : str or None       m, cm, mm or in, as the caller or the file says
    usual : str or None             unit of files of this kind; None: they may be in any

    Returns
    -------
    float [m]

    Raises
    ------
    InputError                      not a known unit
    CalibrationError                nobody knows the unit
    """
    unit = usual if length_unit is None else length_unit
    allowed = ", ".join(METRES_PER_UNIT)
    if unit is None:
        raise CalibrationError(
            f"{path}: does not say the unit of its translations; add the line 'length_unit: mm' to"
            f" the file (allowed: {allowed}): it is the unit that the squares of the calibration"
            " target were given in"
        )
    if unit not in METRES_PER_UNIT:
        near = nearest_word(unit, tuple(METRES_PER_UNIT))
        raise InputError(f"{path}: length_unit is '{unit}'{near} (allowed: {allowed})")
    return METRES_PER_UNIT[unit]


def numbers(
    path: Path, what: str, values: ArrayLike | Sequence[object], shape: tuple[int, ...] | None
) -> np.ndarray:
    """Finite numbers of a calibration file.

    Parameters
    ----------
    path : Path
    what : str                      what they are, for the message
    values : numbers or texts
    shape : tuple of int or None    wanted; a list of as many numbers is brought to it. None: a flat
                                    list of any length

    Returns
    -------
    array of that shape, float

    Raises
    ------
    CalibrationError                not numbers, not finite, another count
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{path}: {what} is {values!r}; must be numbers") from error
    if not np.isfinite(array).all():
        raise CalibrationError(f"{path}: {what} is {array.tolist()}; must be finite")
    if shape is None:
        return array.ravel()
    if array.size != int(np.prod(shape)):
        wanted = " x ".join(str(size) for size in shape)
        raise CalibrationError(f"{path}: {what} has {array.size} numbers; must have {wanted}")
    return array.reshape(shape)


def rotation_from_angles(degrees: Sequence[float] | Vector3) -> Matrix3:
    """Rotation Rz Ry Rx from the angles about x, y and z, as VIC-3D, DICe and MatchID give it.

    Parameters
    ----------
    degrees : 3 floats [deg]        about x (applied first), y, z

    Returns
    -------
    (3, 3) float
    """
    (cx, cy, cz), (sx, sy, sz) = (turn(np.deg2rad(degrees)) for turn in (np.cos, np.sin))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def make_pose(rotation: Matrix3, translation: Vector3) -> Float[np.ndarray, "4 4"]:
    """Rigid motion x -> rotation x + translation; a rotation rounded in print is made exact.

    Parameters
    ----------
    rotation : (3, 3) float         left as it is where it is no rotation: `Camera` will say so
    translation : (3,) float [m]

    Returns
    -------
    (4, 4) float
    """
    if np.abs(rotation @ rotation.T - np.eye(3)).max() <= _PRINTED:
        left, _, right = np.linalg.svd(rotation)
        rotation = left @ right
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def make_camera(
    path: Path,
    name: str,
    *,
    size: tuple[int, int] | None,
    matrix: Matrix3,
    distortion: Sequence[float] | np.ndarray,
    pose: Float[np.ndarray, "4 4"],
) -> Camera:
    """A camera whose complaints name its file.

    Parameters
    ----------
    path, name : Path, str
    size : (columns, rows) [px] or None
    matrix, distortion, pose        as `Camera`; terms beyond the eighth must be zero

    Raises
    ------
    CalibrationError                as `Camera`, or a lens model that is not known
    """
    terms = np.asarray(distortion, dtype=np.float64).ravel()
    known = len(DISTORTION_TERMS)
    if np.any(terms[known:] != 0.0):
        raise CalibrationError(
            f"{path}: camera '{name}' has {terms.size} distortion terms; only the first {known}"
            f" ({' '.join(DISTORTION_TERMS)}) are known, no thin prism and no tilted sensor:"
            " calibrate again without them"
        )
    lens = np.zeros(known)
    lens[: terms.size] = terms[:known]
    try:
        return Camera(name, size, matrix, lens, pose)
    except InputError as error:
        raise CalibrationError(f"{path}: {error}") from error


def make_rig(path: Path, cameras: Sequence[Camera], *, reference: int = 0) -> Rig:
    """The cameras of a file, the first one the reference if nothing else is said."""
    return Rig(tuple(cameras), reference, str(path))
