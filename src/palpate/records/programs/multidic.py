"""Calibrations and stereo results of MultiDIC and DuoDIC, from MATLAB's files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Float
from scipy.io import loadmat, whosmat
from scipy.linalg import rq

from palpate.errors import RecordError
from palpate.files import checked_file, damage, read_bytes
from palpate.records.program import (
    HDF5_MARK,
    LEAST_CORRELATION,
    CalibrationFile,
    Program,
    ProgramPoints,
    checked_size,
    chosen_frame,
    make_pose,
)
from palpate.records.rig import Camera, Rig

_PLACES, _SCORES = "Points3D", "corrComb"
_MARK = b"MATLAB 5.0 MAT-file"
_MARK_HDF5 = b"MATLAB 7.3 MAT-file"
_PATTERN = "DLTstruct_cam_*.mat"
_PAIRS_HINT = f"give the folder with its files {_PATTERN}, or one of them"

# Points of a calibration object, and the pixels where one camera sees them.
ControlPoints = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]


def read_multidic_points(path: Path, frame: int | None = None) -> ProgramPoints:
    """Points of a 3-D reconstruction by MultiDIC or DuoDIC.

    The file holds a struct (DIC3D, DIC3Dcombined, DIC3DPPresults, DIC3DpairResults, ...) with
    Points3D, a cell of one n x 3 array per picture; the first is the state at rest. The
    displacement is the difference, as their Disp.DispVec is. NaN marks points that were not
    matched; where that is so at rest, they have no place either. Where there is corrComb, Ncorr's
    criterion of the worse camera (the sum of squared differences of two windows of zero mean and
    unit length), the score is 1 - corrComb / 2.

    Parameters
    ----------
    path : Path                     .mat, version 5 to 7.3
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
    states, criteria = _states(path)
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
    score = None
    if len(criteria) == len(states):
        # The first picture agrees with itself, which is NaN.
        score = 1.0 - 0.5 * np.fmax(criteria[0], criteria[state]).ravel()
        if len(score) != len(states[0]):
            raise RecordError(
                f"{path}: corrComb has {len(score)} values for {len(states[0])} points;"
                " reconstruct them again"
            )
    return ProgramPoints(states[0], states[state] - states[0], score=score, notes=notes)


def _states(path: Path) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The arrays of Points3D, in time, and those of corrComb where it is there."""
    start = read_bytes(path, 520)
    with damage(path, "save it again in MATLAB"):
        if start.startswith(_MARK_HDF5) or HDF5_MARK in (start[:8], start[512:520]):
            return _states_from_hdf5(path)
        if start.startswith(_MARK):
            return _states_from_version_5(path)
    raise RecordError(f"{path}: is not a MATLAB file of version 5 to 7.3; save it again in MATLAB")


def _states_from_hdf5(path: Path) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Cells of a file of version 7.3, which is HDF5: arrays are transposed, cells are links."""
    with h5py.File(path) as file:
        present = [name for name in file if not name.startswith("#")]
        groups = [name for name in present if isinstance(file[name], h5py.Group)]
        name = _only_struct(path, [name for name in groups if _PLACES in file[name]], present)
        links = [np.asarray(file[name].get(key, [])).ravel() for key in (_PLACES, _SCORES)]
        places, scores = (
            [np.asarray(checked_size(file[link]), dtype=np.float64).T for link in cell]
            for cell in links
        )
        return places, scores


