"""Calibrations and stereo results of DICe."""

from collections.abc import Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float
from scipy.io import netcdf_file

from palpate.errors import RecordError
from palpate.files import checked_file, read_bytes, read_errors
from palpate.records.program import (
    HDF5_SIGNATURE,
    MIN_CORRELATION,
    CalibrationFile,
    Program,
    ProgramPoints,
    camera_matrix,
    checked_size,
    chosen_frame,
    from_hdf5,
    make_pose,
    open_hdf5,
    rotation_from_angles,
)
from palpate.records.rig import Camera, Rig
from palpate.records.text.csv_table import read_text_table

_POSITION = tuple(f"MODEL_COORDINATES_{axis}" for axis in "XYZ")
_DISPLACEMENT = tuple(f"MODEL_DISPLACEMENT_{axis}" for axis in "XYZ")
_MATCH, _SIGMA, _GAMMA = "MATCH", "SIGMA", "GAMMA"
_USED = (*_POSITION, *_DISPLACEMENT, _MATCH, _SIGMA, _GAMMA)
_EXODUS_SUFFIXES = (".e", ".exo", ".ex2", ".exodus")
_NETCDF_CLASSIC = (b"CDF\x01", b"CDF\x02")
# DICe's names of lens models whose radial terms are OpenCV's; VIC3D has the numbers of VIC-3D.
_LENS_MODELS = (
    "OPENCV_LENS_DISTORTION",
    "K1R3_K2R5_K3R7",
    "VIC3D_LENS_DISTORTION",
    "NO_LENS_DISTORTION",
)
_LENS_TERMS = ("K1", "K2", "P1", "P2", *(f"K{i}" for i in range(3, 7)), "S1", "S2", "S3", "S4")

Columns = dict[str, Float[np.ndarray, " n"]]


def _read_dice_points(path: Path, frame: int | None) -> ProgramPoints:
    """Points of a stereo result of DICe: a text file per state, or one Exodus file of all states.

    The columns MODEL_COORDINATES (at rest) and MODEL_DISPLACEMENT are read. A point has failed if
    MATCH is not 0 or SIGMA is negative; its zeros are not measurements. SIGMA is in pixels, not the
    standard deviation of a displacement, and is not used. GAMMA is the sum of squared differences
    of two subsets normalised to zero mean and unit length, so the correlation coefficient, used as
    score, is 1 - GAMMA / 2.

    Parameters
    ----------
    path : Path                     suffix .e .exo .ex2 .exodus: Exodus; anything else: text
    frame : int or None             state of an Exodus file, from 0; None: the last one

    Raises
    ------
    RecordError                     a 2-D result, displacements of an incremental correlation (from
                                    picture to picture), a truncated file, text in a cell, no rows
    InputError                      h5py is not installed, for an HDF5 file

    Source
    ------
    DICe (github.com/dicengine/dice): names in src/core/DICe_FieldEnums.h; gold results of
    tests/regression/stereo_d_spec, in which MODEL_COORDINATES are the same in all states, and
    failed points have MATCH = SIGMA = -1 and zero displacements. Exodus II: nodal variables
    name_nod_var, vals_nod_var1, ... or vals_nod_var (SAND92-2137, appendix A).
    """
    if path.suffix.lower() in _EXODUS_SUFFIXES:
        columns, notes = _exodus_columns(path, frame)
    else:
        chosen_frame(path, frame)
        columns, notes = _text_columns(path), ()
    failed = np.zeros(len(columns[_POSITION[0]]), dtype=bool)
    if _MATCH in columns:
        failed |= columns[_MATCH] != 0.0
    if _SIGMA in columns:
        failed |= columns[_SIGMA] < 0.0
    if not {_MATCH, _SIGMA} & set(columns):
        notes += ("It has no MATCH and no SIGMA, so failed points cannot be recognised.",)
    position = np.stack([columns[name] for name in _POSITION], axis=1)
    moved = np.stack([columns[name] for name in _DISPLACEMENT], axis=1)
    score = 1.0 - 0.5 * columns[_GAMMA] if _GAMMA in columns else None
    return ProgramPoints(position, moved, failed, score=score, notes=notes)


