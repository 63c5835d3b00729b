"""Reads rigs from rig.toml and other calibration files; writes rig.toml."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import tomlkit

from palpate.errors import CalibrationError, RecordError, quoted
from palpate.files import is_file
from palpate.records.program import CalibrationFile, make_pose
from palpate.records.programs.registry import read_calibration
from palpate.records.programs.toml_cameras import holds_camera_tables
from palpate.records.rig import Camera, Rig, check_baselines, check_cameras
from palpate.records.text.nearest import nearest_file
from palpate.records.text.text_file import write_text
from palpate.records.text.toml_table import TomlTable, read_toml
from palpate.records.text.units import FILE_LENGTH_UNITS

_FILE = "rig.toml"
_ROOT_KEYS = ("length_unit", "reference", "camera")
_CAMERA_KEYS = ("name", "size", "K", "distortion", "R", "t")


def read_rig(path: Path | str, *, length_unit: str | None = None) -> Rig:
    """Read cameras from rig.toml or from the calibration file of another program.

    Parameters
    ----------
    path : path                     a file, or a folder with rig.toml or a file per camera
    length_unit : str or None       m, cm, mm or in: unit of translations in a file that states
                                    none; None: the program's usual one (m for Kalibr and caliscope;
                                    mm for VIC-3D, DICe, MatchID, MATLAB and MultiDIC)

    Returns
    -------
    Rig                             in metres; x_camera = R x_object + t, the centre of the first
                                    pixel is (0, 0)

    Raises
    ------
    RecordError                     missing, not readable, of unknown kind
    CalibrationError                missing or contradictory content; the text names the file
    InputError                      length_unit is not a known unit
    """
    path = Path(path)
    if is_file(path / _FILE):
        path = path / _FILE
    if not os.path.exists(path):
        raise RecordError(f"{path}: no such file{nearest_file(path)}")
    root = read_toml(path) if path.suffix.lower() == ".toml" else None
    if root is None or holds_camera_tables(root.values):
        rig = read_calibration(path, length_unit=length_unit)
    else:
        rig = _read_toml_rig(root, length_unit)
    check_cameras(rig)
    check_baselines(rig)
    return rig


def write_rig(path: Path | str, rig: Rig) -> None:
    """Write a rig as rig.toml, in metres, matrices by rows; reading it back gives the same numbers.

    Parameters
    ----------
    path : path
    rig : Rig

    Raises
    ------
    RecordError                     the file cannot be written
    """
    cameras = []
    for camera in rig.cameras:
        pose = camera.T_camera_object
        table = {
            "name": camera.name,
            "size": camera.size and list(camera.size),
            "K": camera.matrix.tolist(),
            "distortion": camera.distortion.tolist(),
            "R": pose[:3, :3].tolist(),
            "t": pose[:3, 3].tolist(),
        }
        cameras.append({key: value for key, value in table.items() if value is not None})
    reference = rig.cameras[rig.reference].name
    content = {"length_unit": "m", "reference": reference, "camera": cameras}
    write_text(path, tomlkit.dumps(content))


def _read_toml_rig(root: TomlTable, length_unit: str | None) -> Rig:
    """A rig from the root table of a rig.toml."""
    root.check_keys(_ROOT_KEYS)
    if "length_unit" in root.values or length_unit is None:
        length_unit = root.choice("length_unit", tuple(FILE_LENGTH_UNITS))
    file = CalibrationFile(root.file, None, length_unit)
    metres = file.metres(default=None)
    cameras = [_camera(file, table, metres) for table in root.tables("camera")]
    names = [camera.name for camera in cameras]
    reference = 0
    if "reference" in root.values:
        reference = names.index(root.choice("reference", names))
    return file.rig(cameras, reference=reference)


def _camera(file: CalibrationFile, table: TomlTable, metres: float) -> Camera:
    name = table.text("name")
    where = f"[[camera]] {quoted(name)}"
    table = replace(table, name=where)
    table.check_keys(_CAMERA_KEYS)

    def array(key: str, shape: tuple[int, ...] | None) -> np.ndarray:
        return file.numbers(f"{where} {key}", table.get(key), shape)

    rotation, translation = array("R", (3, 3)), array("t", (3,))
    return file.camera(
        name,
        size=_size(table, where),
        matrix=array("K", (3, 3)),
        distortion=array("distortion", None) if "distortion" in table.values else (),
        pose=make_pose(rotation, metres * translation),
    )


def _size(table: TomlTable, where: str) -> tuple[int, int] | None:
    """Columns and rows of the pictures, if given."""
    if "size" not in table.values:
        return None
    value = table.values["size"]
    valid = isinstance(value, list) and all(type(item) is int and item > 0 for item in value)
    if not (valid and len(value) == 2):
        raise CalibrationError(
            f"{table.file}: {where} size is {quoted(value)}; must be two whole numbers,"
            " columns and rows, e.g. [640, 480]"
        )
    return value[0], value[1]
