"""What Palpate asks of a program whose files it reads: a calibration, displacements, or both."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.arrays import LARGEST_NUMBER
from palpate.errors import CalibrationError, InputError, RecordError, quoted
from palpate.records.quantities import FILE_LENGTH_UNITS
from palpate.records.rig import DISTORTION_TERMS, Camera, PictureTracks, Rig
from palpate.records.text import TREE_SUFFIXES, nearest_word, read_toml, read_tree
from palpate.shapes import Flags, Matrix3, Points, PointScalars, Vector3

# A printed rotation is this far from one at most; `Camera` refuses what is farther.
_MAX_PRINTED_ERROR = 1e-6
# Zero-mean normalised correlation below which a match is not believed: of what differs between two
# windows of this one, noise (or another surface) has a quarter.
LEAST_CORRELATION = 0.75
HDF5_MARK = b"\x89HDF\r\n\x1a\n"
# A billion numbers are eight gigabytes.
_MOST_NUMBERS = 10**9


@dataclass(frozen=True, slots=True)
class CalibrationFile:
    """A calibration of another program: its content, parsed once, and complaints that name it.

    Parameters
    ----------
    path : Path                     a file, or a folder with a file per camera
    content : Element, dict, str or None    of XML; of YAML or JSON; of any other text; None for a
                                    folder and for MATLAB's files, which their reader opens itself
    length_unit : str or None       m, cm, mm or in, as the caller says
    """

    path: Path
    content: Any
    length_unit: str | None = None

    @classmethod
    def read(cls, path: Path, length_unit: str | None = None) -> "CalibrationFile":
        """A file with its content, whichever program wrote it.

        Parameters
        ----------
        path : Path                     a file, or a folder with a file per camera
        length_unit : str or None       m, cm, mm or in, as the caller says

        Raises
        ------
        RecordError                 not there, not text, broken XML or YAML
        """
        binary = path.is_dir() or path.suffix.lower() == ".mat"
        if path.suffix.lower() == ".toml":
            return cls(path, read_toml(path).values, length_unit)
        return cls(path, None if binary else read_tree(path), length_unit)

    def beside(self) -> "list[CalibrationFile]":
        """The YAML, JSON and XML files in this folder, by name."""
        files = sorted(f for f in self.path.iterdir() if f.suffix.lower() in TREE_SUFFIXES)
        return [CalibrationFile(file, read_tree(file), self.length_unit) for file in files]

    def fail(self, what: str) -> NoReturn:
        """Raise a `CalibrationError` about this file."""
        raise CalibrationError(f"{self.path}: {what}")

    def metres(self, *, usual: str | None, stated: str | None = None) -> float:
        """Length of the file's unit [m].

        Parameters
        ----------
        usual : str or None         unit of files of this kind; None: they may be in any
        stated : str or None        unit that the file itself names; it counts before the caller's

        Raises
        ------
        InputError                  not a known unit
        CalibrationError            the unit is not given anywhere
        """
        unit = stated or (usual if self.length_unit is None else self.length_unit)
        allowed = ", ".join(FILE_LENGTH_UNITS)
        if unit is None:
            self.fail(
                "does not say the unit of its translations; add the line 'length_unit: mm' to the"
                f" file (allowed: {allowed}): it is the unit that the squares of the calibration"
                " target were given in"
            )
        if unit not in FILE_LENGTH_UNITS:
            near = nearest_word(unit, tuple(FILE_LENGTH_UNITS))
            raise InputError(f"{self.path}: length_unit is '{unit}'{near} (allowed: {allowed})")
        return FILE_LENGTH_UNITS[unit]

    def numbers(self, what: str, values: Any, shape: tuple[int, ...] | None) -> np.ndarray:
        """Finite numbers of the file.

        Parameters
        ----------
        what : str                  what they are, for the message
        values : numbers or texts
        shape : tuple of int or None    wanted; a list of as many numbers is brought to it. None: a
                                    flat list of any length

        Returns
        -------
        array of that shape, float

        Raises
        ------
        CalibrationError            not numbers, not finite, another count
        """
        try:
            if isinstance(values, bool):
                raise TypeError
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise CalibrationError(
                f"{self.path}: {what} is {quoted(values)}; must be numbers"
            ) from error
        if not (np.abs(array) <= LARGEST_NUMBER).all():
            self.fail(
                f"{what} is {quoted(array.tolist())}; must be finite, {LARGEST_NUMBER:g} at most"
            )
        if shape is None:
            return array.ravel()
        if array.size != int(np.prod(shape)):
            wanted = " x ".join(str(size) for size in shape)
            self.fail(f"{what} has {array.size} numbers; must have {wanted}")
        return array.reshape(shape)

    def entry(self, table: Mapping[str, Any], key: str, where: str) -> Any:
        """Value of a key that must be there.

        Parameters
        ----------
        table : mapping
        key : str
        where : str                 what the table is, for the message

        Raises
        ------
        CalibrationError            it is not there
        """
        if key not in table:
            self.fail(f"{where} has no '{key}'; it must be given: export the calibration again")
        return table[key]

    def number(
        self, table: Mapping[str, Any], key: str, where: str, *, missing: float | None = None
    ) -> float:
        """One finite number of a table.

        Parameters
        ----------
        table, key, where           as `entry`
        missing : float or None     stands in where the key is not there; None: it must be

        Raises
        ------
        CalibrationError            not there and nothing stands in, or no finite number
        """
        if missing is not None and key not in table:
            return missing
        return float(self.numbers(f"{key} of {where}", self.entry(table, key, where), ()))

    def size(self, given: Any) -> tuple[int, int] | None:
        """Columns and rows of the pictures [px], where the file says them.

        Parameters
        ----------
        given : 2 numbers or None       columns, rows

        Raises
        ------
        CalibrationError            not two numbers
        """
        if given is None:
            return None
        columns, rows = self.numbers("image size", given, (2,))
        return int(columns), int(rows)

    def camera(
        self,
        name: str,
        *,
        matrix: Matrix3,
        distortion: Sequence[float] | np.ndarray,
        pose: Float[np.ndarray, "4 4"],
        size: tuple[int, int] | None = None,
    ) -> Camera:
        """A camera whose complaints name its file.

        Parameters
        ----------
        name, matrix, distortion, pose, size    as `Camera`; terms beyond the eighth must be zero

        Raises
        ------
        CalibrationError            as `Camera`, or a lens model that is not known
        """
        terms = np.asarray(distortion, dtype=np.float64).ravel()
        known = len(DISTORTION_TERMS)
        if np.any(terms[known:] != 0.0):
            self.fail(
                f"camera '{name}' has {terms.size} distortion terms; only the first {known}"
                f" ({' '.join(DISTORTION_TERMS)}) are known, no thin prism and no tilted sensor:"
                " calibrate again without them"
            )
        try:
            return Camera(name, size, matrix, terms[:known], pose)
        except InputError as error:
            raise CalibrationError(f"{self.path}: {error}") from error

    def rig(self, cameras: Sequence[Camera], *, reference: int = 0) -> Rig:
        """The cameras of this file; the first one is the reference if nothing else is said.

        Parameters
        ----------
        cameras : sequence of Camera
        reference : int                 index of the reference camera

        Raises
        ------
        CalibrationError            as `Rig`
        """
        return Rig(tuple(cameras), reference, str(self.path))


@dataclass(frozen=True, slots=True, eq=False)
class ProgramPoints:
    """Points and displacements as a program wrote them: its unit, its own signs of failure.

    Parameters
    ----------
    points : (n, 3) float           at rest
    displacement : (n, 3) float
    failed : (n,) bool or None      what the program itself says it could not measure
    std : (n, 3) float or None      one standard deviation of the displacement
    unit : str or None              of length, where the file names it
    notes : tuple of str            what was left out, in sentences about the file
    score : (n,) float or None      zero-mean normalised correlation of each point's worst match, 1
                                    at best; NaN where it is not known
    """

    points: Points
    displacement: Points
    failed: Flags | None = None
    std: Points | None = None
    unit: str | None = None
    notes: tuple[str, ...] = ()
    score: PointScalars | None = None


@dataclass(frozen=True, slots=True)
class Program:
    """One program, and how its files are told apart and read.

    Parameters
    ----------
    kinds : tuple of str            names in `palpate import`; none where it gives no displacements
    results : str                   its result files, for the help
    read_points : callable or None  (path, frame) -> ProgramPoints; frame is the state, from 0, in
                                    files of several; None: the last one
    read_tracks : callable or None  (path, frame) -> PictureTracks, of results not yet in space
    usual_unit : str or None        of results that name none; None: the user must say it
    least_score : float or None     matches of a lower `ProgramPoints.score` are no measurements;
                                    None: its files tell no correlation
    correlates : bool               its displacements come from matched pictures, and a point that
                                    contradicts all around it is a mistake
    calibrations : str              its calibration files, for messages
    holds_rig : callable or None    whether a CalibrationFile is of this program
    read_rig : callable or None     CalibrationFile -> Rig
    """

    kinds: tuple[str, ...] = ()
    results: str = ""
    read_points: Callable[[Path, int | None], ProgramPoints] | None = None
    read_tracks: Callable[[Path, int | None], PictureTracks] | None = None
    usual_unit: str | None = None
    least_score: float | None = None
    correlates: bool = True
    calibrations: str = ""
    holds_rig: Callable[[CalibrationFile], bool] | None = None
    read_rig: Callable[[CalibrationFile], Rig] | None = None


def chosen_frame(path: Path, frame: int | None, count: int = 1) -> tuple[int, tuple[str, ...]]:
    """Number of the state to read, from 0; the last one where none is asked for.

    Parameters
    ----------
    path : Path                     for messages
    frame : int or None             negative ones count from the end
    count : int                     states in the file, at least 1

    Raises
    ------
    RecordError                     there is no such state
    """
    if frame is None:
        if count == 1:
            return 0, ()
        note = f"It holds {count} states; the last, frame {count - 1}, was read (--frame)."
        return count - 1, (note,)
    if not -count <= frame < count:
        raise RecordError(
            f"{path}: has no frame {frame}; it holds {count}"
            + (", so leave --frame out" if count == 1 else f", numbered 0 to {count - 1}")
        )
    return frame % count, ()


def checked_size(array: Any) -> Any:
    """An array of a file that is not yet read, if it can be: a header may claim any size.

    Parameters
    ----------
    array : with a shape

    Raises
    ------
    ValueError                      more numbers than any measurement has
    """
    if math.prod(array.shape) > _MOST_NUMBERS:
        raise ValueError(f"it claims an array of {' x '.join(map(str, array.shape))} numbers")
    return array


def camera_matrix(inner: Sequence[float] | np.ndarray, skew: float = 0.0) -> Matrix3:
    """Intrinsic matrix [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] of fx fy cx cy, all in pixels.

    Parameters
    ----------
    inner : 4 floats [px]           fx, fy > 0, cx, cy
    skew : float [px]

    Returns
    -------
    (3, 3) float [px]
    """
    fx, fy, cx, cy = inner
    return np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def rotation_from_angles(degrees: Sequence[float] | Vector3) -> Matrix3:
    """Rotation Rz Ry Rx from the angles about x, y and z, as VIC-3D, DICe and MatchID give it.

    Parameters
    ----------
    degrees : 3 floats [deg]        about x (applied first), y, z

    Returns
    -------
    (3, 3) float
    """
    return Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()


def make_pose(rotation: Matrix3, translation: Vector3) -> Float[np.ndarray, "4 4"]:
    """Rigid motion x -> rotation x + translation; a rotation rounded in print is made exact.

    Parameters
    ----------
    rotation : (3, 3) float         left as it is where it is no rotation: `Camera` will say so
    translation : (3,) float [m]

    Returns
    -------
    (4, 4) float
    """
    if np.abs(rotation @ rotation.T - np.eye(3)).max() <= _MAX_PRINTED_ERROR:
        rotation = nearest_rotation(rotation)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def nearest_rotation(matrix: Matrix3) -> Matrix3:
    """The orthogonal matrix nearest to one that nearly is, by the singular value decomposition.

    Parameters
    ----------
    matrix : (3, 3) float           determinant > 0

    Returns
    -------
    (3, 3) float
    """
    left, _, right = np.linalg.svd(matrix)
    return left @ right
