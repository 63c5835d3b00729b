"""Reads bench.toml, format `palpate-bench/1`: the devices, the object, and how to push.

A driver more is one file and one line in `CAMERA_DRIVERS`, `FORCE_DRIVERS` or `ARM_DRIVERS`.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from palpate.bench.arms import ArmLimits, GuardedArm
from palpate.bench.cameras import opencv_camera, shown_cameras
from palpate.bench.devices import Arm, Camera, ForceSource
from palpate.bench.gauges import GAUGES, SerialGauge, TableGauge, TypedForce, shown_ports
from palpate.bench.genicam import genicam_camera
from palpate.bench.realsense import realsense_camera
from palpate.bench.universal_robot import universal_robot
from palpate.bench.virtual import DrawnBody, VirtualWorld, rendered_body, virtual_devices
from palpate.calibration import TARGET_KINDS, Charuco, Target, make_target
from palpate.disk import write_bytes
from palpate.errors import InputError, RecordError, quoted
from palpate.geometry import write_mesh
from palpate.lab import (
    LabConfig,
    built_in,
    choose_variant,
    make_head,
    miscalibrated,
    read_lab_config,
)
from palpate.recording import BENCH_FORMAT
from palpate.records import (
    FORCE_UNITS,
    LENGTH_UNITS,
    Rig,
    TomlTable,
    covariance_file,
    nearest_file,
    read_rig,
    read_toml,
    write_rig,
)
from palpate.shapes import Vector3

VIRTUAL = "virtual"
# Tables that the session takes over as they are.
_HEAD = ("object", "support", "gravity")
_KEYS = ("format", "name", *_HEAD, "rig", "board", "contact", "camera", "force", "arm", "push")
_SPEED_UNITS = {f"{unit}/s": value for unit, value in LENGTH_UNITS.items()}
# Time for which a push is held [s], and its force on a virtual bench [N].
_HOLD, _VIRTUAL_FORCE = 1.5, 0.45
# Pixels of a square of a virtual board's print.
_DRAWN = 64
# Longest time for which a person can hold still; pictures are kept for less [s].
_LONGEST_HOLD = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """Devices, and what they look at.

    Attributes
    ----------
    name : str                      of the session
    folder : Path                   in which files of the object are looked for
    rig : Rig or None               None: the cameras are to be calibrated with a board
    cameras : tuple of Camera       in the rig's order
    force : ForceSource
    arm : GuardedArm or None        None: the person presses
    head : dict                     tables of the session's file: object, support, gravity, as far
                                    as they are known
    contact : dict or None          keys of every probing's contact: tool, radius, ...
    supply : callable               puts rig and mesh, where they are known, into a folder
    direction : (3,) float or None  unit vector in which a scale under the object reads; None: the
                                    gauge is in line with the tool
    push_force : float [N] or None  that pushes are to have; None: as the person likes
    hold : float [s]                how long a push is held
    force_std : float [N]           standard deviation of the gauge's calibration
    board : Target or None          None: the person is asked, where there is no rig
    """

    name: str
    folder: Path
    rig: Rig | None
    cameras: tuple[Camera, ...]
    force: ForceSource
    arm: GuardedArm | None
    head: dict[str, Any]
    contact: dict[str, Any] | None
    supply: Callable[[Path], object]
    direction: Vector3 | None = None
    push_force: float | None = None
    hold: float = _HOLD
    force_std: float = 0.0
    board: Target | None = None

    @property
    def devices(self) -> tuple[Camera | ForceSource | GuardedArm, ...]:
        """All cameras, the force source and the arm."""
        return (*self.cameras, self.force, *(() if self.arm is None else (self.arm,)))

    @contextmanager
    def closed_afterwards(self) -> Iterator[None]:
        """All devices closed when the block ends."""
        with ExitStack() as stack:
            for device in self.devices:
                stack.callback(device.close)
            yield


def read_bench(source: Path | str) -> Bench:
    """Read bench.toml without starting its devices.

    Parameters
    ----------
    source : path or str            bench.toml or its folder; a configuration of the virtual
                                    laboratory, or "virtual": the built-in one, "demo"

    Returns
    -------
    Bench

    Raises
    ------
    RecordError                     any mistake in the file; the text names file, table and key
    CalibrationError                an invalid rig
    InputError                      a driver's package is missing
    """
    if str(source) == VIRTUAL:
        return virtual_bench(read_lab_config(built_in()["demo"]))
    path = Path(source)
    file = path / "bench.toml" if path.is_dir() else path
    if not file.exists():
        raise RecordError(_no_bench(file))
    root = read_toml(file)
    if root.values.get("format") == "palpate-lab/1":
        return virtual_bench(read_lab_config(root.file))
    root.check_keys(_KEYS)
    root.check_format(BENCH_FORMAT)
    rig_file = root.table("rig").existing_file("cameras") if "rig" in root.values else None
    rig = None if rig_file is None else read_rig(rig_file)
    force = root.table("force")
    push = root.optional("push", root.table) or TomlTable(root.file, "[push]", {})
    push.check_keys(("force", "hold"))
    arm = _arm(root.table("arm")) if "arm" in root.values else None
    if arm is not None:
        push.get("force")
    direction = force.optional("direction", force.vector)
    hold = push.optional("hold", push.number)
    if hold is not None and not 0.0 < hold <= _LONGEST_HOLD:
        push.fail("hold", f"is {hold:g} s; must be above 0, and {_LONGEST_HOLD:g} at most")
    if direction is not None and not direction.any():
        force.fail("direction", "has no length; [0, 0, -1] is down in the mesh's frame")
    return Bench(
        name=root.optional("name", root.label) or root.file.parent.resolve().name,
        folder=root.file.parent,
        rig=rig,
        cameras=_cameras(root, rig),
        force=_driver(force, FORCE_DRIVERS),
        arm=arm,
        head={key: root.values[key] for key in _HEAD if key in root.values},
        contact=root.table("contact").values if "contact" in root.values else None,
        supply=partial(_copy, root, rig_file),
        direction=None if direction is None else direction / np.linalg.norm(direction),
        push_force=push.optional("force", partial(_positive_force, push)),
        hold=_HOLD if hold is None else hold,
        force_std=force.optional("std", lambda key: force.quantity(key, FORCE_UNITS)) or 0.0,
        board=read_board(root.table("board")) if "board" in root.values else None,
    )


def _no_bench(file: Path) -> str:
    """That a bench is not there, with a way to one, and what is plugged in."""
    cameras, ports = shown_cameras(), shown_ports()
    plugged = [
        f"camera {', '.join(cameras)} (source = its number)" if cameras else "",
        f"serial line {', '.join(ports)}" if ports else "",
    ]
    found = f"; found here: {'; '.join(filter(None, plugged))}" if any(plugged) else ""
    return (
        f"{file}: there is no such file{nearest_file(file)}. `palpate init {file.parent} --template"
        " webcams` writes one for two webcams and a kitchen scale, to be filled in, and `palpate"
        f" measure virtual` needs no device{found}"
    )


def virtual_bench(
    config: LabConfig,
    *,
    draw: Callable[[LabConfig, Rig], DrawnBody] | None = None,
    board: Charuco | None = None,
) -> Bench:
    """The virtual bench of a configuration; its probings say with which force to push.

    Parameters
    ----------
    config : LabConfig
    draw : callable or None         makes the body that the cameras see; None: Mitsuba renders it
    board : Charuco or None         held before the cameras until they are calibrated; None: they
                                    are, with errors as the configuration says

    Returns
    -------
    Bench

    Raises
    ------
    InputError                      Mitsuba is wanted and not installed
    """
    rig = make_head(config.head, config.specimen.mesh)
    body = draw(config, rig) if draw else rendered_body(config, rig, choose_variant())
    force = next((probe.force for probe in config.probes if probe.force), _VIRTUAL_FORCE)
    world = VirtualWorld(config, rig, body, force)
    cameras, gauge, arm = virtual_devices(world)
    if board is not None:
        extent = board.columns * board.square, board.rows * board.square
        world.shown = board.drawing(_DRAWN), extent

    def supply(folder: Path) -> None:
        world.shown = None
        rng = np.random.default_rng([config.seed, 3])
        known = miscalibrated(rig, config.calibration, config.specimen.mesh, rng=rng)
        with TemporaryDirectory() as made:
            write_mesh(Path(made, "mesh.ply"), config.specimen.mesh)
            if board is None:
                write_rig(Path(made, "rig.toml"), known)
            for file in Path(made).iterdir():
                put(file.read_bytes(), folder / file.name)

    head = {
        "object": {"mesh": "mesh.ply", "length_unit": "m"},
        "support": dict(config.specimen.support),
    }
    shape = "sphere" if config.arm.tip == "sphere" else "flat"
    contact = {"tool": shape, "tool_radius": config.arm.radius}
    return Bench(
        config.name, Path(), None if board else rig, cameras, gauge, arm, head, contact, supply,
        push_force=force, board=board,
    )  # fmt: skip


def read_board(table: TomlTable) -> Target:
    """The board of `[board]`.

    Parameters
    ----------
    table : TomlTable

    Returns
    -------
    Target

    Raises
    ------
    RecordError                     a key that is missing or wrong
    """
    table.check_keys(("target", "columns", "rows", "square", "marker", "gap", "dictionary"))
    kind = table.choice("target", tuple(TARGET_KINDS))
    second = TARGET_KINDS[kind]
    lengths = [table.quantity(key, LENGTH_UNITS) for key in ("square", second) if key]
    with table.error_context():
        return make_target(
            kind, table.count("columns"), table.count("rows"), lengths[0],
            lengths[1] if second else None, table.optional("dictionary", table.text),
        )  # fmt: skip


def _copy(root: TomlTable, rig_file: Path | None, folder: Path) -> None:
    """Copy rig, its covariance and mesh, as far as they are known, into a session's folder."""
    if rig_file is not None:
        put(rig_file.read_bytes(), folder / "rig.toml")
        if covariance := covariance_file(rig_file):
            put(covariance.read_bytes(), folder / covariance.name)
    if "object" in root.values:
        mesh = root.table("object").existing_file("mesh")
        put(mesh.read_bytes(), folder / mesh.name)


