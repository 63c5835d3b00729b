"""The virtual facility: from a configuration to a session folder with ground truth.

The session itself is an ordinary one, read like any other, and holds only what a real bench would
give. The ground truth is in `truth.toml`, `rig_true.toml` and the truth maps, in the same folder.
"""

import io
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomlkit
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.checkpoints import Checkpoints, content_digest
from palpate.errors import InputError, RecordError
from palpate.geometry import TriangleMesh, closest_points, write_mesh
from palpate.lab.arm import aim, probe_body, rod_at, solid_under, specimen_body
from palpate.lab.config import LabConfig, Probe, Stage
from palpate.lab.head import make_head, miscalibrated
from palpate.lab.ideal_view import truth_map, write_truth_map
from palpate.lab.scene import Variant
from palpate.lab.studio import Studio, exposure, make_studio, photograph
from palpate.machine import check_disk_for
from palpate.progress import Progress, part_of, silent
from palpate.records import (
    SESSION_FORMAT,
    Rig,
    check_file_names,
    path_below,
    read_rig,
    write_rig,
    write_text,
)
from palpate.shapes import Vertices
from palpate.solids import Body, Press, Solid, Tip, surface_values
from palpate.threads import Distribute
from palpate.vision import project

# One stream of random numbers for each purpose, so that adding a probing leaves the others as is.
_TEXTURE, _ARM, _SENSORS, _CALIBRATION, _PICTURES = range(5)
# Content of files by their names in the session's folder.
_Files = dict[str, bytes]
Table = dict[str, Any]
# What a probing or step gives a session: files, and tables for session.toml and truth.toml.
_Measured = tuple[_Files, tuple[Table, Table]]
# Share of the object's vertices that every camera must see in its picture.
_MIN_SEEN = 0.9
# Of a truth map per pixel of the reference camera: 30 bytes where the object is, a quarter of it.
_TRUTH_BYTES = 8.0
# Cost of the studio in units of one probing, for the progress display.
_STUDIO = 0.6
# Name of the pictures before any push.
AT_REST = "rest"


class _Bench:
    """One session while it is measured: cameras and arm, and after `set_up_studio` the studio."""

    studio: Studio

    def __init__(
        self, config: LabConfig, folder: Path, variant: Variant, parts: Path | None
    ) -> None:
        """Prepare cameras and arm; refuses whatever can be refused before meshing and rendering."""
        mesh = config.specimen.mesh
        self.config, self.folder, self.rig = config, folder, _rig(config)
        self.parts = Checkpoints(
            parts, "" if parts is None else content_digest((config, self.rig, variant.name))
        )
        instants = [
            _instant_name(probe, number)
            for probe in config.probes
            for number in range(1, probe.steps + 1)
        ]
        check_picture_names(instants, self.rig)
        _check_view(self.rig, mesh)
        self._check_disk(len(instants))
        self.tips = [
            aim(probe, config.arm, mesh, rng=self.rng(_ARM, k))
            for k, probe in enumerate(config.probes)
        ]
        self.measured: list[tuple[Table, Table]] = []

    def _check_disk(self, instants: int) -> None:
        """Refuse pictures and truth maps that the disk cannot hold."""
        config, cameras = self.config, self.rig.cameras
        later = instants if config.stage is None else config.stage.steps
        maps = len(config.probes) if config.stage is None else later
        pixels = np.prod([camera.size or (0, 0) for camera in cameras], axis=1, dtype=float)
        # Noise fills the bits and does not compress.
        needed = (1 + later) * pixels.sum() * config.pictures.bits / 8
        needed += _TRUTH_BYTES * maps * pixels[self.rig.reference]
        check_disk_for(
            f"{1 + later} pictures by each of {len(cameras)} cameras", needed,
            "ask for fewer or smaller ones, or choose another disk", self.folder,
        )  # fmt: skip

    def rng(self, stream: int, number: int = 0) -> np.random.Generator:
        """Generator of one stream of random numbers."""
        return np.random.default_rng([self.config.seed, stream, number])

    def set_up_studio(self, variant: Variant) -> None:
        """Prepare texture and light; write mesh and rigs."""
        config, folder, rig = self.config, self.folder, self.rig
        mesh = config.specimen.mesh
        self.studio = make_studio(config, rig, variant, rng=self.rng(_TEXTURE))
        calibrated = miscalibrated(rig, config.calibration, mesh, rng=self.rng(_CALIBRATION))
        (folder / "images").mkdir()
        write_mesh(folder / "mesh.ply", mesh)
        write_rig(folder / "rig.toml", calibrated)
        write_rig(folder / "rig_true.toml", rig)

    def photograph(
        self, name: str, number: int, instants: Sequence[Vertices], rod: TriangleMesh | None = None
    ) -> _Files:
        """Take one picture with every camera, as PNG; several instants give motion blur."""
        pictures = photograph(self.studio, instants, rod, rng=self.rng(_PICTURES, number))
        return {
            f"images/{name}_{camera.name}.png": cv2.imencode(".png", picture)[1].tobytes()
            for camera, picture in zip(self.rig.cameras, pictures, strict=True)
        }

    def record(self, measured: _Measured) -> None:
        """Write what a probing or step gave."""
        files, tables = measured
        for file, content in files.items():
            path_below(self.folder, file).write_bytes(content)
        self.measured.append(tables)


