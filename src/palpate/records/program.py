"""Interface to other programs whose files are read: calibrations, displacements, or both.

Their files are XML, YAML, JSON, TOML or text, distinguished by content and suffix, or HDF5.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar, cast
from xml.etree import ElementTree

import numpy as np
import yaml
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.arrays import LARGEST_NUMBER
from palpate.errors import CalibrationError, InputError, RecordError, quoted
from palpate.files import checked_file, max_unpacked_size, read_bytes, read_errors
from palpate.foreign import result_in_child
from palpate.optional_imports import late_import
from palpate.records.quantities import FILE_LENGTH_UNITS
from palpate.records.rig import DISTORTION_TERMS, Camera, PictureTracks, Rig
from palpate.records.text.toml_table import not_allowed, read_toml
from palpate.shapes import Flags, Matrix3, Points, PointScalars, Vector3

# Largest error of a rotation matrix that counts as rounding in print; `Camera` refuses larger ones.
_MAX_PRINTED_ERROR = 1e-6
# Zero-mean normalised cross-correlation below which a match is rejected: at this value a quarter of
# the grey-level variance of the subsets is noise, or another surface.
MIN_CORRELATION = 0.75
_TREE_SUFFIXES = (".yml", ".yaml", ".json", ".xml")
# Largest YAML file [bytes]: it is parsed at 0.1 megabyte a second; calibrations have kilobytes.
_MAX_BYTES = 2**20
# Deepest nesting of brackets: the parser's time grows quadratically; matrices need two.
_MAX_NESTING = 50
_CURE = "export the calibration again"
T = TypeVar("T")
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True, slots=True)
class CalibrationFile:
    """Calibration file of another program, parsed once; its errors name the file.

    Parameters
    ----------
    path : Path                     a file, or a folder with a file per camera
    content : Element, dict, str or None    of XML; of YAML, JSON or TOML; of any other text; None
                                    for a folder and for MATLAB files, which their reader opens
    length_unit : str or None       m, cm, mm or in, as given by the caller
    """

    path: Path
    content: Any
    length_unit: str | None = None

    @classmethod
    def read(cls, path: Path, length_unit: str | None = None) -> "CalibrationFile":
        """Read and parse a file, whichever program wrote it.

        Parameters
        ----------
        path : Path                     a file, or a folder with a file per camera
        length_unit : str or None       m, cm, mm or in, as given by the caller

        Raises
        ------
        RecordError                 missing, not text, malformed XML, YAML, JSON or TOML
        """
        binary = path.is_dir() or path.suffix.lower() == ".mat"
        if path.suffix.lower() == ".toml":
            return cls(path, read_toml(path).values, length_unit)
        return cls(path, None if binary else _read_tree(path), length_unit)

    def files_in_folder(self) -> "list[CalibrationFile]":
        """The YAML, JSON and XML files in this folder, by name; RecordError: one is unreadable."""
        files = sorted(f for f in self.path.iterdir() if f.suffix.lower() in _TREE_SUFFIXES)
        return [CalibrationFile(file, _read_tree(file), self.length_unit) for file in files]

    def fail(self, what: str) -> NoReturn:
        """Raise a `CalibrationError` about this file."""
        raise CalibrationError(f"{self.path}: {what}")

    def metres(self, *, default: str | None, stated: Any = None) -> float:
        """Length of the file's unit [m].

        Parameters
        ----------
        default : str or None       unit of files of this kind; None: there is no default unit
        stated : any                unit stated in the file, if any; takes precedence over the
                                    caller's

        Raises
        ------
        InputError                  unknown unit
        CalibrationError            no unit is given anywhere
        """
        given = default if self.length_unit is None else self.length_unit
        unit = str(stated) if stated else given
        allowed = ", ".join(FILE_LENGTH_UNITS)
        if unit is None:
            self.fail(
                "does not say the unit of its translations; add the line 'length_unit: mm' to the"
                f" file (allowed: {allowed}): it is the unit that the squares of the calibration"
                " target were given in"
            )
        if unit not in FILE_LENGTH_UNITS:
            wrong = not_allowed(unit, tuple(FILE_LENGTH_UNITS))
            raise InputError(f"{self.path}: length_unit is {wrong}")
        return FILE_LENGTH_UNITS[unit]

    def numbers(self, what: str, values: Any, shape: tuple[int, ...] | None) -> np.ndarray:
        """Convert values of the file to an array of finite numbers.

        Parameters
        ----------
        what : str                  what they are, for the message
        values : numbers or texts
        shape : tuple of int or None    wanted shape, to which a flat list is reshaped; None: flat,
                                    of any length

        Returns
        -------
        array of that shape, float

        Raises
        ------
        CalibrationError            not numbers, not finite, wrong count
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
        """Value of a required key.

        Parameters
        ----------
        table : mapping
        key : str
        where : str                 what the table is, for the message

        Raises
        ------
        CalibrationError            the key is missing
        """
        if key not in table:
            self.fail(f"{where} has no '{key}'; it must be given: export the calibration again")
        return table[key]

    def number(
        self, table: Mapping[str, Any], key: str, where: str, *, default: float | None = None
    ) -> float:
        """One finite number of a table.

        Parameters
        ----------
        table, key, where           as in `entry`
        default : float or None     default if the key is missing; None: the key is required

        Raises
        ------
        CalibrationError            a required key is missing, or not a finite number
        """
        if default is not None and key not in table:
            return default
        return float(self.numbers(f"{key} of {where}", self.entry(table, key, where), ()))

    def size(self, given: Any) -> tuple[int, int] | None:
        """Columns and rows of the pictures [px], if the file gives them.

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
        """Make a camera; errors name this file.

        Parameters
        ----------
        name, matrix, distortion, pose, size    as in `Camera`; distortion terms beyond the eighth
                                    must be zero

        Raises
        ------
        CalibrationError            as `Camera`, or an unsupported lens model
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
        """Make a rig of this file's cameras.

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
    """Points and displacements as written by a program, in its own unit and frame.

    Parameters
    ----------
    points : (n, 3) float           at rest
    displacement : (n, 3) float
    failed : (n,) bool or None      points that the program itself marks as failed
    std : (n, 3) float or None      one standard deviation of the displacement
    unit : str or None              of length, if the file states it
    notes : tuple of str            what was left out, in sentences about the file
    score : (n,) float or None      zero-mean normalised cross-correlation of each point's worst
                                    match, at most 1; NaN where unknown
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
    """One program, and how its files are recognised and read.

    Parameters
    ----------
    kinds : tuple of str            names in `palpate import`; empty if it gives no displacements
    results : str                   its result files, for the help
    read_points : callable or None  (path, frame) -> ProgramPoints; frame is the index, from 0, of
                                    the state in files with several; None: the last one
    read_tracks : callable or None  (path, frame) -> PictureTracks, for results in pixels
    default_unit : str or None      unit of results that state none; None: the user must give it
    min_score : float or None       matches with a lower `ProgramPoints.score` are rejected; None:
                                    its files hold no correlation
    correlates : bool               its displacements come from image correlation, so a point that
                                    contradicts all its neighbours is a false match
    calibrations : str              its calibration files, for messages
    holds_rig : callable or None    whether a CalibrationFile was written by this program
    read_rig : callable or None     CalibrationFile -> Rig
    """

    kinds: tuple[str, ...] = ()
    results: str = ""
    read_points: Callable[[Path, int | None], ProgramPoints] | None = None
    read_tracks: Callable[[Path, int | None], PictureTracks] | None = None
    default_unit: str | None = None
    min_score: float | None = None
    correlates: bool = True
    calibrations: str = ""
    holds_rig: Callable[[CalibrationFile], bool] | None = None
    read_rig: Callable[[CalibrationFile], Rig] | None = None