def put(content: bytes, file: Path) -> None:
    """Write a file of the bench into a session's folder, where nothing else lies in its place.

    Parameters
    ----------
    content : bytes
    file : Path

    Raises
    ------
    InputError                      another file is there
    RecordError                     it cannot be written
    """
    if not file.exists():
        write_bytes(file, content)
    elif file.read_bytes() != content:
        raise InputError(
            f"{file}: is there already, and is not this bench's; nothing was changed: choose"
            " another folder with --out"
        )


def _driver(table: TomlTable, drivers: Mapping[str, Callable[[TomlTable], Any]]) -> Any:
    """The device of a table, made by the driver that it names."""
    make = drivers[table.choice("driver", tuple(drivers))]
    with table.error_context():
        return make(table)


def _cameras(root: TomlTable, rig: Rig | None) -> tuple[Camera, ...]:
    """A camera for each of the rig's, in its order; as they stand in the file without one."""
    cameras: dict[str, Camera] = {}
    sources: dict[str, str] = {}
    names = [camera.name for camera in rig.cameras] if rig else []
    for table in root.optional("camera", root.tables) or ():
        name = table.choice("name", names) if rig else table.label("name")
        if name in cameras:
            table.fail("name", f"camera '{name}' is there twice; give each its own name")
        source = quoted(table.get("source"))
        if source in sources:
            table.fail(
                "source", f"is {source}, as that of camera '{sources[source]}'; two cameras"
                " have two sources: swap them if the pictures are those of the other"
            )  # fmt: skip
        sources[source] = name
        cameras[name] = _driver(table, CAMERA_DRIVERS)
    if len(cameras) < 2:
        count = "one camera" if cameras else "missing"
        root.fail("[[camera]]", f"is {count}; must be two or more, 20 to 40 degrees apart")
    if missing := [name for name in names if name not in cameras]:
        root.fail("[[camera]]", f"the rig's cameras {', '.join(missing)} have no table")
    return tuple(cameras[name] for name in names or cameras)


