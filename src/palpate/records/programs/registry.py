"""The list of programs whose files are read, and the choice of the reader for a given file; rigs
from rig.toml and from these programs' calibrations.

Each program has its own conventions, described in its file. A `Rig` always uses the same: metres,
x_camera = R x_object + t, the centre of the first pixel is (0, 0).
"""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import tomlkit

from palpate.errors import CalibrationError, RecordError, quoted
from palpate.files import is_file, read_errors
from palpate.records.measured_points import MeasuredPoints, in_metres
from palpate.records.program import CalibrationFile, Program, ProgramPoints, make_pose
from palpate.records.programs.correlation import MATCHID, VIC3D
from palpate.records.programs.dice import DICE
from palpate.records.programs.matlab import MATLAB
from palpate.records.programs.multidic import MULTIDIC
from palpate.records.programs.opencv import KALIBR, OPENCV, TOML_CAMERAS, holds_camera_tables
from palpate.records.programs.point_tables import OPENCORR, PLANAR, PYVALE, VTU
from palpate.records.quantities import FILE_LENGTH_UNITS
from palpate.records.rig import Camera, PictureTracks, Rig, check_baselines, check_cameras
from palpate.records.text.text_file import check_file_names, write_text
from palpate.records.text.toml_table import TomlTable, nearest_file, read_toml

# To add a program: a file next to these, and one line here.
PROGRAMS: tuple[Program, ...] = (
    DICE,
    VIC3D,
    MATCHID,
    PYVALE,
    OPENCORR,
    MATLAB,
    MULTIDIC,
    VTU,
    PLANAR,
    KALIBR,
    TOML_CAMERAS,
    OPENCV,
)
_FILE = "rig.toml"
_ROOT_KEYS = ("length_unit", "reference", "camera")
_CAMERA_KEYS = ("name", "size", "K", "distortion", "R", "t")


def import_kinds() -> dict[str, Program]:
    """Programs whose displacements can be imported, by their names in `palpate import`."""
    return {kind: program for program in PROGRAMS for kind in program.kinds}


def kinds_text() -> str:
    """Names of these programs as text, with the suffixes of their files."""
    return ", ".join(f"{' or '.join(p.kinds)} ({p.results})" for p in PROGRAMS if p.kinds)


def read_measured(
    kind: str,
    path: Path | str,
    *,
    length_unit: str | None = None,
    frame: int | None = None,
    min_score: float | None = None,
    triangulate: Callable[[PictureTracks], ProgramPoints] | None = None,
) -> MeasuredPoints:
    """Points and displacements of one result file, in metres, in the program's own frame.

    Parameters
    ----------
    kind : str                      a name of `import_kinds`
    path : path
    length_unit : str or None       um, mm, cm, m or in, if the file states none
    frame : int or None             state, from 0, in files with several; None: the last one
    min_score : float or None       lowest correlation of a match that is accepted, -1 to 1; None:
                                    the program's own `min_score`
    triangulate : callable or None  triangulates matches in pixels; None: the file has 3-D points

    Returns
    -------
    MeasuredPoints

    Raises
    ------
    RecordError                     unknown kind, or one without matches in pixels; a file that is
                                    missing, damaged, 2-D or without measured points; a `min_score`
                                    out of range, or for a file without correlations
    InputError                      an optional package that reads the file is missing
    """
    program = import_kinds().get(kind)
    if program is None or program.read_points is None:
        raise RecordError(f"kind is '{kind}'; must be one of {', '.join(import_kinds())}")
    if min_score is not None and not -1.0 <= min_score <= 1.0:
        raise RecordError(f"--min-score is {min_score:g}; must be a correlation, -1 to 1")
    if triangulate is not None and program.read_tracks is None:
        raise RecordError(f"{path}: files of {kind} hold places, no pixels; leave --rig out")
    # Infinities from a damaged file are refused below; no warnings about them.
    cure = f"export it again from {kind}"
    with read_errors(Path(path), cure, what="cannot be read"), np.errstate(all="ignore"):
        if triangulate is not None and program.read_tracks is not None:
            given = triangulate(program.read_tracks(Path(path), frame))
        else:
            given = program.read_points(Path(path), frame)
    if min_score is not None and given.score is None:
        raise RecordError(
            f"{path}: has no correlation of its points; leave --min-score out, or export them"
            " with it"
        )
    return in_metres(
        given,
        Path(path),
        length_unit=length_unit,
        default_unit=program.default_unit,
        min_score=program.min_score if min_score is None else min_score,
    )


def _read_calibration(path: Path, *, length_unit: str | None) -> Rig:
    """Rig from the calibration of another program, which is recognised by its content.

    Parameters
    ----------
    path : Path                     a file; or a folder with a file per camera (MultiDIC, OpenCV)
    length_unit : str or None       m, cm, mm or in, for files that state none; None: the program's
                                    usual unit

    Returns
    -------
    Rig                             the first camera is the reference

    Raises
    ------
    RecordError                     missing, not readable, not of a known program
    CalibrationError                missing or contradictory content
    """
    file = CalibrationFile.read(path, length_unit)
    with read_errors(path, "export the calibration again", what="cannot be read as a calibration"):
        for program in PROGRAMS:
            if program.holds_rig and program.read_rig and program.holds_rig(file):
                return program.read_rig(file)
    known = ", ".join(program.calibrations for program in PROGRAMS if program.calibrations)
    raise RecordError(
        f"{path}: is no camera calibration{_contents_text(file)}; known are rig.toml, {known}"
    )


def _contents_text(file: CalibrationFile) -> str:
    """The names of what a file holds instead, if there are any."""
    if file.path.is_dir():
        return ", and it holds none"
    if file.content is None or isinstance(file.content, str):
        return ""
    names = file.content if isinstance(file.content, dict) else (e.tag for e in file.content)
    return f" (it holds: {', '.join([str(name) for name in names][:8])})"


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
        rig = _read_calibration(path, length_unit=length_unit)
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
    check_file_names(names, what=f"{root.file}: camera", kind=CalibrationError)
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
