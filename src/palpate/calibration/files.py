"""Files of a calibration: rig.toml, covariance, residuals by picture, formats of other programs."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import yaml
from jaxtyping import Float

from palpate.calibration.calibrate import Calibration, known_rig
from palpate.calibration.quality import picture_errors
from palpate.errors import RecordError
from palpate.records import (
    Camera,
    Rig,
    spreadsheet_text,
    write_rig,
    write_rig_covariance,
    write_text,
)


def write_calibration(
    folder: Path, calibration: Calibration, *, frame: Float[np.ndarray, "4 4"] | None = None
) -> None:
    """Write rig.toml, rig_covariance.npz, views.csv, opencv.yml and kalibr.yaml.

    Parameters
    ----------
    folder : Path                   exists
    calibration : Calibration
    frame : (4, 4) float [m] or None    x_first camera = frame x_rig; None: the frames coincide

    Raises
    ------
    RecordError                     a file cannot be written
    """
    cameras = calibration.cameras
    if frame is not None:
        cameras = tuple(
            replace(camera, T_camera_object=camera.T_camera_object @ frame) for camera in cameras
        )
    if len(cameras) > 1:
        write_rig(folder / "rig.toml", Rig(cameras, 0, str(folder)))
        _write_kalibr(folder / "kalibr.yaml", cameras)
    _write_opencv(folder / "opencv.yml", cameras)
    write_rig_covariance(folder, known_rig(calibration), calibration.adjusted.noise)
    _write_pictures(folder / "views.csv", calibration)


def _write_pictures(path: Path, calibration: Calibration) -> None:
    """Write one row per picture; the rms is left empty where no corner was kept."""
    rows: list[tuple[object, ...]] = [("camera", "view", "corners", "left out", "rms [px]")]
    for one in picture_errors(calibration):
        rms = "" if np.isnan(one.rms) else f"{one.rms:.4f}"
        rows.append((one.camera, one.view, one.corners, one.rejected, rms))
    write_text(path, spreadsheet_text(rows))


def _write_opencv(path: Path, cameras: Sequence[Camera]) -> None:
    """Write K1 D1 R1 T1 size1, K2 ... with `cv2.FileStorage`; lengths in metres."""
    storage = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    if not storage.isOpened():
        raise RecordError(f"{path}: cannot be written; check the folder's rights")
    storage.write("length_unit", "m")
    for number, camera in enumerate(cameras, start=1):
        pose = camera.T_camera_object
        storage.write(f"K{number}", np.array(camera.matrix))
        storage.write(f"D{number}", np.array(camera.distortion[None]))
        storage.write(f"R{number}", pose[:3, :3].copy())
        storage.write(f"T{number}", pose[:3, 3:].copy())
        if camera.size is not None:
            storage.write(f"size{number}", np.array(camera.size)[None])
    storage.release()


def _write_kalibr(path: Path, cameras: Sequence[Camera]) -> None:
    """Write a chain cam0, cam1, ...; the radtan model has no third radial term, k3 is dropped."""
    chain = {}
    for number, camera in enumerate(cameras):
        k = camera.matrix
        entry = {
            "camera_model": "pinhole",
            "intrinsics": [float(x) for x in (k[0, 0], k[1, 1], k[0, 2], k[1, 2])],
            "distortion_model": "radtan",
            "distortion_coeffs": [float(term) for term in camera.distortion[:4]],
            "resolution": list(camera.size or ()),
            "rostopic": f"/{camera.name}/image_raw",
        }
        if number:
            before = cameras[number - 1].T_camera_object
            step = camera.T_camera_object @ np.linalg.inv(before)
            entry["T_cn_cnm1"] = step.tolist()
        chain[f"cam{number}"] = entry
    write_text(path, yaml.safe_dump(chain, sort_keys=False))