def make_session(
    config: LabConfig,
    folder: Path,
    *,
    variant: Variant,
    progress: Progress = silent,
    parts: Path | None = None,
    distribute: Distribute = map,
) -> None:
    """Measure a virtual specimen: write pictures, forces and ground truth into a folder.

    Cameras and probes are checked before anything is rendered.

    Parameters
    ----------
    config : LabConfig
    folder : Path                   an empty folder
    variant : Variant               of Mitsuba
    progress : callable             called with the current step (text) and the fraction done, 0..1
    parts : Path or None            folder, created if missing, in which finished probings and steps
                                    are stored so that an interrupted run can be resumed
    distribute : Distribute         measures the probings or steps, which are independent

    Raises
    ------
    InputError                      a head that does not see the object, a probe that misses it,
                                    pictures that would have one name, a texture without contrast,
                                    a body that cannot be filled
    RecordError                     the folder cannot be written
    SingularSystemError             the held nodes of the specimen are collinear
    NotConvergedError               as in `probe_body`
    """
    make_sessions(
        [(config, folder)], variant=variant, progress=progress, parts=parts, distribute=distribute
    )


def make_sessions(
    wanted: Sequence[tuple[LabConfig, Path]],
    *,
    variant: Variant,
    progress: Progress = silent,
    parts: Path | None = None,
    distribute: Distribute = map,
) -> None:
    """Measure several virtual specimens, each into its own session folder.

    Configurations derived from one another by `dataclasses.replace`, with the same body, probes and
    constants, share the factorisations, which are half of the work. Each session's files are the
    same as if it were made alone.

    Parameters
    ----------
    wanted : sequence of (LabConfig, Path)      each with its own empty folder
    variant, progress, parts, distribute        as in `make_session`

    Raises
    ------
    PalpateError                    as in `make_session`
    """
    groups: dict[object, list[_Bench]] = {}
    for config, folder in wanted:
        groups.setdefault(_body_key(config), []).append(_Bench(config, folder, variant, parts))
    done = 0
    try:
        for benches in groups.values():
            part = part_of(progress, done / len(wanted), (done + len(benches)) / len(wanted))
            stage = benches[0].config.stage
            if stage is None:
                _measure_probings(benches, variant, part, distribute)
            else:
                _measure_steps(benches[0], stage, variant, part, distribute)
            done += len(benches)
    except OSError as error:
        raise RecordError(
            f"{error.filename or wanted[0][1]}: cannot be written ({error.strerror})"
        ) from error