def chosen_frame(path: Path, frame: int | None, count: int = 1) -> tuple[int, tuple[str, ...]]:
    """Index of the state to read; the last one by default.

    Parameters
    ----------
    path : Path                     for messages
    frame : int or None             index from 0, negative from the end; None: the last
    count : int                     number of states in the file, at least 1

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


def camera_matrix(intrinsics: Sequence[float] | np.ndarray, skew: float = 0.0) -> Matrix3:
    """Camera matrix [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] from fx, fy, cx, cy.

    Parameters
    ----------
    intrinsics : 4 floats [px]      fx, fy > 0, cx, cy
    skew : float [px]

    Returns
    -------
    (3, 3) float [px]
    """
    fx, fy, cx, cy = intrinsics
    return np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def rotation_from_angles(degrees: Sequence[float] | Vector3) -> Matrix3:
    """Rotation Rz Ry Rx from angles about x, y and z, the convention of VIC-3D, DICe and MatchID.

    Parameters
    ----------
    degrees : 3 floats [deg]        about x (applied first), y, z

    Returns
    -------
    (3, 3) float
    """
    return Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()


def make_pose(rotation: Matrix3, translation: Vector3) -> Float[np.ndarray, "4 4"]:
    """Homogeneous matrix of x -> rotation x + translation; rounding in the rotation is removed.

    Parameters
    ----------
    rotation : (3, 3) float         left unchanged if it is not a rotation: `Camera` refuses it
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
    """The rotation nearest to an almost orthogonal matrix, by singular value decomposition.

    Parameters
    ----------
    matrix : (3, 3) float           determinant > 0

    Returns
    -------
    (3, 3) float
    """
    left, _, right = np.linalg.svd(matrix)
    return left @ right


