"""Reads recording.toml: the object, the recorded files, and how to interpret them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.errors import RecordError, quoted
from palpate.geometry import TriangleMesh
from palpate.recording.footage import Footage, read_times
from palpate.recording.force_log import Gauge
from palpate.records import (
    FILE_LENGTH_UNITS,
    LENGTH_UNITS,
    Rig,
    TomlTable,
    read_object_mesh,
    read_rig,
    read_supports,
    read_toml,
)
from palpate.shapes import Indices

RECORDING_FORMAT = "palpate-recording/1"
_ROOT_KEYS = ("format", "name", "object", "support", "gravity", "rig", "force", "camera", "contact")
_FORCE_KEYS = ("file", "time", "time_unit", "columns", "unit", "axes", "sign", "limit", "topic")
_CAMERA_KEYS = ("name", "video", "pictures", "times", "offset")
# Sign convention of the gauge: force of the tool on the object, or of the object on the tool.
_SIGNS = ("on object", "on tool")
# Contact radius assumed in the search for a contact: this fraction of the tool's radius, or of the
# object's size.
_RADIUS_OVER_TOOL, _RADIUS_OVER_SIZE = 0.5, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class ContactSource:
    """The table [contact]: contact points, or how to find them.

    Attributes
    ----------
    points : (k, 3) float [m] or None   given contact points, one per press
    poses : Path or None            log of the tool's tip: time, x, y, z
    patch : dict                    other keys of a probing's contact, written to the session as is
    radii : tuple of float or None  contact radii, one per press, in the session's unit; None: a
                                    common one in `patch`
    topic : str or None             of the poses in a bag; None: the only one with poses
    tool_radius : float [m] or None of the ball, or of a punch's face, that presses
    """

    points: Float[np.ndarray, "k 3"] | None
    poses: Path | None
    patch: dict[str, Any]
    radii: tuple[float, ...] | None
    topic: str | None = None
    tool_radius: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording of one object, as described in recording.toml.

    Attributes
    ----------
    path : Path                     recording.toml
    name : str
    head : dict                     tables that are copied to the session unchanged
    mesh : TriangleMesh
    held : (k,) int                 triangles of the supports
    metres_per_unit : float [m]     length unit of the file
    rig : Rig
    gauge : Gauge
    footage : tuple of Footage      one per camera, in the rig's order
    contact_source : ContactSource
    files : tuple of Path           files copied to the session: mesh, rig, lists of triangles
    """

    path: Path
    name: str
    head: dict[str, Any]
    mesh: TriangleMesh
    held: Indices
    metres_per_unit: float
    rig: Rig
    gauge: Gauge
    footage: tuple[Footage, ...]
    contact_source: ContactSource
    files: tuple[Path, ...]

    def search_radius(self, press: int) -> float:
        """Contact radius assumed where a contact is searched for.

        Parameters
        ----------
        press : int                 1 for the first

        Returns
        -------
        float [m]                   as given; else from the tool's radius, or the object's size
        """
        source = self.contact_source
        if source.radii is not None:
            return self.metres_per_unit * source.radii[press - 1]
        if "radius" in source.patch:
            return float(self.metres_per_unit * source.patch["radius"])
        if source.tool_radius is not None:
            return _RADIUS_OVER_TOOL * source.tool_radius
        return _RADIUS_OVER_SIZE * float(np.ptp(self.mesh.vertices, axis=0).max())


def read_recording(path: Path) -> Recording:
    """Read and check recording.toml, mesh and rig; checks that all files exist.

    Parameters
    ----------
    path : Path                     the file, or its folder

    Returns
    -------
    Recording

    Raises
    ------
    RecordError                     any mistake in the file; the text names file, table and key
    MeshError, CalibrationError     an invalid mesh or rig
    InputError                      the optional package for the mesh's format is missing
    """
    root = read_toml(path / "recording.toml" if path.is_dir() else path)
    root.check_keys(_ROOT_KEYS)
    root.check_format(RECORDING_FORMAT)
    body = root.table("object")
    metres = FILE_LENGTH_UNITS[body.choice("length_unit", tuple(FILE_LENGTH_UNITS))]
    mesh, _ = read_object_mesh(body, metres)
    supports = read_supports(root, mesh, metres_per_unit=metres)
    held = np.unique(np.concatenate([support.triangles for support in supports]))
    rig_file = root.table("rig").existing_file("cameras")
    rig = read_rig(rig_file)
    files = [body.existing_file("mesh"), rig_file]
    if (covariance := rig_file.with_name("rig_covariance.npz")).is_file():
        files.append(covariance)
    for table in root.tables("support"):
        if "triangles" in table.values:
            files.append(table.existing_file("triangles"))
    _check_names(root, files)
    head = {key: root.values[key] for key in _ROOT_KEYS[2:6] if key in root.values}
    return Recording(
        root.file, root.optional("name", root.text) or root.file.parent.resolve().name, head,
        mesh, held, metres, rig, _gauge(root.table("force")), _cameras(root, rig),
        _contact_source(root.table("contact"), metres),
        tuple(files),
    )  # fmt: skip


