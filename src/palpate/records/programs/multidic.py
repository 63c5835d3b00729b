"""Calibrations and stereo results of MultiDIC and DuoDIC, from MATLAB's files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import rq

from palpate.errors import RecordError
from palpate.records.program import (
    MIN_CORRELATION,
    CalibrationFile,
    Program,
    ProgramPoints,
    checked_size,
    chosen_frame,
    make_pose,
)
from palpate.records.programs.matlab import of_mat, open_mat, read_mat
from palpate.records.rig import Camera, PictureTracks, Rig

_POSITIONS, _PIXELS = "Points3D", "Points"
_PATTERN = "DLTstruct_cam_*.mat"
_PAIRS_HINT = f"give the folder with its files {_PATTERN}, or one of them"

# Points of a calibration object, and their positions in the picture of one camera.
ControlPoints = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]


def _read_multidic_points(path: Path, frame: int | None) -> ProgramPoints:
    """Points of a 3-D reconstruction by MultiDIC or DuoDIC.

    The file holds a struct (DIC3D, DIC3Dcombined, DIC3DPPresults, DIC3DpairResults, ...) with
    Points3D, a cell array with one n x 3 array per picture, the first at rest. The displacement is
    the difference of two states, as in Disp.DispVec. NaN marks points that were not matched; if NaN
    at rest, they have no position either. If there is a field corrComb, Ncorr's criterion of the
    worse camera (the sum of squared differences of two subsets normalised to zero mean and unit
    length), the score is 1 - corrComb / 2.

    Parameters
    ----------
    path : Path                     .mat, version 5 to 7.3
    frame : int or None             state, from 0 (at rest); None: the last one

    Raises
    ------
    RecordError                     2-D results of step 2, several such structs, a truncated file
    InputError                      h5py is not installed, for an HDF5 file

    Source
    ------
    MultiDIC (github.com/MultiDIC/MultiDIC), main_scripts/STEP3_3Dreconstruction.m and
    STEP4_PostProcessing.m: Disp.DispVec{ii} = Points3D{ii} - Points3D{1}; DuoDIC
    (github.com/SolavLab/DuoDIC), DuoDIC_STEP3_3D_reconstruction.m, saved with -v7.3.
    """
    states, criteria = of_mat(_cells, path, (_POSITIONS, "corrComb"), "3-D result (step 3 or 4)")
    if len(states) < 2:
        raise RecordError(
            f"{path}: Points3D holds {len(states)} state; the first is the rest, so a displacement"
            " needs at least two"
        )
    _check_arrays(path, _POSITIONS, states, 3, "give the results of step 3 or 4")
    state, notes = chosen_frame(path, frame, len(states))
    score = _score(path, criteria, (0, state), states) if criteria else None
    return ProgramPoints(states[0], states[state] - states[0], score=score, notes=notes)


def _read_multidic_tracks(path: Path, frame: int | None) -> PictureTracks:
    """Matched points in the pictures of two cameras, by Ncorr, from MultiDIC or DuoDIC.

    The file holds a struct (DIC2DpairResults) with Points, a cell array with one n x 2 array per
    picture, column and row counted from 1: all pictures of the first camera, the first at rest,
    then all of the second. CorCoeffVec is Ncorr's criterion, like corrComb in 3-D results.

    Parameters
    ----------
    path : Path                     .mat, version 5 to 7.3
    frame : int or None             state, from 0 (at rest); None: the last one

    Returns
    -------
    PictureTracks                   cameras named by their numbers, if the file has them

    Raises
    ------
    RecordError                     no such struct, or several, a truncated file
    InputError                      h5py is not installed, for an HDF5 file

    Source
    ------
    DuoDIC, DuoDIC_STEP2_2DDIC_using_Ncorr.m and lib_DuoDIC/extractNcorrResults.m.
    """
    keys = (_PIXELS, "CorCoeffVec", "nCamRef", "nCamDef")
    pixels, criteria, *numbers = of_mat(_cells, path, keys, "2-D result (step 2)")
    count = len(pixels) // 2
    if count < 2 or len(pixels) % 2:
        raise RecordError(
            f"{path}: Points holds {len(pixels)} pictures; must be two or more, rest first, of each"
            " of two cameras"
        )
    _check_arrays(path, _PIXELS, pixels, 2, "give the results of step 2")
    state, notes = chosen_frame(path, frame, count)
    used = (0, state, count, count + state)
    score = _score(path, criteria, used, pixels) if criteria else None
    names = [f"{float(n[0].ravel()[0]):g}" for n in numbers if n and n[0].size]
    return PictureTracks(
        rest=np.stack([pixels[0], pixels[count]]) - 1.0,
        loaded=np.stack([pixels[state], pixels[count + state]]) - 1.0,
        cameras=tuple(names),
        score=score,
        notes=notes,
    )


def _check_arrays(
    path: Path, key: str, arrays: Sequence[np.ndarray], columns: int, cure: str
) -> None:
    """Refuse arrays that do not all have the same shape, n x columns."""
    if len({array.shape for array in arrays}) > 1 or arrays[0].ndim != 2:
        raise RecordError(f"{path}: the arrays of {key} differ in size; evaluate them again")
    if arrays[0].shape[1] != columns:
        raise RecordError(
            f"{path}: the arrays of {key} are n x {arrays[0].shape[1]}; must be n x {columns}:"
            f" {cure}"
        )


def _score(
    path: Path, criteria: Sequence[np.ndarray], used: Sequence[int], points: Sequence[np.ndarray]
) -> Float[np.ndarray, " n"]:
    """Lowest correlation over some pictures, from Ncorr's criterion; NaN where unknown."""
    sizes = {array.size for array in criteria}
    if len(criteria) != len(points) or sizes != {len(points[0])}:
        raise RecordError(
            f"{path}: its {len(criteria)} arrays of correlation ({', '.join(map(str, sizes))}"
            f" values) do not belong to {len(points)} of {len(points[0])} points; evaluate them"
            " again"
        )
    # The criterion of a picture with itself is NaN: take the largest of the finite ones.
    return 1.0 - 0.5 * np.fmax.reduce([criteria[i].ravel() for i in used])


