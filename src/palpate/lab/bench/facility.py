"""The virtual facility: from a configuration to a session folder with its truth.

The session is an ordinary one and holds only what a bench would give. `truth.toml` and the truth
maps beside it hold what was really there.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.errors import InputError, RecordError
from palpate.geometry import TriangleMesh, write_mesh
from palpate.lab.bench.arm import aim, fine_place, probe_body, rod_at
from palpate.lab.bench.session_text import (
    Table,
    instant_name,
    probe_tables,
    step_tables,
    write_session,
)
from palpate.lab.bodies import Body, Tip, held_nodes, make_body, make_solid, surface_values
from palpate.lab.config import LabConfig, Probe, Stage
from palpate.lab.pictures import (
    Studio,
    Variant,
    exposure,
    make_head,
    make_studio,
    miscalibrated,
    photograph,
    truth_map,
    write_truth_map,
)
from palpate.progress import Progress, part_of, silent
from palpate.records import Rig, read_rig, write_rig
from palpate.shapes import Vertices
from palpate.vision import project

# One stream of random numbers for each purpose, so that a further probing changes no other.
_TEXTURE, _ARM, _SENSORS, _CALIBRATION, _PICTURES = range(5)
# Share of the object's vertices that every camera must see in its picture.
_MIN_SEEN = 0.9


class _Bench:
    """One session: cameras and arm from the beginning, texture and light once they are put up."""

    studio: Studio

    def __init__(self, config: LabConfig, folder: Path) -> None:
        """Refuse what can be refused without finite elements or light."""
        mesh = config.specimen.mesh
        self.config, self.folder, self.rig = config, folder, _rig(config)
        _check_view(self.rig, mesh)
        self.tips = [
            aim(probe, config.arm, mesh, rng=self.rng(_ARM, k))
            for k, probe in enumerate(config.probes)
        ]
        self.measured: list[tuple[Table, Table]] = []

    def rng(self, stream: int, number: int = 0) -> np.random.Generator:
        """Random numbers of one purpose."""
        return np.random.default_rng([self.config.seed, stream, number])

    def put_up(self, variant: Variant) -> None:
        """Put up texture and light; write what the session knows before the first picture."""
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
    ) -> None:
        """Take and keep one picture of every camera; several instants blur it."""
        pictures = photograph(self.studio, instants, rod, rng=self.rng(_PICTURES, number))
        for camera, picture in zip(self.rig.cameras, pictures, strict=True):
            _, content = cv2.imencode(".png", picture)
            (self.folder / "images" / f"{name}_{camera.name}.png").write_bytes(content.tobytes())


def make_session(
    config: LabConfig, folder: Path, *, variant: Variant, progress: Progress | None = None
) -> None:
    """Measure a virtual specimen: pictures, forces and truth into a folder.

    Everything that can be refused is refused before anything is rendered.

    Parameters
    ----------
    config : LabConfig
    folder : Path                   an empty folder
    variant : Variant               of Mitsuba
    progress : callable or None     gets what is done (text) and how much of all (0 to 1)

    Raises
    ------
    InputError                      a head that does not see the object, a probe that misses it, a
                                    texture without contrast, a body that cannot be filled
    RecordError                     the folder cannot be written
    """
    make_sessions([(config, folder)], variant=variant, progress=progress)


def make_sessions(
    wanted: Sequence[tuple[LabConfig, Path]],
    *,
    variant: Variant,
    progress: Progress | None = None,
) -> None:
    """Measure virtual specimens, several sessions in one go.

    Configurations that `dataclasses.replace` made from one another, with the same body, probes and
    constants, share the factorisations, which are half of the work. Each session gets the files
    that it would get alone.

    Parameters
    ----------
    wanted : sequence of (LabConfig, Path)      each with its own empty folder
    variant, progress               as for `make_session`

    Raises
    ------
    InputError, RecordError         as `make_session`
    """
    say = progress or silent
    groups: dict[object, list[_Bench]] = {}
    for config, folder in wanted:
        groups.setdefault(_body_key(config), []).append(_Bench(config, folder))
    done = 0
    try:
        for benches in groups.values():
            part = part_of(say, done / len(wanted), (done + len(benches)) / len(wanted))
            stage = benches[0].config.stage
            if stage is None:
                _measure_probings(benches, variant, part)
            else:
                _measure_steps(benches[0], stage, variant, part)
            done += len(benches)
    except OSError as error:
        raise RecordError(
            f"{error.filename or wanted[0][1]}: cannot be written ({error.strerror})"
        ) from error


def stage_motions(stage: Stage) -> Float[np.ndarray, "s 4 4"]:
    """Motion of the object from the first instant to each, the first included.

    Parameters
    ----------
    stage : Stage                   s - 1 steps

    Returns
    -------
    (s, 4, 4) float [m]             x(step) = R x(first) + t, object frame
    """
    axis = stage.axis / np.linalg.norm(stage.axis)
    motions = np.tile(np.eye(4), (stage.steps + 1, 1, 1))
    for k, motion in enumerate(motions):
        turn = cv2.Rodrigues(np.deg2rad(k * stage.rotation) * axis)[0]
        motion[:3, :3] = turn
        motion[:3, 3] = stage.centre - turn @ stage.centre + k * stage.translation
    return motions


def _body_key(config: LabConfig) -> object:
    """What a session's finite elements depend on; only what was replaced counts as different."""
    if config.stage is not None:
        return object()
    specimen, arm, material = config.specimen, config.arm, config.material
    same = (id(config.probes), id(specimen.body), id(specimen.held), specimen.element)
    return (*same, arm.tip, arm.radius, material.young_modulus, material.poisson_ratio)


