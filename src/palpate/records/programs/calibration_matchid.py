"""Cameras from a calibration file of MatchID (.caldat), or pyvale's of the same keys."""

import re
from pathlib import Path

import numpy as np

from palpate.errors import CalibrationError
from palpate.records.programs.calibration_parts import (
    make_camera,
    make_pose,
    make_rig,
    metres_per_unit,
    numbers,
    rotation_from_angles,
)
from palpate.records.rig import Camera, Rig

_KEY = re.compile(r"\s*([^;:\[\]]+?)\s*(?:\[\s*([^\]]*?)\s*\])?\s*[;:]\s*(.*?)\s*$")


def read_matchid(path: Path, content: str, *, length_unit: str | None) -> Rig:
    """Rig of two cameras in the frame of the first.

    The second camera is at x_1 = Rz(Psi) Ry(Phi) Rx(Theta) x_0 + T, checked with a picture pair and
    MatchID's calibration of it (0.09 px).

    Parameters
    ----------
    path : Path
    content : str                   lines `Cam0_Fx [pixels];6673.3`
    length_unit : str or None       of the translation where its line names no unit; None: mm

    Returns
    -------
    Rig                             cameras '0' and '1', sizes not known

    Raises
    ------
    CalibrationError                a key missing or no number, contradictions as `Camera` says
    """
    values, units = {}, {}
    for line in content.splitlines():
        if match := _KEY.match(line):
            values[match[1].lower()], units[match[1].lower()] = match[3], match[2]
    angles = [_number(path, values, name) for name in ("Theta", "Phi", "Psi")]
    if (units["theta"] or "deg").lower().startswith("rad"):
        angles = [float(np.rad2deg(angle)) for angle in angles]
    shift = [_number(path, values, name) for name in ("Tx", "Ty", "Tz")]
    metres = metres_per_unit(path, units["tx"] or length_unit, usual="mm")
    poses = (
        np.eye(4),
        make_pose(rotation_from_angles(angles), metres * np.array(shift)),
    )
    return make_rig(path, [_camera(path, values, i, pose) for i, pose in enumerate(poses)])


def _camera(path: Path, values: dict[str, str], index: int, pose: np.ndarray) -> Camera:
    fx, fy, cx, cy = (
        _number(path, values, f"Cam{index}_{key}") for key in ("Fx", "Fy", "Cx", "Cy")
    )
    skew = _number(path, values, f"Cam{index}_Fs", missing=0.0)
    order = ("Kappa 1", "Kappa 2", "P1", "P2", "Kappa 3")
    lens = [_number(path, values, f"Cam{index}_{key}", missing=0.0) for key in order]
    matrix = np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return make_camera(path, str(index), size=None, matrix=matrix, distortion=lens, pose=pose)


def _number(path: Path, values: dict[str, str], key: str, *, missing: float | None = None) -> float:
    if key.lower() not in values:
        if missing is None:
            raise CalibrationError(
                f"{path}: '{key}' is missing; a MatchID calibration has it. Export it again"
            )
        return missing
    return float(numbers(path, key, values[key.lower()], ()))