def _cells(path: Path, keys: Sequence[str], what: str) -> list[list[np.ndarray]]:
    """Arrays of some cell arrays, from the only struct that has the first; empty where missing."""
    with open_mat(path) as content:
        struct = content[_only_struct(path, keys[0], what, content)]
        return [_arrays(struct[key]) if key in struct else [] for key in keys]


def _arrays(cell: Any) -> list[np.ndarray]:
    """The arrays of a cell array; one of a single array may be that array itself."""
    if not hasattr(cell, "file"):
        values = np.asarray(cell)
        items = values if values.dtype == object else [values]
        return [np.asarray(item, dtype=np.float64) for item in items]
    # Version 7.3: cells are references; the size of an array is checked before it is loaded.
    sets = [cell]
    if cell.dtype == object:
        sets = [cell.file[link] for link in np.asarray(cell).ravel(order="F")]
    return [np.asarray(checked_size(item), dtype=np.float64).T for item in sets]


def _only_struct(path: Path, key: str, what: str, content: Mapping[str, Any]) -> str:
    """Name of the only struct with a field; a file with none or several is refused."""
    structs = [name for name, item in content.items() if isinstance(item, Mapping)]
    names = [name for name in structs if key in content[name]]
    if len(names) == 1:
        return names[0]
    if names:
        raise RecordError(
            f"{path}: holds several structs with {key} ({', '.join(names)}); save one of them in a"
            " file of its own"
        )
    is_planar = key == _POSITIONS and any(_PIXELS in content[name] for name in structs)
    cure = (
        "it is the 2-D result of step 2: name the calibration of its cameras with --rig, or give"
        " the 3-D result (step 3 or 4)"
        if is_planar
        else f"give the file of the {what}"
    )
    raise RecordError(f"{path}: has no struct with {key}: {cure}; it has: {', '.join(content)}")


def _holds_rig(file: CalibrationFile) -> bool:
    return file.path.suffix.lower() == ".mat" or any(file.path.glob(_PATTERN))