def _positive_force(table: TomlTable, key: str) -> float:
    force = table.quantity(key, FORCE_UNITS)
    if force <= 0.0:
        table.fail(key, f"is {force:g} N; must be above zero")
    return force


def _serial(table: TomlTable) -> SerialGauge:
    table.check_keys(("driver", "port", "gauge", "unit", "limit", "baud", "direction", "std"))
    return SerialGauge(
        table.text("port"),
        table.choice("gauge", tuple(GAUGES)),
        unit=table.optional("unit", lambda key: table.choice(key, tuple(FORCE_UNITS))),
        limit=table.optional("limit", partial(_positive_force, table)),
        baud=table.optional("baud", table.count),
    )


def _table(table: TomlTable) -> TableGauge:
    table.check_keys(("driver", "file", "unit", "limit", "direction", "std"))
    return TableGauge(
        table.existing_file("file"),
        unit=table.choice("unit", tuple(FORCE_UNITS)),
        limit=table.optional("limit", partial(_positive_force, table)),
    )


def _typed(table: TomlTable) -> TypedForce:
    table.check_keys(("driver", "unit", "direction", "std"))
    return TypedForce(unit=table.choice("unit", tuple(FORCE_UNITS)))


def _arm(table: TomlTable) -> GuardedArm:
    """An arm behind its limits, without which it is refused."""
    limits = table.table("limits", "[arm.limits]")
    limits.check_keys(("force", "depth", "speed", "low", "high"))
    with limits.error_context():
        checked = ArmLimits(
            limits.quantity("force", FORCE_UNITS),
            limits.quantity("depth", LENGTH_UNITS),
            limits.quantity("speed", _SPEED_UNITS),
            *(np.array([_metres(limits, key, k) for k in range(3)]) for key in ("low", "high")),
        )
    return GuardedArm(_driver(table, ARM_DRIVERS), checked)


def _metres(table: TomlTable, key: str, k: int) -> float:
    """One of three lengths with their units."""
    lengths = table.each(lambda item, name: item.quantity(name, LENGTH_UNITS), key)
    if len(lengths) != 3:
        table.fail(key, f'is {len(lengths)} lengths; must be three: ["-5 cm", "-5 cm", "0 cm"]')
    return lengths[k]


CAMERA_DRIVERS: dict[str, Callable[[TomlTable], Camera]] = {
    "opencv": opencv_camera,
    "genicam": genicam_camera,
    "realsense": realsense_camera,
}
FORCE_DRIVERS: dict[str, Callable[[TomlTable], ForceSource]] = {
    "serial": _serial,
    "table": _table,
    "typed": _typed,
}
ARM_DRIVERS: dict[str, Callable[[TomlTable], Arm]] = {"universal-robot": universal_robot}
