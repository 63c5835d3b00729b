"""Rigs of caliscope, Anipose and Pose2Sim: TOML with a table per camera."""

from collections.abc import Mapping
from typing import Any

from palpate.records.program import CalibrationFile, Program
from palpate.records.programs.opencv import opencv_pose
from palpate.records.rig import Camera, Rig


def holds_camera_tables(content: Any) -> bool:
    """True if a TOML file has camera tables in the form of these programs.

    Parameters
    ----------
    content : any                   parsed content of the file
    """
    return isinstance(content, dict) and bool(_tables(content))


def read_camera_tables(file: CalibrationFile) -> Rig:
    """Rig of tables with matrix, distortions, rotation (Rodrigues vector or matrix), translation.

    x_camera = R x_world + t, with OpenCV's distortion terms. A camera with ignore = true is left
    out. caliscope ([cameras.N], or tables with a port) writes metres; for the others the unit of
    length must be given, by the caller or in a line `length_unit`.

    Parameters
    ----------
    file : CalibrationFile          parsed TOML

    Returns
    -------
    Rig                             cameras named by `name`, else by their table

    Raises
    ------
    CalibrationError                a fisheye lens, a missing part, no unit of length, or as in
                                    `Camera` and `Rig`
    InputError                      the given unit of length is unknown

    Source
    ------
    Files in the repositories of caliscope (github.com/mprib/caliscope, tests/sessions,
    camera_array.toml) and aniposelib (CameraGroup.dump); Pose2Sim's Calib.toml is the same.
    """
    tables = _tables(file.content)
    is_caliscope = "cameras" in file.content or any("port" in t for t in tables.values())
    default = "m" if is_caliscope else None
    metres = file.metres(stated=file.content.get("length_unit"), default=default)
    used = {key: table for key, table in tables.items() if table.get("ignore") is not True}
    return file.rig([_camera(file, key, table, metres) for key, table in used.items()])


def _tables(content: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The cameras' tables by name."""
    inner = content.get("cameras")
    tables = inner if isinstance(inner, dict) else content
    return {k: t for k, t in tables.items() if isinstance(t, dict) and "matrix" in t}


def _camera(file: CalibrationFile, key: str, table: Mapping[str, Any], metres: float) -> Camera:
    name = str(table.get("name", key))
    where = f"camera '{name}'"
    if table.get("fisheye") is True:
        file.fail(f"{where} has a fisheye lens, which is not known; calibrate it as a usual one")
    if not {"rotation", "translation"} <= set(table):
        file.fail(
            f"{where} has no rotation and translation: its place among the others was not"
            " calibrated; finish that, or set ignore = true in its table"
        )
    return file.camera(
        name,
        size=file.size(table.get("size")),
        matrix=file.numbers(f"{where} matrix", table["matrix"], (3, 3)),
        distortion=file.numbers(f"{where} distortions", table.get("distortions", []), None),
        pose=opencv_pose(file, where, table["rotation"], table["translation"], metres),
    )


TOML_CAMERAS = Program(
    calibrations="caliscope and Anipose (TOML)",
    holds_rig=lambda file: holds_camera_tables(file.content),
    read_rig=read_camera_tables,
)