def _check_names(root: TomlTable, files: Sequence[Path]) -> None:
    """Refuse different files of one name: in the session's folder one would overwrite the other."""
    by_name: dict[str, Path] = {}
    for file in files:
        other = by_name.setdefault(file.name, file)
        if other.resolve() != file.resolve():
            root.fail(
                "",
                f"{quoted(str(other))} and {quoted(str(file))} have the same name, and both are"
                " copied into the session's folder: rename one of them",
            )


def _gauge(table: TomlTable) -> Gauge:
    """The table [force]: how to read the force log."""
    table.check_keys(_FORCE_KEYS)
    sign = table.optional("sign", lambda key: table.choice(key, _SIGNS))
    axes = table.get("axes")
    many = isinstance(axes, list) and axes and isinstance(axes[0], list)
    vectors = table.each(TomlTable.vector, "axes") if many else [table.vector("axes")]
    with table.error_context():
        return Gauge(
            table.existing_file("file"),
            table.optional("time", table.text),
            table.optional("columns", table.texts) or (),
            table.optional("unit", table.text),
            table.optional("time_unit", table.text),
            np.array(vectors),
            on_tool=sign == _SIGNS[1],
            limit=table.optional("limit", table.number),
            topic=table.optional("topic", table.text),
        )


def _cameras(root: TomlTable, rig: Rig) -> tuple[Footage, ...]:
    """Footage of every camera of the rig."""
    cameras: dict[str, Footage] = {}
    names = [camera.name for camera in rig.cameras]
    for table in root.tables("camera"):
        table.check_keys(_CAMERA_KEYS)
        name = table.choice("name", names)
        if name in cameras:
            table.fail("name", f"camera '{name}' is there twice")
        footage = _footage(table, name)
        for other in cameras.values():
            if (footage.video, footage.pictures) == (other.video, other.pictures):
                key = "video" if footage.video else "pictures"
                table.fail(
                    key, f"cameras '{other.camera}' and '{name}' have the same; give each its own"
                )
        cameras[name] = footage
    if missing := [name for name in names if name not in cameras]:
        root.fail(
            "[[camera]]",
            f"the rig's cameras {', '.join(missing)} have no table; give each its video or pictures"
            " (or a rig without them)",
        )
    return tuple(cameras[name] for name in names)


def _footage(table: TomlTable, name: str) -> Footage:
    video = table.optional("video", table.existing_file)
    pictures: Sequence[Path] = ()
    if "pictures" in table.values:
        pattern = table.text("pictures")
        try:
            pictures = sorted(table.file.parent.glob(pattern))
        except (ValueError, NotImplementedError) as error:
            table.fail("pictures", f"is '{pattern}'; must be a pattern of files here ({error})")
        if not pictures:
            table.fail("pictures", f"no file is called like '{pattern}' in {table.file.parent}")
    times = read_times(table.existing_file("times")) if "times" in table.values else None
    with table.error_context():
        return Footage(name, video, tuple(pictures), times, table.optional("offset", table.number))


def _contact_source(table: TomlTable, metres: float) -> ContactSource:
    """The table [contact]: given points, a log of the tip, or neither: points to be found."""
    source_keys = ("points", "poses", "radius", "topic")
    patch = {key: value for key, value in table.values.items() if key not in source_keys}
    for key in ("point", "triangles", "support"):
        if key in patch:
            table.fail(key, "is no key here; give `points`, one for each press, or `poses`")
    if "points" in table.values and "poses" in table.values:
        table.fail("", "gives both points and poses; give one of the two")
    radii: tuple[float, ...] | None = None
    if isinstance(table.values.get("radius"), list):
        radii = tuple(table.each(TomlTable.number, "radius"))
    elif "radius" in table.values:
        patch["radius"] = table.number("radius")
    points = None
    if "points" in table.values:
        must = "be a list of points, one for each press"
        table.checked(lambda value: isinstance(value, list), "points", must)
        points = metres * np.array(table.each(TomlTable.vector, "points")).reshape(-1, 3)
    return ContactSource(
        points,
        table.optional("poses", table.existing_file),
        patch,
        radii,
        table.optional("topic", table.text),
        table.optional("tool_radius", lambda key: table.quantity(key, LENGTH_UNITS, metres)),
    )


def check_contact_count(recording: Recording, presses: int) -> None:
    """Refuse lists of contacts that do not have one entry for each press.

    Parameters
    ----------
    recording : Recording
    presses : int                   number of presses found, including those left out

    Raises
    ------
    RecordError                     another number of entries
    """
    contact_source = recording.contact_source
    for key, values in (("points", contact_source.points), ("radius", contact_source.radii)):
        if values is not None and len(values) != presses:
            raise RecordError(
                f"{recording.path}: [contact] {key}: has {len(values)} entries, and the force shows"
                f" {presses} presses; give one for each, in time, of presses that are left out too"
            )