def _measure_probings(benches: Sequence[_Bench], variant: Variant, say: Progress) -> None:
    """Every probing of one body in several sessions: physics, pictures, readings, truth."""
    config, tips = benches[0].config, benches[0].tips
    say("finite elements", 0.0)
    # Before any light is made: a body that cannot be filled or held is refused here.
    body = _body(config, config.probes[0], tips[0])
    for bench in benches:
        say("texture and light", 0.02)
        bench.put_up(variant)
        bench.photograph("rest", 0, [bench.studio.mesh.vertices])
    for k, probe in enumerate(config.probes):
        say(f"probing {probe.name}", 0.1 + 0.9 * k / len(tips))
        # Small elements under this tip only: a body for each is less than one for all.
        body = body if k == 0 else _body(config, probe, tips[k])
        # From nodal values to the drawn vertices: the same where cameras and mesh are.
        carried: dict[bytes, csr_array] = {}
        for bench in benches:
            rest = bench.studio.mesh.vertices
            if rest.tobytes() not in carried:
                carried[rest.tobytes()] = surface_values(body.solid, rest)
            _measure_probing(bench, body, carried[rest.tobytes()], k)
    for bench in benches:
        write_session(bench.folder, bench.config, bench.measured)


def _measure_probing(bench: _Bench, body: Body, carried: csr_array, k: int) -> None:
    """One probing on one bench; `carried` takes nodal values to the drawn vertices."""
    config, rig, mesh = bench.config, bench.rig, bench.studio.mesh
    probe, tip = config.probes[k], bench.tips[k]
    finite = config.material.law == "neo-hookean"
    states = probe_body(body, probe, tip, sticking=config.arm.sticking, finite=finite)
    before = mesh.vertices
    for number, state in enumerate(states, start=1):
        after = mesh.vertices + carried @ state.displacement
        rod = rod_at(tip, state.place, rig.cameras)
        name = instant_name(probe, number)
        bench.photograph(name, 1000 * (k + 1) + number, exposure(config, before, after), rod)
        before = after
    seen = truth_map(rig, mesh, after, tool=rod)
    write_truth_map(bench.folder / f"truth_{probe.name}.npz", seen)
    bench.measured.append(probe_tables(config, probe, tip, states, rng=bench.rng(_SENSORS, k)))


def _measure_steps(bench: _Bench, stage: Stage, variant: Variant, say: Progress) -> None:
    """A rigid object on a motion stage."""
    bench.put_up(variant)
    config, rest = bench.config, bench.studio.mesh.vertices
    before, motions = rest, stage_motions(stage)
    for k, motion in enumerate(motions):
        name = f"s{k}"
        say(f"step {name}", k / len(motions))
        after = rest @ motion[:3, :3].T + motion[:3, 3]
        bench.photograph(name, k, exposure(config, before, after))
        before = after
        bench.measured.append(step_tables(config, name, motion, rng=bench.rng(_SENSORS, k)))
    write_session(bench.folder, config, bench.measured)


def _body(config: LabConfig, probe: Probe, tip: Tip) -> Body:
    """The specimen in finite elements, small ones under the tip."""
    material, specimen = config.material, config.specimen
    fine = (fine_place(tip, probe, material),)
    solid = make_solid(specimen.body, edge=specimen.element, fine=fine)
    held = held_nodes(solid, specimen.held)
    return make_body(
        solid, held, shear_modulus=material.shear_modulus, poisson_ratio=material.poisson_ratio
    )


def _rig(config: LabConfig) -> Rig:
    if config.head.file is None:
        return make_head(config.head, config.specimen.mesh)
    rig = read_rig(config.head.file)
    if without := [camera.name for camera in rig.cameras if camera.size is None]:
        raise InputError(
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
