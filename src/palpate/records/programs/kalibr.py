"""Calibrations of Kalibr: a chain of cameras (camchain.yaml)."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from palpate.records.program import CalibrationFile, Program, camera_matrix, make_pose
from palpate.records.rig import Camera, Rig


def _holds_rig(file: CalibrationFile) -> bool:
    return isinstance(file.content, dict) and isinstance(file.content.get("cam0"), dict)


def read_kalibr_rig(file: CalibrationFile) -> Rig:
    """Rig of a camera chain, in the frame of its first camera; lengths are in metres.

    Parameters
    ----------
    file : CalibrationFile          with the tables cam0, cam1, ...

    Returns
    -------
    Rig                             cameras 'cam0', 'cam1', ...

    Raises
    ------
    CalibrationError                a model other than pinhole with radtan or no distortion, a
                                    missing key, or as in `Camera`
    InputError                      the given unit of length is unknown

    Source
    ------
    Kalibr (github.com/ethz-asl/kalibr), wiki "yaml formats": T_cn_cnm1 maps points from the frame
    of the previous camera to this one; radtan is k1 k2 p1 p2 of OpenCV.
    """
    metres = file.metres(default="m")
    tables = {name: table for name, table in file.content.items() if isinstance(table, dict)}
    names = sorted((n for n in tables if n.startswith("cam")), key=lambda n: (len(n), n))
    cameras: list[Camera] = []
    pose = np.eye(4)
    for name in names:
        if cameras:
            step = file.numbers(
                f"{name} T_cn_cnm1", file.entry(tables[name], "T_cn_cnm1", name), (4, 4)
            )
            pose = make_pose(step[:3, :3], metres * step[:3, 3]) @ pose
        cameras.append(_camera(file, name, tables[name], pose))
    return file.rig(cameras)


def _camera(file: CalibrationFile, name: str, table: Mapping[str, Any], pose: np.ndarray) -> Camera:
    model = file.entry(table, "camera_model", name)
    lens = str(table.get("distortion_model", "none")).lower()
    if model != "pinhole" or lens not in ("radtan", "plumb_bob", "none"):
        file.fail(
            f"{name} is of the model {model} with {lens}; only pinhole with radtan (or none) is"
            " known: calibrate with --models pinhole-radtan"
        )
    intrinsics = file.numbers(f"{name} intrinsics", file.entry(table, "intrinsics", name), (4,))
    terms = [] if lens == "none" else file.entry(table, "distortion_coeffs", name)
    return file.camera(
        name,
        size=file.size(table.get("resolution")),
        matrix=camera_matrix(intrinsics),
        distortion=file.numbers(f"{name} distortion_coeffs", terms, None),
        pose=pose,
    )


KALIBR = Program(
    calibrations="Kalibr (camchain YAML)", holds_rig=_holds_rig, read_rig=read_kalibr_rig
)
