"""Stereo results of MultiDIC and DuoDIC from MATLAB files."""

import zlib
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
from scipy.io import loadmat, whosmat

from palpate.errors import RecordError
from palpate.records.programs.measured_points import (
    MeasuredPoints,
    ProgramPoints,
    chosen_frame,
    from_program,
    metres_per_unit,
)

_PLACES = "Points3D"
_HDF5 = b"\x89HDF\r\n\x1a\n"
# What the readers run into where bytes are missing or wrong.
_DAMAGE = (OSError, ValueError, TypeError, LookupError, RuntimeError, EOFError, zlib.error)
_MARK = b"MATLAB 5.0 MAT-file"
_MARK_HDF5 = b"MATLAB 7.3 MAT-file"


def read_multidic(
    path: Path, *, length_unit: str | None = None, frame: int | None = None
) -> MeasuredPoints:
    """Points of a 3-D reconstruction by MultiDIC or DuoDIC.

    The file holds a struct (DIC3D, DIC3Dcombined, DIC3DPPresults, DIC3DpairResults, ...) with
    Points3D, a cell of one n x 3 array per picture; the first is the state at rest. The
    displacement is the difference, as their Disp.DispVec is. NaN marks points that were not
    matched; where that is so at rest, they have no place either.

    Parameters
    ----------
    path : Path                     .mat, version 5 to 7.3
    length_unit : str or None       of the calibration; mm is usual
    frame : int or None             state, from 0 (the rest); None: the last one

    Raises
    ------
    RecordError                     2-D results of step 2, several such structs, a cut file

    Source
    ------
    MultiDIC (github.com/MultiDIC/MultiDIC), main_scripts/STEP3_3Dreconstruction.m and
    STEP4_PostProcessing.m: Disp.DispVec{ii} = Points3D{ii} - Points3D{1}; DuoDIC
    (github.com/SolavLab/DuoDIC), DuoDIC_STEP3_3D_reconstruction.m, saved with -v7.3.
    """
    states = _states(path)
    if len(states) < 2:
        raise RecordError(
            f"{path}: Points3D holds {len(states)} state; the first is the rest, so a displacement"
            " needs at least two"
        )
    if len({state.shape for state in states}) > 1 or states[0].ndim != 2:
        raise RecordError(f"{path}: the arrays of Points3D differ in size; reconstruct them again")
    if states[0].shape[1] != 3:
        raise RecordError(
            f"{path}: the arrays of Points3D are n x {states[0].shape[1]}; must be n x 3: give the"
            " results of step 3 or 4"
        )
    state, notes = chosen_frame(path, frame, len(states))
    metres, unit_notes = metres_per_unit(path, found=None, given=length_unit, usual="mm")
    given = ProgramPoints(
        states[0], states[state] - states[0], np.zeros(len(states[0]), dtype=bool)
    )
    return from_program(
        given, kind="multidic", source=path, metres=metres, notes=notes + unit_notes
    )


def _states(path: Path) -> list[np.ndarray]:
    """The arrays of Points3D, in time."""
    try:
        with path.open("rb") as file:
            start = file.read(520)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from error
    try:
        if start.startswith(_MARK_HDF5) or _HDF5 in (start[:8], start[512:520]):
            return _from_hdf5(path)
        if start.startswith(_MARK):
            return _from_version_5(path)
    except RecordError:
        raise
    except _DAMAGE as error:
        raise RecordError(
            f"{path}: is damaged or cut off ({error}); save it again in MATLAB"
        ) from error
    raise RecordError(f"{path}: is not a MATLAB file of version 5 to 7.3; save it again in MATLAB")


def _from_hdf5(path: Path) -> list[np.ndarray]:
    """Points3D of a file of version 7.3, which is HDF5: arrays are transposed, cells are links."""
    with h5py.File(path) as file:
        names = [
            name
            for name, item in file.items()
            if isinstance(item, h5py.Group) and not name.startswith("#") and _PLACES in item
        ]
        _check_names(path, names, [name for name in file if not name.startswith("#")])
        cell = file[names[0]][_PLACES]
        links = np.asarray(cell).ravel(order="F")
        return [np.asarray(file[link], dtype=np.float64).T for link in links]


def _from_version_5(path: Path) -> list[np.ndarray]:
    """Points3D of a file of version 5 to 7."""
    present = [name for name, _, kind in whosmat(path) if kind == "struct"]
    content = loadmat(path, variable_names=present, simplify_cells=True)
    names = [name for name in present if isinstance(content[name], dict)]
    names = [name for name in names if _PLACES in content[name]]
    _check_names(path, names, [name for name, _, _ in whosmat(path) if not name.startswith("__")])
    cell = np.asarray(content[names[0]][_PLACES])
    # A cell of one state comes as that state.
    states = cell.ravel() if cell.dtype == object else [cell]
    return [np.asarray(state, dtype=np.float64) for state in states]


def _check_names(path: Path, names: Sequence[str], present: Sequence[str]) -> None:
    """Refuse a file without a 3-D result, or with several."""
    if len(names) > 1:
        raise RecordError(
            f"{path}: holds several structs with Points3D ({', '.join(names)}); save one of them"
            " in a file of its own"
        )
    if not names:
        why = (
            "it is the 2-D result of step 2"
            if any("2D" in name for name in present)
            else "it is no result of step 3"
        )
        raise RecordError(
            f"{path}: has no struct with Points3D: {why}; give the file of the 3-D reconstruction"
            f" (DIC3D..., step 3 or 4); it has: {', '.join(present)}"
        )
