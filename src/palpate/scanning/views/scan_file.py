"""Reading `scan.toml`: the views of an object, their poses, and the support it stood on."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from palpate.errors import InputError
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
from palpate.scanning.views.depth_maps import DEPTH_SUFFIXES, depth_points
from palpate.scanning.views.point_files import POINT_SUFFIXES, read_points
from palpate.scanning.views.turntable import Turntable
from palpate.scanning.views.view import Pose, View, make_view
from palpate.vision import StereoSettings, prepare_pictures, read_pictures, stereo_points

SCAN_FORMAT = "palpate-scan/1"
SCAN_FILE = "scan.toml"
_KEYS = ("format", "length_unit", "sigma", "support", "depth", "rig", "turntable", "view")
_VIEW_KEYS = ("file", "images", "pose", "angle", "eye")


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
    turntable: Turntable | None


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
    for k, one in enumerate(tables):
        progress(f"view {k + 1} of {len(tables)}", k / len(tables))
        view, own = _view(one, k, setup)
        if "file" in one.values and own[-1] in files:
            one.fail("file", f"{own[-1].name} is another view already; name each once")
        views.append(view)
        files += own
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
        with turn.error_context():
            turntable = Turntable(unit * turn.vector("point"), turn.vector("axis"))
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
        view, own = _stereo_view(table, setup, pose)
        return view, [*files, *own]
    file = table.existing_file("file")
    eye = table.optional("eye", table.vector)
    make: Callable[..., View] = partial(
        make_view, file.name, sigma=setup.sigma, eye=None if eye is None else setup.unit * eye
    )
    if file.suffix.lower() in DEPTH_SUFFIXES and setup.camera is not None:
        points = depth_points(file, setup.camera, metres_per_level=setup.metres_per_level)
    elif file.suffix.lower() in POINT_SUFFIXES:
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
        return setup.turntable.pose(np.radians(table.number("angle"))), []
    return None, []


def _stereo_view(table: TomlTable, setup: _Setup, pose: Pose | None) -> tuple[View, list[Path]]:
    """View made of stereo points of one instant, in the rig's frame, and its picture files."""
    if setup.rig is None:
        table.fail("images", "need a [rig] with its cameras")
    pattern = table.text("images")
    read = read_pictures(setup.rig, pattern, folder=setup.folder, what=f"view '{pattern}'")
    found = stereo_points(prepare_pictures(setup.rig, read.grey))
    reference = setup.rig.cameras[setup.rig.reference]
    files = [setup.folder / pattern.replace("{camera}", c.name) for c in setup.rig.cameras]
    view = make_view(
        pattern.replace("{camera}", reference.name), found.point, eye=camera_centre(reference),
        pose=pose,
    )  # fmt: skip
    along = np.einsum("na,nab,nb->n", view.normals, found.covariance, view.normals)
    # The noise of overlapping windows is correlated up to their width.
    width = StereoSettings().subset * float(np.median(found.spacing)) / found.step
    return replace(view, sigma=np.sqrt(along), correlation_length=width), files
