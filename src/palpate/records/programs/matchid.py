"""Calibrations and stereo results of MatchID."""

import re
from collections.abc import Mapping
from pathlib import Path

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

# Long column names without category and unit, and the short ones of version 2023.
_COLUMNS = {
    "X": ("x",),
    "Y": ("y",),
    "Z": ("z",),
    "U": ("horizontal displacement u", "u"),
    "V": ("vertical displacement v", "v"),
    "W": ("out-of-plane: w", "out-of-plane w", "out-of-plane displacement w", "w"),
}
_LINE = re.compile(r"\s*([^;:\[\]]+?)\s*(?:\[\s*([^\]]*?)\s*\])?\s*[;:]\s*(.*?)\s*$")
_WHERE = "the calibration"
# Longer lines are not of this form, and matching the pattern would take too long.
_LONGEST_LINE = 200


def read_matchid_points(path: Path, frame: int | None = None) -> ProgramPoints:
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
    wanted = table.require(_COLUMNS, normalise=_bare_name, reason=_reason)
    notes: tuple[str, ...] = ()
    if table.find(["sigma"], normalise=_bare_name):
        notes = ("The column Sigma was left out: it does not say whose error it is.",)
    values = table.values(wanted)
    return ProgramPoints(values[:, :3], values[:, 3:], unit=table.unit(wanted), notes=notes)


def _reason(missing: list[str]) -> str:
    return missing_depth(missing) or (
        "export all variables of a time step in one table, header [Category].[Long variable"
        " name].[units]"
    )


def _bare_name(name: str) -> str:
    """Name without its category, in lower case: 'coor.X' becomes 'x'."""
    return name.rpartition(".")[2].strip().lower()


def _lines(file: CalibrationFile) -> list[str]:
    """Lines of a .caldat file, or of pyvale's YAML with the same keys."""
    if isinstance(file.content, dict):
        scalars = (str, int, float)
        return [f"{key};{x}" for key, x in file.content.items() if isinstance(x, scalars)]
    lines = file.content.splitlines() if isinstance(file.content, str) else []
    return [line for line in lines if len(line) <= _LONGEST_LINE]


def _holds_rig(file: CalibrationFile) -> bool:
    return any(line.lower().startswith("cam0_fx") for line in _lines(file))


def read_matchid_rig(file: CalibrationFile) -> Rig:
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
    for line in _lines(file):
        if match := _LINE.match(line):
            values[match[1].lower()], units[match[1].lower()] = match[3], match[2]
    angles = [file.number(values, name, _WHERE) for name in ("theta", "phi", "psi")]
    if (units["theta"] or "deg").lower().startswith("rad"):
        angles = [float(np.rad2deg(angle)) for angle in angles]
    translation = [file.number(values, name, _WHERE) for name in ("tx", "ty", "tz")]
    metres = file.metres(stated=units["tx"], default="mm")
    second = make_pose(rotation_from_angles(angles), metres * np.array(translation))
    return file.rig([_camera(file, values, i, pose) for i, pose in enumerate((np.eye(4), second))])


def _camera(
    file: CalibrationFile, values: Mapping[str, str], index: int, pose: np.ndarray
) -> Camera:
    def number(key: str, default: float | None = None) -> float:
        return file.number(values, f"cam{index}_{key}", _WHERE, default=default)

    intrinsics = [number(key) for key in ("fx", "fy", "cx", "cy")]
    lens = [number(key, default=0.0) for key in ("kappa 1", "kappa 2", "p1", "p2", "kappa 3")]
    matrix = camera_matrix(intrinsics, number("fs", default=0.0))
    return file.camera(str(index), matrix=matrix, distortion=lens, pose=pose)


MATCHID = Program(
    kinds=("matchid",),
    results=".csv",
    read_points=read_matchid_points,
    default_unit="mm",
    calibrations="MatchID (.caldat)",
    holds_rig=_holds_rig,
    read_rig=read_matchid_rig,
)