def _read_tree(path: Path) -> ElementTree.Element | dict[str, Any] | str:
    """Parsed content of an XML, YAML or JSON file; the text of any other.

    Parameters
    ----------
    path : Path                     YAML and JSON must have a suffix of `_TREE_SUFFIXES`

    Returns
    -------
    Element, dict or str            root of XML, mapping of YAML or JSON, else the text

    Raises
    ------
    RecordError                     missing, not text, malformed XML or YAML, a duplicate key, an
                                    alias
    """
    data = read_bytes(path)
    if data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        with read_errors(path, _CURE, what="is not valid XML"):
            return ElementTree.fromstring(data.lstrip())
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordError(
            f"{path}: is not a text file in UTF-8, and no calibration of a known program"
        ) from error
    if path.suffix.lower() not in _TREE_SUFFIXES:
        return text
    # OpenCV's first line (%YAML:1.0) is not valid YAML.
    body = text.partition("\n")[2] if text.startswith("%YAML") else text
    checked_file(path, max_bytes=_MAX_BYTES)
    with read_errors(path, _CURE, what="is not valid YAML"):
        root = yaml.load(body, Loader=_Loader)  # a SafeLoader: plain values only
    return root if isinstance(root, dict) else text


class _Loader(yaml.SafeLoader):
    """Plain values, and OpenCV's matrices as mappings; refuses duplicate keys, deep nesting and
    aliases."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """A node; aliases are refused, since nested ones can expand to billions of values."""
        if self.check_event(yaml.AliasEvent):
            alias = self.peek_event()
            raise ValueError(
                f"line {alias.start_mark.line + 1}: '*{alias.anchor}' stands for another value;"
                " write out the value itself"
            )
        return super().compose_node(parent, index)

    def fetch_flow_collection_start(self, token: type[yaml.Token]) -> None:
        """An opening bracket; refused beyond a nesting depth that no calibration has."""
        if self.flow_level == _MAX_NESTING:
            line = self.get_mark().line + 1
            raise ValueError(f"line {line}: more than {_MAX_NESTING} brackets are open")
        super().fetch_flow_collection_start(token)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """A mapping; duplicate keys, which YAML forbids but the parser accepts, are refused."""
        keys = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in keys:
                raise ValueError(f"line {key.start_mark.line + 1}: '{key.value}' is there twice")
            keys.add(str(key.value))
        return super().construct_mapping(node, deep=deep)


for _kind in ("opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(
        f"tag:yaml.org,2002:{_kind}", lambda loader, node: loader.construct_mapping(node, deep=True)
    )


def from_hdf5(use: Callable[..., T], path: Path, *arguments: Any) -> T:
    """What a function makes of an HDF5 file, in a child: the library may crash on a damaged one.

    Parameters
    ----------
    use : callable                  of a module; gets the path and the arguments
    path : Path
    *arguments                      that can be pickled, like the result

    Raises
    ------
    InputError                      h5py is not installed
    RuntimeError                    as in `results_in_child`
    """
    late_import("h5py", extra="hdf5", purpose=f"reading {path.name}")
    return cast(T, result_in_child(use, path, *arguments))


def open_hdf5(path: Path) -> Any:
    """Open an HDF5 file for reading, in a child.

    Parameters
    ----------
    path : Path

    Returns
    -------
    h5py.File                       to be closed: `with open_hdf5(path) as file`

    Raises
    ------
    InputError                      h5py is not installed
    OSError                         not an HDF5 file
    """
    return late_import("h5py", extra="hdf5", purpose=f"reading {path.name}").File(path)


def checked_size(array: Any) -> Any:
    """Return a data set that is not yet loaded, after checking its size, which a header may forge.

    Parameters
    ----------
    array : h5py.Dataset

    Raises
    ------
    ValueError                      more numbers than any measurement has
    """
    if math.prod(array.shape) * array.dtype.itemsize > max_unpacked_size(
        array.id.get_storage_size()
    ):
        raise ValueError(f"it claims an array of {' x '.join(map(str, array.shape))} numbers")
    return array
