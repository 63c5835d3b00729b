"""Stereo results of DICe from text and Exodus files."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float
from scipy.io import netcdf_file

from palpate.errors import RecordError
from palpate.records.programs.measured_points import (
    MeasuredPoints,
    ProgramPoints,
    chosen_frame,
    from_program,
    metres_per_unit,
)
from palpate.records.text import read_text_table

_PROGRAM = "DICe"
_PLACE = tuple(f"MODEL_COORDINATES_{axis}" for axis in "XYZ")
_MOVE = tuple(f"MODEL_DISPLACEMENT_{axis}" for axis in "XYZ")
_MATCH, _SIGMA = "MATCH", "SIGMA"
_EXODUS_SUFFIXES = (".e", ".exo", ".ex2", ".exodus")
_HDF5 = b"\x89HDF\r\n\x1a\n"
_CLASSIC = (b"CDF\x01", b"CDF\x02")


def read_dice(
    path: Path, *, length_unit: str | None = None, frame: int | None = None
) -> MeasuredPoints:
    """Points of a stereo result of DICe: a text file per state, or one Exodus file of all states.

    Read are MODEL_COORDINATES (at rest) and MODEL_DISPLACEMENT. A point failed where MATCH is not
    0 or SIGMA is negative; its zeros are no measurement. SIGMA is in pixels, no standard deviation
    of a displacement, and is not used.

    Parameters
    ----------
    path : Path                     suffix .e .exo .ex2 .exodus: Exodus; anything else: text
    length_unit : str or None       of the calibration; mm is usual
    frame : int or None             state of an Exodus file, from 0; None: the last one

    Raises
    ------
    RecordError                     a 2-D result, displacements of an incremental correlation (from
                                    picture to picture), a cut file, text, no rows

    Source
    ------
    DICe (github.com/dicengine/dice): names in src/core/DICe_FieldEnums.h; gold results of
    tests/regression/stereo_d_spec, where MODEL_COORDINATES stay the same in all states, and failed
    points have MATCH = SIGMA = -1 and zero displacements. Exodus II: nodal variables name_nod_var,
    vals_nod_var1, ... or vals_nod_var (SAND92-2137, appendix A).
    """
    if path.suffix.lower() in _EXODUS_SUFFIXES:
        columns, notes = _exodus_columns(path, frame)
    else:
        chosen_frame(path, frame, 1)
        columns, notes = _text_columns(path), ()
    if missing := [name for name in _PLACE + _MOVE if name not in columns]:
        raise RecordError(f"{path}: has no {missing[0]}; {_why(columns)}")
    metres, unit_notes = metres_per_unit(path, found=None, given=length_unit, usual="mm")
    notes += unit_notes
    place = np.stack([columns[name] for name in _PLACE], axis=1)
    failed = np.zeros(len(place), dtype=bool)
    if _MATCH in columns:
        failed |= columns[_MATCH] != 0.0
    if _SIGMA in columns:
        failed |= columns[_SIGMA] < 0.0
    if not {_MATCH, _SIGMA} & set(columns):
        notes += ("It has no MATCH and no SIGMA, so failed points cannot be told.",)
    moved = np.stack([columns[name] for name in _MOVE], axis=1)
    given = ProgramPoints(place, moved, failed)
    return from_program(given, kind="dice", source=path, metres=metres, notes=notes)


def _why(columns: Mapping[str, object]) -> str:
    """Why the columns of a stereo result may be missing."""
    shown = ", ".join(list(columns)[:12]) + (", ..." if len(columns) > 12 else "")
    return (
        "it is a 2-D result, or one whose [output_spec] leaves the lengths out: add"
        " MODEL_COORDINATES_X, _Y, _Z, MODEL_DISPLACEMENT_X, _Y, _Z and MATCH to output_spec, or"
        f" give the Exodus file (.e) of a stereo evaluation; it has: {shown}"
    )


def _text_columns(path: Path) -> dict[str, Float[np.ndarray, " n"]]:
    """Columns of a text file; those that are not used as None would be are left empty."""
    table = read_text_table(path, program=_PROGRAM)
    for line in table.preamble:
        if "incremental correlation: true" in line.lower():
            raise RecordError(
                f"{path}: its displacements are from picture to picture (incremental correlation);"
                " evaluate against the reference, use_incremental_formulation false"
            )
    wanted = [c for c in table.columns if c.name in (*_PLACE, *_MOVE, _MATCH, _SIGMA)]
    if {*_PLACE, *_MOVE} - {column.name for column in wanted}:
        return {column.name: np.zeros(0) for column in table.columns}
    values = table.values(wanted)
    return {column.name: values[:, k] for k, column in enumerate(wanted)}


@dataclass(frozen=True, slots=True)
class _Exodus:
    """What is needed of an Exodus file: names and values of the nodal variables."""

    names: tuple[str, ...]
    values: Mapping[str, Float[np.ndarray, "t n"]]


def _exodus_columns(
    path: Path, frame: int | None
) -> tuple[dict[str, Float[np.ndarray, " n"]], tuple[str, ...]]:
    """Nodal variables of one state."""
    try:
        with path.open("rb") as file:
            start = file.read(8)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from error
    if start == _HDF5:
        exodus = _from_hdf5(path)
    elif start[:4] in _CLASSIC:
        exodus = _from_classic(path)
    else:
        raise RecordError(
            f"{path}: is not an Exodus file in NetCDF's classic, 64-bit offset or HDF5 form;"
            " write it again, or give DICe's text files"
        )
    if not {*_PLACE, *_MOVE} <= set(exodus.names):
        return {name: np.zeros(0) for name in exodus.names}, ()
    count = len(exodus.values[_MOVE[0]])
    if count == 0:
        raise RecordError(f"{path}: holds no state; was the evaluation broken off? Run it again")
    state, notes = chosen_frame(path, frame, count)
    return {name: values[state] for name, values in exodus.values.items()}, notes


def _from_classic(path: Path) -> _Exodus:
    """Nodal variables of an Exodus file in NetCDF's classic or 64-bit offset form."""
    try:
        with netcdf_file(path, "r", mmap=False) as file:
            return _nodal({name: file.variables[name].data for name in file.variables})
    except (OSError, ValueError, TypeError, LookupError, AssertionError, EOFError) as error:
        raise RecordError(_broken(path, error)) from error


