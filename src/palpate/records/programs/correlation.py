"""Calibrations and stereo results of commercial programs: VIC-3D and MatchID."""

import re
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

_VIC3D_COLUMNS = {name: (name,) for name in "XYZUVW"}
_VIC3D_STD_COLUMNS = ("sigma_x", "sigma_y", "sigma_z")
# Long column names without category and unit, and the short ones of version 2023.
_MATCHID_COLUMNS = {
    "X": ("x",),
    "Y": ("y",),
    "Z": ("z",),
    "U": ("horizontal displacement u", "u"),
    "V": ("vertical displacement v", "v"),
    "W": ("out-of-plane: w", "out-of-plane w", "out-of-plane displacement w", "w"),
}
_MATCHID_LINE = re.compile(r"\s*([^;:\[\]]+?)\s*(?:\[\s*([^\]]*?)\s*\])?\s*[;:]\s*(.*?)\s*$")
_MATCHID_PLACE = "the calibration"
# Longer lines are not of this form, and matching the pattern would take too long.
_LONGEST_MATCHID_LINE = 200


def _read_vic3d_points(path: Path, frame: int | None) -> ProgramPoints:
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
    wanted = table.require(_VIC3D_COLUMNS, normalise=str, reason=_vic3d_reason)
    deviations = [
        c for name in _VIC3D_STD_COLUMNS if (c := table.find([name], normalise=str.lower))
    ]
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


def _vic3d_reason(missing: list[str]) -> str:
    return missing_depth(missing) or (
        "export X, Y, Z, U, V, W and sigma (capitals: lengths; small letters are pixels)"
    )


def _holds_vic3d_rig(file: CalibrationFile) -> bool:
    return (
        isinstance(file.content, Element) and file.content.find(".//camera/orientation") is not None
    )


def _read_vic3d_rig(file: CalibrationFile) -> Rig:
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
    metres, sizes = file.metres(default="mm"), _vic3d_sizes(file.content)
    return file.rig(
        [_vic3d_camera(file, node, metres, sizes) for node in file.content.iter("camera")]
    )


def _vic3d_camera(
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


def _vic3d_sizes(root: Element) -> dict[str, tuple[int, int]]:
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
    read_points=_read_vic3d_points,
    default_unit="mm",
    calibrations="VIC-3D (XML)",
    holds_rig=_holds_vic3d_rig,
    read_rig=_read_vic3d_rig,
)


def _read_matchid_points(path: Path, frame: int | None) -> ProgramPoints:
    """Points of one time step that MatchID exported as CSV, one row per point.

    The columns coor.X [mm], coor.Y, coor.Z, disp.Horizontal Displacement U [mm], disp.Vertical
    Displacement V and disp.Out-Of-Plane: W are read, with or without category and unit, or under
    the short names x, y, z, u, v, w; separated by commas, semicolons or tabs; decimal commas too. A
    cell without a number marks a point that was not measured. stats.Sigma is not used.

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
    Names of MatchID 2023 ("x", "u", ...) and 2024.1 ("coor.X [mm]", ...) as listed in the readers
    of DuoDIC (lib_DuoDIC/ReadMatchIDFile.m: header "[Category].[Long variable name].[units]") and
    of pyvale's predecessor mt2py. That coor.X is the position at rest is inferred from their use.
    """
    chosen_frame(path, frame)
    table = read_text_table(path, cure="export the points from MatchID again, as text")
    wanted = table.require(_MATCHID_COLUMNS, normalise=_bare_name, reason=_matchid_reason)
    notes: tuple[str, ...] = ()
    if table.find(["sigma"], normalise=_bare_name):
        notes = ("The column Sigma was left out: it does not say whose error it is.",)
    values = table.values(wanted)
    return ProgramPoints(values[:, :3], values[:, 3:], unit=table.unit(wanted), notes=notes)


def _matchid_reason(missing: list[str]) -> str:
    return missing_depth(missing) or (
        "export all variables of a time step in one table, header [Category].[Long variable"
        " name].[units]"
    )


def _bare_name(name: str) -> str:
    """Name without its category, in lower case: 'coor.X' becomes 'x'."""
    return name.rpartition(".")[2].strip().lower()


def _matchid_lines(file: CalibrationFile) -> list[str]:
    """Lines of a .caldat file, or of pyvale's YAML with the same keys."""
    if isinstance(file.content, dict):
        scalars = (str, int, float)
        return [f"{key};{x}" for key, x in file.content.items() if isinstance(x, scalars)]
    lines = file.content.splitlines() if isinstance(file.content, str) else []
    return [line for line in lines if len(line) <= _LONGEST_MATCHID_LINE]


def _holds_matchid_rig(file: CalibrationFile) -> bool:
    return any(line.lower().startswith("cam0_fx") for line in _matchid_lines(file))


def _read_matchid_rig(file: CalibrationFile) -> Rig:
    """Rig of two cameras in the frame of the first, from lines `Cam0_Fx [pixels];6673.3`.

    Pose of the second camera: x_1 = Rz(Psi) Ry(Phi) Rx(Theta) x_0 + T.

    Parameters
    ----------
    file : CalibrationFile          a .caldat file, or YAML with the same keys

    Returns
    -------
    Rig                             cameras '0' and '1', picture sizes unknown

    Raises
    ------
    CalibrationError                a missing key, not a number, or as in `Camera`
    InputError                      the given unit of length is unknown

    Source
    ------
    Verified with a pair of pictures and MatchID's calibration of it: agreement within 0.09 px.
    """
    values, units = {}, {}
    for line in _matchid_lines(file):
        if match := _MATCHID_LINE.match(line):
            values[match[1].lower()], units[match[1].lower()] = match[3], match[2]
    angles = [file.number(values, name, _MATCHID_PLACE) for name in ("theta", "phi", "psi")]
    if (units["theta"] or "deg").lower().startswith("rad"):
        angles = [float(np.rad2deg(angle)) for angle in angles]
    translation = [file.number(values, name, _MATCHID_PLACE) for name in ("tx", "ty", "tz")]
    metres = file.metres(stated=units["tx"], default="mm")
    second = make_pose(rotation_from_angles(angles), metres * np.array(translation))
    return file.rig(
        [_matchid_camera(file, values, i, pose) for i, pose in enumerate((np.eye(4), second))]
    )


def _matchid_camera(
    file: CalibrationFile, values: Mapping[str, str], index: int, pose: np.ndarray
) -> Camera:
    def number(key: str, default: float | None = None) -> float:
        return file.number(values, f"cam{index}_{key}", _MATCHID_PLACE, default=default)

    intrinsics = [number(key) for key in ("fx", "fy", "cx", "cy")]
    lens = [number(key, default=0.0) for key in ("kappa 1", "kappa 2", "p1", "p2", "kappa 3")]
    matrix = camera_matrix(intrinsics, number("fs", default=0.0))
    return file.camera(str(index), matrix=matrix, distortion=lens, pose=pose)


MATCHID = Program(
    kinds=("matchid",),
    results=".csv",
    read_points=_read_matchid_points,
    default_unit="mm",
    calibrations="MatchID (.caldat)",
    holds_rig=_holds_matchid_rig,
    read_rig=_read_matchid_rig,
)
