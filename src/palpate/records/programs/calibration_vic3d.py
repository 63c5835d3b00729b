"""Cameras from the project file of VIC-3D (XML).

Conventions, found with the picture pairs and the matches that such files hold (the residual
distance from epipolar lines is 0.05 px): a camera is `cx cy fx fy skew k1 k2 k3`, all in pixels but
the radial terms, which act as OpenCV's; `orientation` is the angles about x, y, z in degrees and
the translation in mm of x_camera = Rz Ry Rx x_world + t. The world frame has its z axis towards the
cameras and its x axis along the baseline; DICe writes its model coordinates in it too.
"""

from pathlib import Path
from xml.etree.ElementTree import Element

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


def read_vic3d(path: Path, root: Element, *, length_unit: str | None) -> Rig:
    """Rig of a VIC-3D project.

    Parameters
    ----------
    path : Path
    root : Element                  of its XML
    length_unit : str or None       None: mm

    Returns
    -------
    Rig                             in the file's world frame; cameras are named by their `id`; the
                                    size is known of cameras whose pictures carry a mask

    Raises
    ------
    CalibrationError                numbers missing, or contradictory as `Camera` and `Rig` say
    """
    metres = metres_per_unit(path, length_unit, usual="mm")
    sizes = _sizes(root)
    cameras = [_camera(path, node, metres, sizes) for node in root.iter("camera")]
    return make_rig(path, cameras)


def _camera(path: Path, node: Element, metres: float, sizes: dict[str, tuple[int, int]]) -> Camera:
    name = node.get("id", "")
    inner = numbers(path, f'<camera id="{name}">', (node.text or "").split(), (8,))
    turn = node.find("orientation")
    if turn is None:
        raise CalibrationError(
            f"{path}: camera '{name}' has no <orientation>; save the project after the stereo"
            " calibration"
        )
    outer = numbers(path, f"<orientation> of camera '{name}'", (turn.text or "").split(), (6,))
    cx, cy, fx, fy, skew, k1, k2, k3 = inner
    return make_camera(
        path,
        name,
        size=sizes.get(name),
        matrix=np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=(k1, k2, 0.0, 0.0, k3),
        pose=make_pose(rotation_from_angles(outer[:3]), metres * outer[3:]),
    )


def _sizes(root: Element) -> dict[str, tuple[int, int]]:
    """Size (columns, rows) of pictures with a mask, by the camera's id: pictures end in _id."""
    sizes: dict[str, tuple[int, int]] = {}
    for area in root.iter("aoinode"):
        mask = area.find("polygonmask")
        if mask is None:
            continue
        width, height = mask.get("width", ""), mask.get("height", "")
        name = Path(area.get("img", "")).stem.rpartition("_")[2]
        if width.isdigit() and height.isdigit():
            sizes[name] = (int(width), int(height))
    return sizes
