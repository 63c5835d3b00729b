"""Views of an object, each measured from one viewpoint, and `scan.toml`, which lists them.

Views are point clouds (PLY, PCD, E57, NPY, XYZ and other columns of text), depth maps of RGB-D
cameras and range scanners, or pictures of several cameras. Their poses are given, estimated from
the surface they share, or follow from the turntable that rotates the object.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palpate.arrays import fixed_array
from palpate.errors import InputError, RecordError
from palpate.files import checked_file, parse_array, read_bytes, read_errors
from palpate.foreign import result_in_child, scans_of_e57
from palpate.optional_imports import late_import
from palpate.progress import Progress, silent
from palpate.records import (
    LENGTH_UNITS,
    Camera,
    Rig,
    TomlTable,
    camera_centre,
    read_import_pose,
    read_rig,
    read_toml,
)
from palpate.scanning.plane import Plane, plane_from_text
from palpate.shapes import Points, PointScalars, Vector3
from palpate.vision import (
    StereoSettings,
    normalised,
    prepare_pictures,
    read_pictures,
    read_stored,
    stereo_points,
)

SCAN_FORMAT = "palpate-scan/1"
SCAN_FILE = "scan.toml"
_KEYS = ("format", "length_unit", "sigma", "support", "depth", "rig", "turntable", "view")
_VIEW_KEYS = ("file", "images", "pose", "angle", "eye")
Pose = Float[np.ndarray, "4 4"]
# Neighbours in its own view, itself included, that define a point's tangent plane.
_NEIGHBOURS = 24
_MIN_POINTS = 50
_POINT_SUFFIXES = (".ply", ".pcd", ".e57", ".npy", ".xyz", ".txt", ".csv", ".asc")
_MAX_POINT_BYTES = 2**30
# Smallest plausible extent and largest plausible coordinate [m]; otherwise the unit is wrong.
_SPAN = (1e-6, 1e4)
_PCD_TYPES = {"F": "f", "I": "i", "U": "u"}
_DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".npy")
_MAX_DEPTH_BYTES = 2**28
# Plausible range of depth [m].
_NEAREST, _FARTHEST = 0.02, 30.0
# More points per view add nothing for a mesh of some thousand vertices.
_MAX_POINTS = 20_000
# Neighbouring pixels whose depths differ by more than this fraction lie on two surfaces.
_JUMP = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Points of the surface measured from one viewpoint.

    Parameters
    ----------
    name : str
    points : (n, 3) float [m]       frame of the view
    normals : (n, 3) float          unit, towards the viewpoint
    sigma : (n,) float [m]          standard deviation along the normal, > 0
    eye : (3,) float [m]            viewpoint, frame of the view
    T_object_view : (4, 4) float [m] or None    None if unknown
    correlation_length : float [m]  distance within which errors of points are correlated; 0: they
                                    are independent
    """

    name: str
    points: Points
    normals: Points
    sigma: PointScalars
    eye: Vector3
    T_object_view: Pose | None = None
    correlation_length: float = 0.0

    def placed(self, pose: Pose) -> "View":
        """Transform points, normals and viewpoint by a pose.

        Parameters
        ----------
        pose : (4, 4) float [m]     x_new = pose x_view

        Returns
        -------
        View                        its pose is the identity
        """
        turn, shift = pose[:3, :3], pose[:3, 3]
        return replace(
            self,
            points=self.points @ turn.T + shift,
            normals=self.normals @ turn.T,
            eye=turn @ self.eye + shift,
            T_object_view=np.eye(4),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """The views of one object.

    Attributes
    ----------
    path : Path                     of scan.toml
    views : tuple of View           all with a pose, or all without
    support : Plane or None         in the object's frame
    files : tuple of Path           all files that were read
    """

    path: Path
    views: tuple[View, ...]
    support: Plane | None
    files: tuple[Path, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Setup:
    """Settings shared by all views."""

    folder: Path
    unit: float
    sigma: float | None
    camera: Camera | None
    metres_per_level: float
    rig: Rig | None
    # A point on its axis [m], and its direction, in the frame of the scanner.
    turntable: tuple[Vector3, Vector3] | None


def read_scan(path: Path, *, progress: Progress = silent) -> Scan:
    """Read a scan and convert every view to points with normals.

    Parameters
    ----------
    path : Path                     scan.toml, or its folder
    progress : callable

    Returns
    -------
    Scan

    Raises
    ------
    RecordError                     a file is missing or damaged, or a key unknown or missing
    InputError                      a view has too few points
    """
    file = path / SCAN_FILE if path.is_dir() else path
    table = read_toml(file)
    table.check_keys(_KEYS)
    table.choice("format", (SCAN_FORMAT,))
    setup, files = _setup(table)
    tables = table.tables("view")
    if not tables:
        table.fail("", "holds no [[view]]")
    views = []
    for k, view_table in enumerate(tables):
        progress(f"view {k + 1} of {len(tables)}", k / len(tables))
        view, view_files = _view(view_table, k, setup)
        if "file" in view_table.values and view_files[-1] in files:
            view_table.fail(
                "file", f"{view_files[-1].name} is another view already; name each once"
            )
        views.append(view)
        files += view_files
    posed = [view.T_object_view is not None for view in views]
    if any(posed) and not all(posed):
        name = views[posed.index(False)].name
        table.fail("", f"view '{name}' has no pose and others have; give all of them one, or none")
    support = None
    if "support" in table.values:
        support = plane_from_text(table.text("support"), metres_per_unit=setup.unit)
    return Scan(file, tuple(views), support, (file, *files))


def _setup(table: TomlTable) -> tuple[_Setup, list[Path]]:
    folder, files = table.file.parent, []
    unit = LENGTH_UNITS[table.choice("length_unit", tuple(LENGTH_UNITS))]
    sigma = table.optional("sigma", table.number)
    camera, level, rig, turntable = None, 1.0, None, None
    if "depth" in table.values:
        depth = table.table("depth")
        depth.check_keys(("camera", "distortion", "scale"))
        camera, level = _depth_camera(depth), depth.number("scale") * unit
        if not level > 0.0:
            depth.fail("scale", f"is {depth.number('scale'):g}; must be positive")
    if "rig" in table.values:
        rigs = table.table("rig")
        rigs.check_keys(("cameras",))
        files.append(rigs.existing_file("cameras"))
        rig = read_rig(files[-1])
    if "turntable" in table.values:
        turn = table.table("turntable")
        turn.check_keys(("point", "axis"))
        axis = turn.vector("axis")
        if not axis.any():
            turn.fail("axis", "is zero; give a direction")
        turntable = unit * turn.vector("point"), axis / np.linalg.norm(axis)
    noise = None if sigma is None else sigma * unit
    return _Setup(folder, unit, noise, camera, level, rig, turntable), files


def _depth_camera(table: TomlTable) -> Camera:
    given = table.get("camera")
    if not (isinstance(given, list) and len(given) == 4):
        table.fail("camera", "must be four numbers in pixels: [fx, fy, cx, cy]")
    distortion = table.values.get("distortion", [])
    with table.error_context():
        try:
            fx, fy, cx, cy = (float(x) for x in given)
            terms = np.array(distortion, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError("camera and distortion must be numbers") from error
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        return Camera("depth", None, matrix, terms, np.eye(4))


def _view(table: TomlTable, number: int, setup: _Setup) -> tuple[View, list[Path]]:
    table.check_keys(_VIEW_KEYS)
    if ("file" in table.values) == ("images" in table.values):
        table.fail("", "must have a file (points or a depth map) or images, one of them")
    pose, files = _pose(table, setup)
    if "images" in table.values:
        view, view_files = _stereo_view(table, setup, pose)
        return view, [*files, *view_files]
    file = table.existing_file("file")
    eye = table.optional("eye", table.vector)
    make: Callable[..., View] = partial(
        make_view, file.name, sigma=setup.sigma, eye=None if eye is None else setup.unit * eye
    )
    if file.suffix.lower() in _DEPTH_SUFFIXES and setup.camera is not None:
        points = depth_points(file, setup.camera, metres_per_level=setup.metres_per_level)
    elif file.suffix.lower() in _POINT_SUFFIXES:
        points = read_points(file, metres_per_unit=setup.unit)
    else:
        table.fail("file", f"is {file.name}; a depth map needs a [depth] table with its camera")
    with table.error_context():
        return make(points, pose=pose), [*files, file]


def _pose(table: TomlTable, setup: _Setup) -> tuple[Pose | None, list[Path]]:
    if "pose" in table.values:
        file = table.existing_file("pose")
        return read_import_pose(file)[0], [file]
    if "angle" in table.values:
        if setup.turntable is None:
            table.fail("angle", "needs a [turntable] with its point and axis")
        # Undo the rotation of the table: the object's frame is that of the view at angle 0.
        point, axis = setup.turntable
        pose = np.eye(4)
        turn = Rotation.from_rotvec(-np.radians(table.number("angle")) * axis)
        pose[:3, :3] = turn.as_matrix()
        pose[:3, 3] = point - pose[:3, :3] @ point
        return pose, []
    return None, []


def _stereo_view(table: TomlTable, setup: _Setup, pose: Pose | None) -> tuple[View, list[Path]]:
    """View made of stereo points of one instant, in the rig's frame, and its picture files."""
    if setup.rig is None:
        table.fail("images", "need a [rig] with its cameras")
    pattern = table.text("images")
    read = read_pictures(setup.rig, pattern, folder=setup.folder, what=f"view '{pattern}'")
    points = stereo_points(prepare_pictures(setup.rig, read.grey))
    reference = setup.rig.cameras[setup.rig.reference]
    files = [setup.folder / pattern.replace("{camera}", c.name) for c in setup.rig.cameras]
    view = make_view(
        pattern.replace("{camera}", reference.name), points.point, eye=camera_centre(reference),
        pose=pose,
    )  # fmt: skip
    along = np.einsum("na,nab,nb->n", view.normals, points.covariance, view.normals)
    # The noise of overlapping windows is correlated up to their width.
    width = StereoSettings().subset * float(np.median(points.spacing)) / points.step
    return replace(view, sigma=np.sqrt(along), correlation_length=width), files


def make_view(
    name: str,
    points: Points,
    *,
    sigma: PointScalars | float | None = None,
    eye: Vector3 | None = None,
    pose: Pose | None = None,
) -> View:
    """Make a view from points, estimating normals and, if not given, noise from neighbours.

    Parameters
    ----------
    name : str
    points : (n, 3) float [m]       frame of the view
    sigma : (n,) or float [m] or None   standard deviation along the normal; None: the median
                                    scatter of neighbours about their tangent plane, which includes
                                    curvature
    eye : (3,) float [m] or None    viewpoint; None: the origin of the view's frame
    pose : (4, 4) float [m] or None T_object_view

    Returns
    -------
    View

    Raises
    ------
    InputError                      fewer than 50 points; collinear points; sigma not positive
    """
    points = fixed_array(points, name=f"points of view '{name}'", shape=(None, 3))
    if len(points) < _MIN_POINTS:
        raise InputError(f"view '{name}' has {len(points)} points; it needs {_MIN_POINTS} or more")
    eye = np.zeros(3) if eye is None else np.asarray(eye, dtype=np.float64)
    _, near = cKDTree(points).query(points, k=_NEIGHBOURS)
    offset = points[near] - points[near].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nka,nkb->nab", offset, offset) / _NEIGHBOURS)
    if not np.median(values[:, 1]) > 1e-8 * np.median(values[:, 2]):
        raise InputError(f"the points of view '{name}' lie on lines; a surface needs area")
    normals = vectors[:, :, 0]
    away = np.einsum("na,na->n", normals, eye - points) < 0.0
    normals = np.where(away[:, None], -normals, normals)
    if sigma is None:
        scatter = np.sqrt(np.maximum(values[:, 0], 0.0))
        sigma = np.full(len(points), max(float(np.median(scatter)), 1e-9))
    sigma = np.broadcast_to(np.asarray(sigma, dtype=np.float64), len(points)).copy()
    if not sigma.min() > 0.0:
        raise InputError(f"sigma of view '{name}' goes down to {sigma.min():g}; must be positive")
    extent = float(np.ptp(points, axis=0).max())
    if sigma.max() > extent:
        raise InputError(
            f"sigma of view '{name}' reaches {sigma.max():g} m; its points are {extent:.3g} m"
            " across: check the unit"
        )
    return View(name, points, normals, sigma, eye, pose)


def read_points(path: Path, *, metres_per_unit: float = 1.0) -> Points:
    """Read a point cloud in metres, without points marked as not measured.

    Parameters
    ----------
    path : Path                     .ply .pcd .e57 .npy, or text with columns x y z: .xyz .txt .csv
                                    .asc
    metres_per_unit : float         length unit of the file [m], > 0; E57 is always in metres

    Returns
    -------
    (n, 3) float [m]                n > 0; rows that are not finite are left out, and rows at
                                    0, 0, 0 if there is more than one

    Raises
    ------
    RecordError                     the file is missing, not readable, of an unknown type, has no
                                    points, or an implausible size
    InputError                      the optional package for E57 is missing
    """
    suffix = path.suffix.lower()
    if suffix not in _POINT_SUFFIXES:
        raise RecordError(
            f"{path}: point files of type '{suffix}' are not read; convert it to one of"
            f" {' '.join(_POINT_SUFFIXES)}"
        )
    content = read_bytes(path, max_bytes=_MAX_POINT_BYTES)
    if suffix == ".e57":
        late_import("pye57", extra="e57", purpose=f"reading {path.name}")
        metres_per_unit = 1.0
    what = f"cannot be read as points of type {suffix[1:].upper()}"
    with read_errors(path, "three columns x y z of text are read, too", what=what):
        points = np.asarray(_read(path, content, suffix), dtype=np.float64)
        if points.ndim != 2 or points.shape[1] < 3:
            raise ValueError(f"its numbers have the shape {points.shape}, not three columns")
    points = points[:, :3]
    points = points[np.isfinite(points).all(axis=1)]
    # Scanners write the origin for rays without a return.
    nothing = (points == 0.0).all(axis=1)
    points = points[~nothing] if nothing.sum() > 1 else points
    if len(points) == 0:
        raise RecordError(f"{path}: holds no points with three finite coordinates")
    points = points * metres_per_unit
    span, farthest = float(np.ptp(points, axis=0).max()), float(abs(points).max())
    if farthest > _SPAN[1] or (len(points) > 1 and span < _SPAN[0]):
        raise RecordError(
            f"{path}: its points are {span:.3g} m across, up to {farthest:.3g} m from the origin;"
            f" an object must be {_SPAN[0]:g} m across or more, within {_SPAN[1]:g} m: check the"
            " unit"
        )
    return points


def _read(path: Path, content: bytes, suffix: str) -> np.ndarray:
    if suffix == ".e57":
        return _e57(path)
    if suffix == ".npy":
        return parse_array(content)
    if suffix == ".pcd":
        return _pcd(content)
    if suffix == ".ply":
        trimesh = late_import("trimesh", extra=None, purpose="reading a PLY")
        loaded = trimesh.load(BytesIO(content), file_type="ply", process=False)
        return np.asarray(loaded.vertices)
    return _text(content.decode("utf-8", errors="replace"))


def _e57(path: Path) -> Float[np.ndarray, "n 3"]:
    """The only scan of a file, in the file's frame, without points marked as invalid."""
    count, points = result_in_child(scans_of_e57, path)
    if count != 1:
        raise ValueError(
            f"it has {count} scans, each from a place of its own; export each as a file, and give"
            " each its [[view]]"
        )
    return np.asarray(points)


def _text(text: str) -> Float[np.ndarray, "n 3"]:
    """The first three columns, below any heading; separated by blanks, commas or semicolons."""
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if len(words) < 3:
            continue
        try:
            # Python's float would accept 1_0 as ten.
            rows.append([float(word.replace("_", "?")) for word in words[:3]])
        except ValueError:
            # Headings stand above the first row.
            if rows:
                raise ValueError(f"line {number}: '{line[:40]}' is no row of numbers") from None
    return np.array(rows).reshape(-1, 3)


def _pcd(content: bytes) -> Float[np.ndarray, "n 3"]:
    """Point Cloud Library's format, as text or binary; compressed data are not read.

    Source: https://pointclouds.org/documentation/tutorials/pcd_file_format.html
    """
    head, _, rest = content.partition(b"\nDATA ")
    kind, _, data = rest.partition(b"\n")
    field = {}
    for line in head.decode("ascii", errors="replace").splitlines():
        word, _, value = line.partition(" ")
        field[word] = value.split()
    names, sizes, types = field["FIELDS"], field["SIZE"], field["TYPE"]
    counts = [int(word) for word in field.get("COUNT", ["1"] * len(names))]
    if kind.strip() == b"ascii":
        lines = data.decode().replace("_", "?").splitlines()
        table = np.array([line.split() for line in lines if line.strip()])
        first = np.cumsum([0, *counts[:-1]])
        return table[:, [first[names.index(axis)] for axis in "xyz"]].astype(np.float64)
    if kind.strip() != b"binary":
        raise ValueError(f"its data are {kind.strip().decode()!r}; save it as ascii or binary")
    layout = np.dtype(
        [
            (f"{name}_{k}", f"<{_PCD_TYPES[kind_]}{size}", (count,))
            for k, (name, kind_, size, count) in enumerate(
                zip(names, types, sizes, counts, strict=True)
            )
        ]
    )
    table = np.frombuffer(data, layout, int(field["POINTS"][0]))
    columns = [names.index(axis) for axis in "xyz"]
    return np.stack([table[f"{names[k]}_{k}"][:, 0] for k in columns], axis=1).astype(np.float64)


def depth_points(path: Path, camera: Camera, *, metres_per_level: float) -> Points:
    """Points of a depth map in the camera's frame, z along its axis.

    Pixels that are zero, not finite, or beside a discontinuity of depth are left out. If more than
    20 000 remain, only every k-th row and column is used.

    Parameters
    ----------
    path : Path                     16-bit PNG or TIFF, or NPY: depth along the axis
    camera : Camera
    metres_per_level : float        depth per grey level [m], usually 0.001

    Returns
    -------
    (n, 3) float [m]

    Raises
    ------
    RecordError                     the file is missing, not readable, or not of the camera's size;
                                    it has no depths, or their median is not between 0.02 and 30 m
    """
    depth = _levels(path) * metres_per_level
    if camera.size is not None and depth.shape[::-1] != camera.size:
        size = "{} x {}".format(*camera.size)
        raise RecordError(
            f"{path}: has {depth.shape[1]} x {depth.shape[0]} pixels, the camera {size}"
        )
    seen = np.isfinite(depth) & (depth > 0.0)
    if not seen.any():
        raise RecordError(f"{path}: no pixel holds a depth; 0 means not measured")
    middle = float(np.median(depth[seen]))
    if not _NEAREST <= middle <= _FARTHEST:
        raise RecordError(
            f"{path}: its middle depth is {middle:.3g} m; cameras measure {_NEAREST:g} to"
            f" {_FARTHEST:g} m: check the scale, {metres_per_level:g} m a level here (most cameras"
            " write millimetres: 0.001 m)"
        )
    seen &= ~_beside_jump(depth, seen)
    step = max(1, int(np.ceil(np.sqrt(seen.sum() / _MAX_POINTS))))
    rows, columns = np.nonzero(seen[::step, ::step])
    pixels = step * np.stack([columns, rows], axis=1).astype(np.float64)
    z = depth[::step, ::step][rows, columns]
    return np.column_stack([normalised(camera, pixels) * z[:, None], z])


def _levels(path: Path) -> Float[np.ndarray, "rows columns"]:
    with read_errors(path, "write it again", what="cannot be read as a depth map"):
        checked_file(path, max_bytes=_MAX_DEPTH_BYTES)
        if path.suffix.lower() == ".npy":
            levels = parse_array(read_bytes(path))
        else:
            levels, _ = read_stored(path, "depth map", None)
        if levels.ndim != 2:
            raise ValueError("it must be one number a pixel")
        if levels.dtype == np.uint8:
            raise ValueError("it has 8 bits a pixel; depth needs 16")
        return np.asarray(levels, dtype=np.float64)


def _beside_jump(depth: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Pixels beside a discontinuity of depth, whose values may mix two surfaces."""
    beside = np.zeros_like(seen)
    for axis in (0, 1):
        first, second = (
            np.take(depth, range(depth.shape[axis] - 1), axis),
            np.take(depth, range(1, depth.shape[axis]), axis),
        )
        known = np.take(seen, range(depth.shape[axis] - 1), axis) & np.take(
            seen, range(1, depth.shape[axis]), axis
        )
        jump = known & (abs(first - second) > _JUMP * np.minimum(first, second))
        pad = [(0, 0), (0, 0)]
        pad[axis] = (0, 1)
        beside |= np.pad(jump, pad)
        pad[axis] = (1, 0)
        beside |= np.pad(jump, pad)
    return beside
