"""Calibrations and stereo results of VIC-3D (Correlated Solutions)."""

from collections.abc import Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from palpate.records.program import (
    CalibrationFile,
    Program,
    ProgramPoints,
    camera_matrix,
    chosen_frame,
    make_pose,
    rotation_from_angles,
)
from palpate.records.rig import Camera, Rig
from palpate.records.text.csv_table import missing_depth, read_text_table

_COLUMNS = {name: (name,) for name in "XYZUVW"}
_STD_COLUMNS = ("sigma_x", "sigma_y", "sigma_z")


def read_vic3d_points(path: Path, frame: int | None = None) -> ProgramPoints:
    """Points of one data file that VIC-3D exported as CSV.

    The columns X, Y, Z (at rest) and U, V, W are read, with or without a unit ("X [mm]"); columns
    in lower case are pixels and are ignored. A row with sigma < 0 was not correlated. sigma is in
    pixels, not the standard deviation of a displacement; Sigma_X, Sigma_Y, Sigma_Z are taken as
    those of a position, so the displacement, a difference of two positions, has sqrt(2) times them.

    Parameters
    ----------
    path : Path
    frame : int or None             a file holds one state: only 0 or None

    Raises
    ------
    RecordError                     a missing column (2-D results have no Z and W), text in a cell,
                                    no rows

    Source
    ------
    Correlated Solutions, "Output variables in Vic-2D and Vic-3D" (application note 28): names,
    units, "sigma [pixel]: the 1-standard deviation confidence in the match"; X + U is the position
    under load. Sigma_X [mm] corresponds to VicPy's SIGMA_X; that it is one standard deviation of
    the position is inferred from its name and unit, as no manual was found that states it.
    """
    chosen_frame(path, frame)
    table = read_text_table(path, cure="export the points from VIC-3D again, as text")
    # Upper case only: columns in lower case are pixels.
    wanted = table.require(_COLUMNS, normalise=str, reason=_reason)
    deviations = [c for name in _STD_COLUMNS if (c := table.find([name], normalise=str.lower))]
    values = table.values(wanted)
    failed, std = None, None
    notes: tuple[str, ...] = ()
    if sigma := table.find(["sigma"], normalise=str.lower):
        failed = table.values([sigma])[:, 0] < 0.0
    else:
        notes += ("It has no column sigma, so failed points cannot be recognised.",)
    if len(deviations) == 3:
        std = np.sqrt(2.0) * table.values(deviations)
        notes += ("The sigma of a displacement is taken as sqrt(2) of Sigma_X, Sigma_Y, Sigma_Z.",)
    unit = table.unit([*wanted, *deviations])
    return ProgramPoints(values[:, :3], values[:, 3:], failed, std, unit, notes)


def _reason(missing: list[str]) -> str:
    return missing_depth(missing) or (
        "export X, Y, Z, U, V, W and sigma (capitals: lengths; small letters are pixels)"
    )


def _holds_rig(file: CalibrationFile) -> bool:
    return (
        isinstance(file.content, Element) and file.content.find(".//camera/orientation") is not None
    )


def read_vic3d_rig(file: CalibrationFile) -> Rig:
    """Rig of a VIC-3D project (XML).

    A camera is `cx cy fx fy skew k1 k2 k3`, all in pixels except the radial terms, which are
    OpenCV's; `orientation` holds the angles about x, y, z in degrees and the translation in mm of
    x_camera = Rz Ry Rx x_world + t. The world frame has its z axis towards the cameras and its
    x axis along the baseline; DICe writes its model coordinates in the same frame.

    Parameters
    ----------
    file : CalibrationFile          a parsed project; lengths in mm unless a unit is given

    Returns
    -------
    Rig                             in the file's world frame; cameras are named by their `id`; the
                                    size is known for cameras whose pictures have a mask

    Raises
    ------
    CalibrationError                missing numbers, or as in `Camera` and `Rig`
    InputError                      the given unit of length is unknown

    Source
    ------
    Inferred from the pairs of pictures and the matches in such files: the residual distance from
    epipolar lines is 0.05 px.
    """
    metres, sizes = file.metres(default="mm"), _sizes(file.content)
    return file.rig([_camera(file, node, metres, sizes) for node in file.content.iter("camera")])


def _camera(
    file: CalibrationFile, node: Element, metres: float, sizes: Mapping[str, tuple[int, int]]
) -> Camera:
    name = node.get("id", "")
    intrinsics = file.numbers(f'<camera id="{name}">', (node.text or "").split(), (8,))
    orientation = node.find("orientation")
    if orientation is None:
        file.fail(
            f"camera '{name}' has no <orientation>; save the project after the stereo calibration"
        )
    extrinsics = file.numbers(
        f"<orientation> of camera '{name}'", (orientation.text or "").split(), (6,)
    )
    cx, cy, fx, fy, skew, k1, k2, k3 = intrinsics
    return file.camera(
        name,
        size=sizes.get(name),
        matrix=camera_matrix((fx, fy, cx, cy), skew),
        distortion=(k1, k2, 0.0, 0.0, k3),
        pose=make_pose(rotation_from_angles(extrinsics[:3]), metres * extrinsics[3:]),
    )


def _sizes(root: Element) -> dict[str, tuple[int, int]]:
    """Picture sizes (columns, rows) from masks, by camera id, with which picture names end."""
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


VIC3D = Program(
    kinds=("vic3d",),
    results=".csv",
    read_points=read_vic3d_points,
    default_unit="mm",
    calibrations="VIC-3D (XML)",
    holds_rig=_holds_rig,
    read_rig=read_vic3d_rig,
)