def stage_motions(stage: Stage) -> Float[np.ndarray, "s 4 4"]:
    """Motion of the object from the first instant to every instant, the first included.

    Parameters
    ----------
    stage : Stage                   s - 1 steps

    Returns
    -------
    (s, 4, 4) float                 homogeneous matrices, x(step) = R x(first) + t, object frame;
                                    t in metres
    """
    axis = stage.axis / np.linalg.norm(stage.axis)
    motions = np.tile(np.eye(4), (stage.steps + 1, 1, 1))
    for k, motion in enumerate(motions):
        turn = cv2.Rodrigues(np.deg2rad(k * stage.rotation) * axis)[0]
        motion[:3, :3] = turn
        motion[:3, 3] = stage.centre - turn @ stage.centre + k * stage.translation
    return motions


def _body_key(config: LabConfig) -> object:
    """Key of all that a session's finite elements depend on; objects are compared by identity."""
    if config.stage is not None:
        return object()
    specimen, arm, material = config.specimen, config.arm, config.material
    same = (id(config.probes), id(specimen.body), id(specimen.held), specimen.element)
    below = specimen.support_stiffness
    return (*same, below, arm.tip, arm.radius, material.young_modulus, material.poisson_ratio)


def _measure_probings(
    benches: Sequence[_Bench], variant: Variant, progress: Progress, distribute: Distribute
) -> None:
    """All probings of one body in several sessions: contact, pictures, readings, truth."""
    names = [f"probing {probe.name}" for probe in benches[0].config.probes]
    begun = _STUDIO / (_STUDIO + len(names))
    progress("finite elements", 0.0)
    # Before any rendering: a body that cannot be meshed is refused here.
    first = _solid(benches[0], 0)
    for bench in benches:
        progress("texture and light", 0.0)
        bench.set_up_studio(variant)
        progress("pictures at rest", 0.5 * begun)
        for file, content in bench.photograph(AT_REST, 0, [bench.studio.mesh.vertices]).items():
            (bench.folder / file).write_bytes(content)
    measure = partial(_measure_probing, first)
    _record_all(benches, names, measure, distribute, part_of(progress, begun, 1.0))


def _record_all(
    benches: Sequence[_Bench],
    names: Sequence[str],
    measure: Callable[[tuple[Sequence[_Bench], int]], Sequence[_Measured]],
    distribute: Distribute,
    progress: Progress,
) -> None:
    """Record all probings, or all steps, in every session: as stored by an interrupted run, or
    measured now; then write the sessions' texts."""
    known = [[bench.parts.load(name) for bench in benches] for name in names]
    missing = [
        [bench for bench, part in zip(benches, parts, strict=True) if part is None]
        for parts in known
    ]
    fresh = distribute(measure, [(chosen, k) for k, chosen in enumerate(missing) if chosen])
    for k, name in enumerate(names):
        progress(name, k / len(names))
        now = iter(next(fresh) if missing[k] else ())
        for bench, part in zip(benches, known[k], strict=True):
            bench.record(bench.parts.stored(name, next(now)) if part is None else part)
    for bench in benches:
        write_session(bench.folder, bench.config, bench.measured)


def _measure_probing(first: Solid, work: tuple[Sequence[_Bench], int]) -> list[_Measured]:
    """Probing k in several sessions of one body, which share its finite elements, those of the
    first probing given, and with equal cameras and mesh the interpolation to rendered vertices."""
    benches, k = work
    # Refined under this tip only: a mesh for each probing costs less than one for all of them.
    body = specimen_body(benches[0].config, first if k == 0 else _solid(benches[0], k))
    interpolation: dict[bytes, csr_array] = {}
    measured = []
    for bench in benches:
        rest = bench.studio.mesh.vertices
        if rest.tobytes() not in interpolation:
            interpolation[rest.tobytes()] = surface_values(body.solid, rest)
        measured.append(_photographed(bench, k, body, interpolation[rest.tobytes()]))
    return measured