def _read_multidic_rig(file: CalibrationFile) -> Rig:
    """Rig of all direct linear transformations in a folder, in the frame of the calibration object.

    column = (L1 X + L2 Y + L3 Z + L4) / (L9 X + L10 Y + L11 Z + 1), row with L5 to L8, X in mm,
    pixels counted from 1 as in MATLAB. The eleven parameters are equivalent to a pinhole camera
    with skew, without lens distortion.

    Parameters
    ----------
    file : CalibrationFile          the folder, or any of its files DLTstruct_cam_*.mat

    Returns
    -------
    Rig                             cameras named by their numbers; no distortion, sizes unknown

    Raises
    ------
    RecordError                     not a readable file of this kind
    CalibrationError                parameters of no camera, or a camera that faces away from the
                                    object
    InputError                      the given unit of length is unknown
    """
    metres = file.metres(default="mm")
    return file.rig([_camera(camera, metres) for camera in _transformations(file.path)])


def read_control_points(path: Path | str) -> tuple[ControlPoints, ...]:
    """Control points from which the transformations were computed; they allow for fitting the
    distortion too.

    Parameters
    ----------
    path : path                     the folder, or any of its files DLTstruct_cam_*.mat

    Returns
    -------
    tuple of (points, pixels)       one pair per camera, in the order of the rig: (n, 3) float [m],
                                    from MultiDIC's millimetres; (n, 2) float [px], column and row,
                                    the first pixel's centre is (0, 0)

    Raises
    ------
    RecordError, CalibrationError   as in `_read_multidic_rig`
    """
    pairs = [_control_points(file) for file in _transformations(Path(path))]
    return tuple((1e-3 * points, pixels) for points, pixels in pairs)


def _transformations(path: Path) -> list[CalibrationFile]:
    """The files of all cameras in a folder; the path is the folder or one of these files."""
    folder = path if path.is_dir() else path.parent
    files = sorted(folder.glob(_PATTERN), key=lambda file: (len(file.name), file.name))
    if not path.is_dir() and path not in files:
        raise RecordError(
            f"{path}: is not a camera's transformation of MultiDIC; {_PAIRS_HINT} (in"
            " DLTstructPairs.mat the lens is a MATLAB object, which only MATLAB can read)"
        )
    return [CalibrationFile(file, _read_transformation(file)) for file in files]


def _read_transformation(path: Path) -> dict[str, Any]:
    """Fields of the transformation's structure in a MATLAB file."""
    what = "is no MATLAB file of version 5 to 7.2"
    variables = read_mat(path, what=what, cure="save it with '-v7'", squeeze_me=True)
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
    # The projection is defined up to its sign: choose the one that gives a proper rotation.
    projection *= np.sign(np.linalg.det(projection[:, :3])) or 1.0
    if np.linalg.matrix_rank(projection[:, :3]) < 3:
        file.fail(f"DLTparams {terms.tolist()} are of no camera (rank below 3)")
    matrix, rotation = rq(projection[:, :3])
    signs = np.diag(np.sign(np.diag(matrix)))
    matrix, rotation = matrix @ signs, signs @ rotation
    translation = np.linalg.solve(matrix, projection[:, 3])
    if "C3Dtrue" in file.content:
        points, _ = _control_points(file)
        behind = int(np.sum(points @ rotation[2] + translation[2] <= 0.0))
        if behind:
            file.fail(
                f"{behind} of {len(points)} points of the calibration object are behind the"
                " camera: its coordinates are left-handed, or the picture is mirrored"
            )
    matrix /= matrix[2, 2]
    # Remove rounding errors: K is triangular by construction.
    matrix[np.tril_indices(3, -1)] = 0.0
    matrix[:2, 2] -= 1.0
    pose = make_pose(rotation, metres * translation)
    return file.camera(str(file.content["indCam"]), matrix=matrix, distortion=(), pose=pose)


def _control_points(file: CalibrationFile) -> ControlPoints:
    """Points of the columns seen by the camera, in the file's unit, and their pixels from 0."""
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
    read_points=_read_multidic_points,
    read_tracks=_read_multidic_tracks,
    default_unit="mm",
    min_score=MIN_CORRELATION,
    calibrations=f"MultiDIC ({_PATTERN})",
    holds_rig=_holds_rig,
    read_rig=_read_multidic_rig,
)