def _check_names(path: Path, names: list[str]) -> None:
    """Refuse a result without the model coordinates and displacements of a stereo evaluation."""
    if missing := [name for name in _POSITION + _DISPLACEMENT if name not in names]:
        shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
        raise RecordError(
            f"{path}: has no {missing[0]}; it is a 2-D result, or one whose [output_spec] leaves"
            " the lengths out: add MODEL_COORDINATES_X, _Y, _Z, MODEL_DISPLACEMENT_X, _Y, _Z and"
            " MATCH to output_spec, or give the Exodus file (.e) of a stereo evaluation; it has:"
            f" {shown}"
        )


def _text_columns(path: Path) -> Columns:
    """The columns of a text file that are needed."""
    table = read_text_table(path, cure="export the points from DICe again, as text")
    if any("incremental correlation: true" in line.lower() for line in table.preamble):
        raise RecordError(
            f"{path}: its displacements are from picture to picture (incremental correlation);"
            " evaluate against the reference, use_incremental_formulation false"
        )
    _check_names(path, [column.name for column in table.columns])
    wanted = [column for column in table.columns if column.name in _USED]
    values = table.values(wanted)
    return {column.name: values[:, k] for k, column in enumerate(wanted)}


def _exodus_columns(path: Path, frame: int | None) -> tuple[Columns, tuple[str, ...]]:
    """Nodal variables of one state."""
    start = read_bytes(path, 8)
    if start != HDF5_SIGNATURE and start[:4] not in _NETCDF_CLASSIC:
        raise RecordError(
            f"{path}: is not an Exodus file in NetCDF's classic, 64-bit offset or HDF5 form;"
            " write it again, or give DICe's text files"
        )
    with read_errors(checked_file(path), "write it again, or give DICe's text files"):
        names, values = _nodal_variables(
            from_hdf5(_hdf5_arrays, path) if start == HDF5_SIGNATURE else _classic_arrays(path)
        )
    _check_names(path, names)
    count = len(values[_DISPLACEMENT[0]])
    if count == 0:
        raise RecordError(f"{path}: holds no state; was the evaluation broken off? Run it again")
    state, notes = chosen_frame(path, frame, count)
    return {name: states[state] for name, states in values.items()}, notes


def _classic_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of an Exodus file in NetCDF's classic or 64-bit offset form."""
    with netcdf_file(path, "r", mmap=False) as file:
        return {name: file.variables[name].data for name in file.variables}


def _hdf5_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of an Exodus file in NetCDF-4, that is HDF5."""
    with open_hdf5(path) as file:
        return {
            name: np.asarray(checked_size(item))
            for name, item in file.items()
            if not isinstance(item, Mapping) and name.startswith(("name_nod", "vals_nod"))
        }


def _nodal_variables(
    arrays: Mapping[str, np.ndarray],
) -> tuple[list[str], dict[str, Float[np.ndarray, "t n"]]]:
    """Names of all nodal variables, and values of those needed; in one array each, or in one array
    for all."""
    names = [
        b"".join(bytes(letter) for letter in row).split(b"\0")[0].decode("latin-1").strip()
        for row in arrays.get("name_nod_var", ())
    ]
    values = {}
    for number, name in enumerate(names, start=1):
        if name in _USED:
            in_one_array = "vals_nod_var" in arrays
            array = arrays["vals_nod_var" if in_one_array else f"vals_nod_var{number}"]
            values[name] = np.array(
                array[:, number - 1] if in_one_array else array, dtype=np.float64
            )
    return names, values


def _holds_rig(file: CalibrationFile) -> bool:
    """True for a camera system file; DICe's other XML files are parameter lists too."""
    is_list = isinstance(file.content, Element) and file.content.tag == "ParameterList"
    return is_list and bool(_sublists(file.content, "CAMERA "))