def _from_hdf5(path: Path) -> _Exodus:
    """Nodal variables of an Exodus file in NetCDF-4, that is HDF5."""
    try:
        with h5py.File(path) as file:
            arrays = {
                name: np.asarray(item)
                for name, item in file.items()
                if isinstance(item, h5py.Dataset) and name.startswith(("name_nod", "vals_nod"))
            }
        return _nodal(arrays)
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise RecordError(_broken(path, error)) from error


def _nodal(arrays: Mapping[str, np.ndarray]) -> _Exodus:
    """The wanted variables, from one array each or from one for all."""
    letters = np.asarray(arrays["name_nod_var"]) if "name_nod_var" in arrays else np.zeros((0, 0))
    names = tuple(
        b"".join(bytes(letter) for letter in row).split(b"\0")[0].decode("latin-1").strip()
        for row in letters
    )
    values = {}
    for number, name in enumerate(names, start=1):
        if name not in (*_PLACE, *_MOVE, _MATCH, _SIGMA):
            continue
        if "vals_nod_var" in arrays:
            found = arrays["vals_nod_var"][:, number - 1]
        else:
            found = arrays[f"vals_nod_var{number}"]
        values[name] = np.array(found, dtype=np.float64)
    return _Exodus(names, values)


def _broken(path: Path, error: Exception) -> str:
    return f"{path}: is damaged or cut off ({error}); write it again, or give DICe's text files"