def _photographed(bench: _Bench, k: int, body: Body, interpolation: csr_array) -> _Measured:
    """Probing k in one session: pictures, truth map and readings of its load steps."""
    config, rig, mesh = bench.config, bench.rig, bench.studio.mesh
    probe, tip, before = config.probes[k], bench.tips[k], mesh.vertices
    finite = config.material.law == "neo-hookean"
    try:
        states = probe_body(body, probe, tip, finite=finite)
    except InputError as error:
        raise InputError(f"probe '{probe.name}': {error}") from error
    files: _Files = {}
    for number, state in enumerate(states, start=1):
        after = mesh.vertices + interpolation @ state.displacement
        rod = rod_at(tip, state.tip_position, rig.cameras)
        name = _instant_name(probe, number)
        exposed = exposure(config, before, after)
        files |= bench.photograph(name, 1000 * (k + 1) + number, exposed, rod)
        before = after
    truth = io.BytesIO()
    write_truth_map(truth, truth_map(rig, mesh, after, tool=rod))
    files[f"truth_{probe.name}.npz"] = truth.getvalue()
    return files, probe_tables(config, probe, tip, states, rng=bench.rng(_SENSORS, k))


def _measure_steps(
    bench: _Bench, stage: Stage, variant: Variant, progress: Progress, distribute: Distribute
) -> None:
    """All steps of a rigid object on a motion stage, in one session."""
    bench.set_up_studio(variant)
    names = [f"step s{k}" for k in range(stage.steps + 1)]
    _record_all([bench], names, partial(_measure_step, stage_motions(stage)), distribute, progress)


def _measure_step(
    motions: Float[np.ndarray, "s 4 4"], work: tuple[Sequence[_Bench], int]
) -> list[_Measured]:
    """Step k of a rigid object in one session; between pictures the object moves."""
    (bench,), k = work
    config, rest = bench.config, bench.studio.mesh.vertices
    before, after = (
        rest @ motion[:3, :3].T + motion[:3, 3] for motion in (motions[max(k - 1, 0)], motions[k])
    )
    tables = step_tables(config, f"s{k}", motions[k], rng=bench.rng(_SENSORS, k))
    return [(bench.photograph(f"s{k}", k, exposure(config, before, after)), tables)]


def _solid(bench: _Bench, k: int) -> Solid:
    """The specimen's finite elements, refined under the tip of probing k."""
    config = bench.config
    return solid_under(config.specimen, bench.tips[k], config.probes[k], config.material)


def _rig(config: LabConfig) -> Rig:
    if config.head.file is None:
        return make_head(config.head, config.specimen.mesh)
    rig = read_rig(config.head.file)
    if without := [camera.name for camera in rig.cameras if camera.size is None]:
        raise RecordError(
            f"{config.head.file}: camera '{without[0]}' has no size; give it as size = [columns,"
            " rows]"
        )
    return rig


def _check_view(rig: Rig, mesh: TriangleMesh) -> None:
    """Refuse cameras that do not see the object."""
    for camera in rig.cameras:
        depth = mesh.vertices @ camera.T_camera_object[2, :3] + camera.T_camera_object[2, 3]
        share = 0.0
        if (depth > 0.0).all():
            pixel = project(camera, mesh.vertices)
            share = float(((pixel >= 0) & (pixel <= np.array(camera.size) - 1)).all(axis=1).mean())
        if share < _MIN_SEEN:
            raise InputError(
                f"camera '{camera.name}' has {100 * share:.0f} % of the object in its picture; must"
                f" be {100 * _MIN_SEEN:.0f} % or more: move it away, turn it, or shorten its focal"
                " length"
            )


def _instant_name(probe: Probe, number: int) -> str:
    """Name of a probing's pictures at one load step.

    Parameters
    ----------
    probe : Probe
    number : int                    1 to `probe.steps`

    Returns
    -------
    str                             the probing's own name for the last load step
    """
    return probe.name if number == probe.steps else f"{probe.name}_{number}"


def check_picture_names(instants: Sequence[str], rig: Rig) -> None:
    """Refuse instants that would overwrite the pictures of another one, or those at rest.

    Parameters
    ----------
    instants : sequence of str      after the one at rest; pictures are named INSTANT_CAMERA
    rig : Rig

    Raises
    ------
    InputError                      as `check_file_names`
    """
    check_file_names(instants, what="probing", taken=[AT_REST])
    cameras = [camera.name for camera in rig.cameras]
    pictures = [f"{name}_{camera}" for name in (AT_REST, *instants) for camera in cameras]
    check_file_names(pictures, what="picture")


