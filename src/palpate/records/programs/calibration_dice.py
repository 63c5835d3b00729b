"""Cameras from a camera system file of DICe (XML)."""

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float

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

# DICe's names of lens models whose radial terms act as OpenCV's. Of VIC3D the numbers are VIC-3D's.
_LENSES = (
    "OPENCV_LENS_DISTORTION",
    "K1R3_K2R5_K3R7",
    "VIC3D_LENS_DISTORTION",
    "NO_LENS_DISTORTION",
)
_BEYOND = ("S1", "S2", "S3", "S4", "T1", "T2")


def is_dice(root: Element) -> bool:
    """True for a camera system file; DICe's other files are parameter lists too."""
    return root.tag == "ParameterList" and bool(_lists(root, "CAMERA "))


def read_dice(path: Path, root: Element, *, length_unit: str | None) -> Rig:
    """Rig of a DICe camera system file.

    Parameters
    ----------
    path : Path
    root : Element                  <ParameterList>
    length_unit : str or None       None: mm

    Returns
    -------
    Rig                             in the frame that the first camera's extrinsics refer to (its
                                    own where it has none); cameras are named by CAMERA_ID, or by
                                    their number where that is blank

    Raises
    ------
    CalibrationError                a value that is missing, a lens model or a transformation that
                                    is not known, contradictions as `Camera` and `Rig` say
    """
    metres = metres_per_unit(path, length_unit, usual="mm")
    for name in (node.get("name", "") for node in root):
        if name.startswith("user_") and "transform" in name:
            raise CalibrationError(
                f"{path}: has a '{name}', which would move the object frame; take it out, the frame"
                " is then that of the cameras' extrinsics"
            )
    chained = _values(root).get("extrinsics_relative_camera_to_camera", "false").lower() == "true"
    cameras: list[Camera] = []
    for number, node in enumerate(_lists(root, "CAMERA ")):
        pose = _pose(path, node, metres)
        if chained and cameras:
            pose = pose @ cameras[0].T_camera_object
        cameras.append(_camera(path, node, number, pose))
    return make_rig(path, cameras)


def _camera(path: Path, node: Element, number: int, pose: Float[np.ndarray, "4 4"]) -> Camera:
    values = _values(node)
    name = values.get("CAMERA_ID", "").strip() or str(number)
    model = values.get("LENS_DISTORTION_MODEL", _LENSES[-1]).upper()
    if model not in _LENSES:
        raise CalibrationError(
            f"{path}: camera '{name}' has the lens model {model}; known are {', '.join(_LENSES)}"
        )
    fx, fy, cx, cy = (_number(path, name, values, key) for key in ("FX", "FY", "CX", "CY"))
    skew = _number(path, name, values, "FS", missing=0.0)
    if skew != 0.0 and model != "VIC3D_LENS_DISTORTION":
        raise CalibrationError(
            f"{path}: camera '{name}' has FS {skew:g}, which DICe passes over with {model}; take it"
            " out"
        )
    order = ("K1", "K2", "P1", "P2", "K3", "K4", "K5", "K6", *_BEYOND)
    lens = [_number(path, name, values, key, missing=0.0) for key in order]
    if model == "NO_LENS_DISTORTION" and any(lens):
        raise CalibrationError(
            f"{path}: camera '{name}' has lens terms but LENS_DISTORTION_MODEL is"
            " NO_LENS_DISTORTION or missing; name the model or take the terms out"
        )
    size = None
    if "IMAGE_HEIGHT_WIDTH" in values:
        height, width = _row(path, name, values["IMAGE_HEIGHT_WIDTH"], 2)
        size = (int(width), int(height))
    matrix = np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return make_camera(path, name, size=size, matrix=matrix, distortion=lens, pose=pose)


def _pose(path: Path, node: Element, metres: float) -> Float[np.ndarray, "4 4"]:
    """x_camera from x_world, or from x of the first camera where the file is chained."""
    values, where = _values(node), node.get("name", "")
    shift = [_number(path, where, values, key, missing=0.0) for key in ("TX", "TY", "TZ")]
    angles = [_number(path, where, values, key, missing=0.0) for key in ("ALPHA", "BETA", "GAMMA")]
    rotation = rotation_from_angles(angles)
    for table in _lists(node, "rotation_3x3_matrix"):
        rows = _values(table)
        missing = [row for row in ("ROW 0", "ROW 1", "ROW 2") if row not in rows]
        if missing:
            raise CalibrationError(f"{path}: {where}: rotation_3x3_matrix lacks {missing[0]}")
        rotation = np.stack([_row(path, where, rows[f"ROW {i}"], 3) for i in range(3)])
    return make_pose(rotation, metres * np.array(shift))


def _lists(node: Element, start: str) -> list[Element]:
    """Sublists whose name begins so, in the order of their names' numbers."""
    found = [child for child in node if child.tag == "ParameterList"]
    found = [child for child in found if child.get("name", "").startswith(start)]
    return sorted(found, key=lambda child: (len(child.get("name", "")), child.get("name", "")))


def _values(node: Element) -> dict[str, str]:
    return {
        child.get("name", ""): child.get("value", "") for child in node if child.tag == "Parameter"
    }


def _number(
    path: Path, camera: str, values: dict[str, str], key: str, *, missing: float | None = None
) -> float:
    if key not in values:
        if missing is None:
            raise CalibrationError(f"{path}: camera '{camera}' has no {key}; it must be given")
        return missing
    return float(numbers(path, f"{key} of camera '{camera}'", values[key], ()))


def _row(path: Path, camera: str, text: str, count: int) -> np.ndarray:
    """Numbers in the form { 1.0, 0.0, 0.0 }."""
    words = text.strip().strip("{}").split(",")
    return numbers(path, f"'{text}' of camera '{camera}'", words, (count,))