def _states_from_version_5(path: Path) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Cells of a file of version 5 to 7."""
    kinds = {name: kind for name, _, kind in whosmat(path) if not name.startswith("__")}
    structs = [name for name, kind in kinds.items() if kind == "struct"]
    content = loadmat(path, variable_names=structs, simplify_cells=True)
    found = [name for name in structs if isinstance(content[name], dict)]
    name = _only_struct(path, [name for name in found if _PLACES in content[name]], list(kinds))
    found = [content[name].get(key, np.array([], dtype=object)) for key in (_PLACES, _SCORES)]
    # A cell of one state comes as that state.
    cells = [cell.ravel() if cell.dtype == object else [cell] for cell in map(np.asarray, found)]
    places, scores = ([np.asarray(state, dtype=np.float64) for state in cell] for cell in cells)
    return places, scores


def _only_struct(path: Path, names: Sequence[str], present: Sequence[str]) -> str:
    """The struct with a 3-D result; a file with none or with several is refused."""
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
    return names[0]


def _holds_rig(file: CalibrationFile) -> bool:
    return file.path.suffix.lower() == ".mat" or any(file.path.glob(_PATTERN))


def read_multidic_rig(file: CalibrationFile) -> Rig:
    """Rig of all direct linear transformations in a folder, in the frame of the calibration object.

    column = (L1 X + L2 Y + L3 Z + L4) / (L9 X + L10 Y + L11 Z + 1), row with L5 to L8, X in mm,
    pixels counted from 1 as in MATLAB. Eleven numbers, as many as a pinhole camera with skew has:
    nothing is lost, but there is no lens.

    Parameters
    ----------
    file : CalibrationFile          the folder, or any of its files DLTstruct_cam_*.mat

    Returns
    -------
    Rig                             cameras named by their number, sizes not known, no lens

    Raises
    ------
    RecordError                     a file that cannot be read as such
    CalibrationError                numbers of no camera, or one that looks away from the object
    """
    metres = file.metres(usual="mm")
    return file.rig([_camera(camera, metres) for camera in _transformations(file.path)])


def read_control_points(path: Path | str) -> tuple[ControlPoints, ...]:
    """What the transformations were computed from, so that the lens can be found too.

    Parameters
    ----------
    path : path                     the folder, or any of its files DLTstruct_cam_*.mat

    Returns
    -------
    tuple of points, pixels         one pair per camera, in the order of the rig: (n, 3) float [m],
                                    from MultiDIC's millimetres; (n, 2) float [px], column and row,
                                    the first pixel's centre is (0, 0)

    Raises
    ------
    RecordError, CalibrationError   as `read_multidic_rig`
    """
    pairs = [_control(file) for file in _transformations(Path(path))]
    return tuple((1e-3 * points, pixels) for points, pixels in pairs)


def _transformations(path: Path) -> list[CalibrationFile]:
    """The files of all cameras in a folder, which is given itself or by one of them."""
    folder = path if path.is_dir() else path.parent
    files = sorted(folder.glob(_PATTERN), key=lambda file: (len(file.name), file.name))
    if not path.is_dir() and path not in files:
        raise RecordError(
            f"{path}: is not a camera's transformation of MultiDIC; {_PAIRS_HINT} (in"
            " DLTstructPairs.mat the lens is a MATLAB object, which only MATLAB can read)"
        )
    return [CalibrationFile(file, _content(file)) for file in files]


def _content(path: Path) -> dict[str, Any]:
    """Fields of the one structure in a MATLAB file."""
    what = "is no MATLAB file of version 5 to 7.2"
    with damage(checked_file(path), "save it with '-v7'", what=what):
        variables = loadmat(path, squeeze_me=True, simplify_cells=True)
    for value in variables.values():
        if isinstance(value, dict) and "DLTparams" in value and "indCam" in value:
            return value
    names = [name for name in variables if not name.startswith("__")]
    raise RecordError(
        f"{path}: holds no transformation (DLTparams, indCam) but {', '.join(names) or 'nothing'};"
        f" {_PAIRS_HINT}"
    )


def _camera(file: CalibrationFile, metres: float) -> Camera:
    terms = file.numbers("DLTparams", file.content["DLTparams"], (11,))
    projection = np.append(terms, 1.0).reshape(3, 4)
    # Of the two signs the one for which the rotation is one.
    projection *= np.sign(np.linalg.det(projection[:, :3])) or 1.0
    if np.linalg.matrix_rank(projection[:, :3]) < 3:
        file.fail(f"DLTparams {terms.tolist()} are of no camera (rank below 3)")
    matrix, rotation = rq(projection[:, :3])
    signs = np.diag(np.sign(np.diag(matrix)))
    matrix, rotation = matrix @ signs, signs @ rotation
    translation = np.linalg.solve(matrix, projection[:, 3])
    if "C3Dtrue" in file.content:
        points, _ = _control(file)
        behind = int(np.sum(points @ rotation[2] + translation[2] <= 0.0))
        if behind:
            file.fail(
                f"{behind} of {len(points)} points of the calibration object are behind the"
                " camera: its coordinates are left-handed, or the picture is mirrored"
            )
    matrix /= matrix[2, 2]
    # Rounding; K is triangular by construction.
    matrix[np.tril_indices(3, -1)] = 0.0
    matrix[:2, 2] -= 1.0
    pose = make_pose(rotation, metres * translation)
    return file.camera(str(file.content["indCam"]), matrix=matrix, distortion=(), pose=pose)


def _control(file: CalibrationFile) -> ControlPoints:
    """Points of the columns that the camera saw, in the file's unit, and their pixels from 0."""
    where = "MultiDIC's transformation"
    table = np.asarray(file.entry(file.content, "C3Dtrue", where), dtype=np.float64)
    columns = np.atleast_1d(file.entry(file.content, "columns", where)).astype(np.int64) - 1
    pixels = np.asarray(file.entry(file.content, "imageCentroids", where), dtype=np.float64)
    fits = table.ndim == 3 and columns.min() >= 0 and columns.max() < table.shape[1]
    if not fits or pixels.shape != (table.shape[0] * len(columns), 2):
        file.fail(
            f"imageCentroids {pixels.shape} do not belong to the {len(columns)} columns of C3Dtrue"
            f" {table.shape}"
        )
    return table[:, columns].transpose(1, 0, 2).reshape(-1, 3), pixels - 1.0


MULTIDIC = Program(
    kinds=("multidic", "duodic"),
    results=".mat",
    read_points=read_multidic_points,
    usual_unit="mm",
    least_score=LEAST_CORRELATION,
    calibrations=f"MultiDIC ({_PATTERN})",
    holds_rig=_holds_rig,
    read_rig=read_multidic_rig,
)
