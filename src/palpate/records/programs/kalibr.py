"""Cameras from a camera chain of Kalibr (camchain.yaml)."""

from pathlib import Path
from typing import Any

import numpy as np

from palpate.errors import CalibrationError
from palpate.records.programs.calibration_parts import (
    make_camera,
    make_pose,
    make_rig,
    metres_per_unit,
    numbers,
)
from palpate.records.rig import Camera, Rig


def read_kalibr(path: Path, root: dict[str, Any], *, length_unit: str | None) -> Rig:
    """Rig of a camera chain, in the frame of its first camera.

    Parameters
    ----------
    path : Path
    root : dict                     the file's content: tables cam0, cam1, ...
    length_unit : str or None       None: m

    Returns
    -------
    Rig                             cameras 'cam0', 'cam1', ...

    Raises
    ------
    CalibrationError                a model other than pinhole with radtan or no distortion, a key
                                    missing, contradictions as `Camera` says
    """
    metres = metres_per_unit(path, length_unit, usual="m")
    names = sorted(
        (key for key, value in root.items() if key.startswith("cam") and isinstance(value, dict)),
        key=lambda key: (len(key), key),
    )
    cameras: list[Camera] = []
    pose = np.eye(4)
    for name in names:
        if cameras:
            step = numbers(
                path, f"{name} T_cn_cnm1", _get(path, name, root[name], "T_cn_cnm1"), (4, 4)
            )
            pose = make_pose(step[:3, :3], metres * step[:3, 3]) @ pose
        cameras.append(_camera(path, name, root[name], pose))
    return make_rig(path, cameras)


def _camera(path: Path, name: str, table: dict[str, Any], pose: np.ndarray) -> Camera:
    model = _get(path, name, table, "camera_model")
    lens = str(table.get("distortion_model", "none")).lower()
    if model != "pinhole" or lens not in ("radtan", "plumb_bob", "none"):
        raise CalibrationError(
            f"{path}: {name} is of the model {model} with {lens}; only pinhole with radtan (or"
            " none) is known: calibrate with --models pinhole-radtan"
        )
    fx, fy, cx, cy = numbers(
        path, f"{name} intrinsics", _get(path, name, table, "intrinsics"), (4,)
    )
    terms = [] if lens == "none" else _get(path, name, table, "distortion_coeffs")
    size = None
    if "resolution" in table:
        columns, rows = numbers(path, f"{name} resolution", table["resolution"], (2,))
        size = (int(columns), int(rows))
    return make_camera(
        path,
        name,
        size=size,
        matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=numbers(path, f"{name} distortion_coeffs", terms, None),
        pose=pose,
    )


def _get(path: Path, name: str, table: dict[str, Any], key: str) -> Any:
    if key not in table:
        raise CalibrationError(f"{path}: {name} has no '{key}'; a camera chain of Kalibr has it")
    return table[key]