def probe_tables(
    config: LabConfig, probe: Probe, tip: Tip, states: Sequence[Press], *, rng: np.random.Generator
) -> tuple[Table, Table]:
    """Tables of a probing for the session, with simulated readings, and for the ground truth.

    The session's contact is what an operator would know: the commanded point, and the shape, radius
    and friction of the tool. The contact radius is not observed.

    Parameters
    ----------
    config : LabConfig              its sensors
    probe : Probe                   as commanded
    tip : Tip                       as truly moved
    states : sequence of Press      one per load step, the last at full load
    rng : Generator                 of the readings

    Returns
    -------
    session, truth : dict           one table for each file, in SI units
    """
    last, force, position = states[-1], config.force_sensor, config.position_sensor
    travel = last.depth * tip.direction
    loaded = [_instant_name(probe, number) for number in range(1, probe.steps + 1)]
    session = {
        "name": probe.name,
        "contact": {
            "point": probe.point.tolist(),
            "tool": tip.tool.shape,
            "tool_radius": tip.radius,
            "friction": tip.tool.friction_name,
        },
        "force": force.read(last.force, rng=rng).tolist(),
        "force_std": force.std(last.force),
        "tip_displacement": position.read(travel, rng=rng).tolist(),
        "tip_displacement_std": position.std(travel),
        "images": {
            "rest": f"images/{AT_REST}_{{camera}}.png",
            "loaded": [f"images/{name}_{{camera}}.png" for name in loaded],
        },
    }
    # `tip.point` is the centre of a sphere, one radius above the contact point.
    contact_point = closest_points(config.specimen.mesh, tip.point[None]).position[0]
    truth = {
        "name": probe.name,
        "contact_point": contact_point.tolist(),
        "contact_radius": last.radius,
        "direction": tip.direction.tolist(),
        "force": last.force.tolist(),
        "depth": last.depth,
        "load_steps": [state.depth / last.depth for state in states],
    }
    # A perfect sensor states no standard deviation.
    return {key: value for key, value in session.items() if value != 0.0}, truth


def step_tables(
    config: LabConfig, name: str, motion: Float[np.ndarray, "4 4"], *, rng: np.random.Generator
) -> tuple[Table, Table]:
    """Tables of a stage's step for the session, and for the truth: motion and encoder reading.

    Parameters
    ----------
    config : LabConfig              its position sensor
    name : str                      of the step
    motion : (4, 4) float           from the first instant, object frame; translation in metres
    rng : Generator                 of the reading

    Returns
    -------
    session, truth : dict           one table for each file
    """
    turn, shift = motion[:3, :3], motion[:3, 3]
    encoder = config.position_sensor.read(shift, rng=rng).tolist()
    session = {"name": name, "images": f"images/{name}_{{camera}}.png"}
    return session, {"name": name, "R": turn.tolist(), "t": shift.tolist(), "encoder": encoder}


def write_session(folder: Path, config: LabConfig, measured: Sequence[tuple[Table, Table]]) -> None:
    """Write session.toml and truth.toml.

    Parameters
    ----------
    folder : Path
    config : LabConfig
    measured : sequence of (dict, dict)     session and truth tables of every probing or step

    Raises
    ------
    RecordError                     a file cannot be written
    """
    material = config.material
    rows, truths = (list(tables) for tables in zip(*measured, strict=True))
    standing = {"support": dict(config.specimen.support)} if config.stage is None else {}
    kind = "probe" if config.stage is None else "step"
    session = {
        "format": SESSION_FORMAT,
        "name": config.name,
        "object": {"mesh": "mesh.ply", "length_unit": "m"},
        **standing,
        "rig": {"cameras": "rig.toml"},
        kind: rows,
    }
    truth = {
        "young_modulus": material.young_modulus,
        "poisson_ratio": material.poisson_ratio,
        "shear_modulus": material.shear_modulus,
        "law": material.law,
        "seed": config.seed,
        kind: truths,
    }
    for name, content in (("session.toml", session), ("truth.toml", truth)):
        write_text(folder / name, tomlkit.dumps(content))
