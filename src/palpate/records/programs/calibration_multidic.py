"""Cameras from the direct linear transformations of MultiDIC (DLTstruct_cam_*.mat).

column = (L1 X + L2 Y + L3 Z + L4) / (L9 X + L10 Y + L11 Z + 1), row with L5 to L8, X in mm, pixels
counted from 1 as in MATLAB. Eleven numbers, as many as a pinhole camera with skew has: nothing is
lost, but there is no lens.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import rq

from palpate.errors import CalibrationError, RecordError
from palpate.optional_imports import late_import
from palpate.records.programs.calibration_parts import (
    make_camera,
    make_pose,
    make_rig,
    metres_per_unit,
    numbers,
)
from palpate.records.rig import Camera, Rig
from palpate.shapes import Points

_PATTERN = "DLTstruct_cam_*.mat"
_PAIRS_HINT = f"give the folder with its files {_PATTERN}, or one of them"


@dataclass(frozen=True, slots=True, eq=False)
class ControlPoints:
    """Points of a calibration object and where one camera sees them.

    Attributes
    ----------
    camera : str                    its name
    points : (n, 3) float [m]
    pixels : (n, 2) float [px]      column and row, the first pixel's centre is (0, 0)
    """

    camera: str
    points: Points
    pixels: Float[np.ndarray, "n 2"]


def read_multidic(path: Path, *, length_unit: str | None) -> Rig:
    """Rig of all DLT files in a folder, in the frame of the calibration object.

    Parameters
    ----------
    path : Path                     the folder, or any of its files DLTstruct_cam_*.mat
    length_unit : str or None       of the calibration object; None: mm

    Returns
    -------
    Rig                             cameras named by their number, sizes not known, no lens

    Raises
    ------
    RecordError                     a file that cannot be read as such
    CalibrationError                numbers of no camera, or one that looks away from the object
    """
    metres = metres_per_unit(path, length_unit, usual="mm")
    return make_rig(path, [_camera(file, _content(file), metres) for file in _files(path)])


def read_control_points(
    path: Path | str, *, length_unit: str | None = None
) -> tuple[ControlPoints, ...]:
    """What the transformations were computed from, so that the lens can be found too.

    Parameters
    ----------
    path : path                     the folder, or any of its files DLTstruct_cam_*.mat
    length_unit : str or None       None: mm

    Returns
    -------
    tuple of ControlPoints          one per camera, in the order of the rig

    Raises
    ------
    RecordError, CalibrationError   as `read_multidic`
    """
    path = Path(path)
    metres = metres_per_unit(path, length_unit, usual="mm")
    found = []
    for file in _files(path):
        content = _content(file)
        points, pixels = _control(file, content)
        found.append(ControlPoints(str(content["indCam"]), metres * points, pixels))
    return tuple(found)


def _files(path: Path) -> Sequence[Path]:
    folder = path if path.is_dir() else path.parent
    files = sorted(folder.glob(_PATTERN), key=lambda file: (len(file.name), file.name))
    if not path.is_dir() and path not in files:
        raise RecordError(
            f"{path}: is not a camera's transformation of MultiDIC; {_PAIRS_HINT} (in"
            " DLTstructPairs.mat the lens is a MATLAB object, which only MATLAB can read)"
        )
    return files


def _content(path: Path) -> dict[str, Any]:
    """Fields of the one structure in a MATLAB file."""
    scipy_io = late_import("scipy.io", extra=None, purpose="reading a MATLAB file")
    try:
        variables = scipy_io.loadmat(path, squeeze_me=True, simplify_cells=True)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, TypeError, NotImplementedError) as error:
        raise RecordError(
            f"{path}: is no MATLAB file of version 5 to 7.2 ({error}); save it with '-v7'"
        ) from error
    for value in variables.values():
        if isinstance(value, dict) and "DLTparams" in value and "indCam" in value:
            return value
    names = [name for name in variables if not name.startswith("__")]
    raise RecordError(
        f"{path}: holds no transformation (DLTparams, indCam) but {', '.join(names) or 'nothing'};"
        f" {_PAIRS_HINT}"
    )


def _camera(path: Path, content: dict[str, Any], metres: float) -> Camera:
    name = str(content["indCam"])
    terms = numbers(path, "DLTparams", content["DLTparams"], (11,))
    projection = np.append(terms, 1.0).reshape(3, 4)
    # Of the two signs the one for which the rotation is one.
    projection *= np.sign(np.linalg.det(projection[:, :3])) or 1.0
    if np.linalg.matrix_rank(projection[:, :3]) < 3:
        raise CalibrationError(
            f"{path}: DLTparams {terms.tolist()} are of no camera (rank below 3)"
        )
    matrix, rotation = rq(projection[:, :3])
    signs = np.diag(np.sign(np.diag(matrix)))
    matrix, rotation = matrix @ signs, signs @ rotation
    translation = np.linalg.solve(matrix, projection[:, 3])
    if "C3Dtrue" in content:
        points, _ = _control(path, content)
        behind = int(np.sum(points @ rotation[2] + translation[2] <= 0.0))
        if behind:
            raise CalibrationError(
                f"{path}: {behind} of {len(points)} points of the calibration object are behind"
                " the camera: its coordinates are left-handed, or the picture is mirrored"
            )
    matrix /= matrix[2, 2]
    # Rounding; K is triangular by construction.
    matrix[np.tril_indices(3, -1)] = 0.0
    matrix[:2, 2] -= 1.0
    pose = make_pose(rotation, metres * translation)
    return make_camera(path, name, size=None, matrix=matrix, distortion=(), pose=pose)


def _control(
    path: Path, content: dict[str, Any]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]:
    """Points of the columns that the camera saw, in the file's unit, and their pixels from 0."""
    missing = [key for key in ("C3Dtrue", "columns", "imageCentroids") if key not in content]
    if missing:
        raise CalibrationError(
            f"{path}: has no {missing[0]}; MultiDIC's DLTstruct_cam files have it"
        )
    table = np.asarray(content["C3Dtrue"], dtype=np.float64)
    columns = np.atleast_1d(content["columns"]).astype(np.int64) - 1
    pixels = np.asarray(content["imageCentroids"], dtype=np.float64)
    fits = table.ndim == 3 and columns.min() >= 0 and columns.max() < table.shape[1]
    if not fits or pixels.shape != (table.shape[0] * len(columns), 2):
        raise CalibrationError(
            f"{path}: imageCentroids {pixels.shape} do not belong to the {len(columns)} columns of"
            f" C3Dtrue {table.shape}"
        )
    return table[:, columns].transpose(1, 0, 2).reshape(-1, 3), pixels - 1.0