def _read_dice_rig(file: CalibrationFile) -> Rig:
    """Rig of a DICe camera system file (XML); lengths are in mm unless the caller gives a unit.

    Parameters
    ----------
    file : CalibrationFile          a parsed camera system file

    Returns
    -------
    Rig                             in the frame to which the first camera's extrinsics refer (its
                                    own if it has none); cameras are named by CAMERA_ID, or by their
                                    number if that is blank

    Raises
    ------
    CalibrationError                a missing value, an unsupported lens model or transformation, or
                                    as in `Camera` and `Rig`
    InputError                      the given unit of length is unknown
    """
    metres, root = file.metres(default="mm"), file.content
    for name in (node.get("name", "") for node in root):
        if name.startswith("user_") and "transform" in name:
            file.fail(
                f"has a '{name}', which would move the object frame; take it out, the frame is then"
                " that of the cameras' extrinsics"
            )
    chained = _values(root).get("extrinsics_relative_camera_to_camera", "false").lower() == "true"
    cameras: list[Camera] = []
    for number, node in enumerate(_sublists(root, "CAMERA ")):
        pose = _pose(file, node, metres)
        if chained and cameras:
            pose = pose @ cameras[0].T_camera_object
        cameras.append(_camera(file, node, number, pose))
    return file.rig(cameras)


def _camera(
    file: CalibrationFile, node: Element, number: int, pose: Float[np.ndarray, "4 4"]
) -> Camera:
    values = _values(node)
    name = values.get("CAMERA_ID", "").strip() or str(number)
    where = f"camera '{name}'"
    model = values.get("LENS_DISTORTION_MODEL", _LENS_MODELS[-1]).upper()
    if model not in _LENS_MODELS:
        file.fail(f"{where} has the lens model {model}; known are {', '.join(_LENS_MODELS)}")
    skew = file.number(values, "FS", where, default=0.0)
    if skew != 0.0 and model != "VIC3D_LENS_DISTORTION":
        file.fail(f"{where} has FS {skew:g}, which DICe passes over with {model}; take it out")
    lens = [file.number(values, key, where, default=0.0) for key in (*_LENS_TERMS, "T1", "T2")]
    if model == "NO_LENS_DISTORTION" and any(lens):
        file.fail(
            f"{where} has lens terms but LENS_DISTORTION_MODEL is NO_LENS_DISTORTION or missing;"
            " name the model or take the terms out"
        )
    height_width = values.get("IMAGE_HEIGHT_WIDTH")
    size = file.size(height_width and _row_entries(height_width)[::-1])
    intrinsics = [file.number(values, key, where) for key in ("FX", "FY", "CX", "CY")]
    matrix = camera_matrix(intrinsics, skew)
    return file.camera(name, size=size, matrix=matrix, distortion=lens, pose=pose)


def _pose(file: CalibrationFile, node: Element, metres: float) -> Float[np.ndarray, "4 4"]:
    """Pose x_camera of x_world, or of x of the first camera if the extrinsics are relative."""
    values, where = _values(node), node.get("name", "")
    translation = [file.number(values, key, where, default=0.0) for key in ("TX", "TY", "TZ")]
    angles = [file.number(values, key, where, default=0.0) for key in ("ALPHA", "BETA", "GAMMA")]
    rotation = rotation_from_angles(angles)
    for table in _sublists(node, "rotation_3x3_matrix"):
        table_name = f"{where}: rotation_3x3_matrix"
        rows = [_row_entries(file.entry(_values(table), f"ROW {i}", table_name)) for i in range(3)]
        rotation = np.stack([file.numbers(table_name, row, (3,)) for row in rows])
    return make_pose(rotation, metres * np.array(translation))


def _sublists(node: Element, start: str) -> list[Element]:
    """Sublists whose names begin with `start`, in the order of the numbers in their names."""
    lists = node.findall("ParameterList")
    matching = [child for child in lists if child.get("name", "").startswith(start)]
    return sorted(matching, key=lambda child: (len(child.get("name", "")), child.get("name", "")))


def _values(node: Element) -> dict[str, str]:
    return {child.get("name", ""): child.get("value", "") for child in node.findall("Parameter")}


def _row_entries(text: str) -> list[str]:
    """Entries of a text such as { 1.0, 0.0, 0.0 }."""
    return text.strip().strip("{}").split(",")


DICE = Program(
    kinds=("dice",),
    results=".txt, .e",
    read_points=_read_dice_points,
    default_unit="mm",
    min_score=MIN_CORRELATION,
    calibrations="DICe (XML)",
    holds_rig=_holds_rig,
    read_rig=_read_dice_rig,
)
