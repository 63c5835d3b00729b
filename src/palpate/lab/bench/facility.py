"""The virtual facility: from a configuration to a session folder with its truth.

The session is an ordinary one and holds nothing but what a bench would give. Beside it `truth.toml`
and the truth maps tell what really was.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.sparse import csr_array

from palpate.errors import InputError, RecordError
from palpate.geometry import TriangleMesh, write_mesh
from palpate.lab.bench.arm import aimed, fine_place, probed, rod_at
from palpate.lab.bench.readings import read_position
from palpate.lab.bench.session_tables import (
    head_of_session,
    head_of_truth,
    instant_name,
    probe_of_session,
    probe_of_truth,
)
from palpate.lab.bench.session_writing import toml_table
from palpate.lab.bench.stage import stage_motions
from palpate.lab.bodies import Body, Tip, held_nodes, make_body, make_solid, surface_values
from palpate.lab.config import LabConfig, Probe, Stage
from palpate.lab.pictures import (
    Studio,
    Variant,
    exposure,
    make_head,
    make_studio,
    misjudged,
    photographed,
    surface_maps,
    truth_map,
    write_truth_map,
)
from palpate.progress import Progress, part_of, silent
from palpate.records import Rig, read_rig, write_rig
from palpate.shapes import Vertices
from palpate.vision import SurfaceMap, project

# One stream of random numbers for each purpose, so that a further probing changes no other.
_TEXTURE, _ARM, _SENSORS, _CALIBRATION, _PICTURES = range(5)
# Share of the object's vertices that every camera must see in its picture.
_SEEN = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class _Planned:
    """A session that can be measured as far as one can say without finite elements or light."""

    config: LabConfig
    folder: Path
    rig: Rig
    tips: tuple[Tip, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """What is put up before the first picture, and its two files as far as they are written."""

    config: LabConfig
    folder: Path
    rig: Rig
    tips: tuple[Tip, ...]
    studio: Studio
    session: list[str]
    truth: list[str]


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
    progress : callable or None     told what is done (text) and how far it is (0 to 1)

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
    groups = _alike([_planned(config, folder) for config, folder in wanted])
    done = 0
    try:
        for group in groups:
            begin, end = done / len(wanted), (done + len(group)) / len(wanted)
            stage = group[0].config.stage
            if stage is None:
                _probings(group, variant, part_of(say, begin, end))
            else:
                _steps(_bench(group[0], variant), stage, part_of(say, begin, end))
            done += len(group)
    except OSError as error:
        raise RecordError(
            f"{error.filename or wanted[0][1]}: cannot be written ({error.strerror})"
        ) from error


def _planned(config: LabConfig, folder: Path) -> _Planned:
    """Refuse cameras that see too little, and an arm that misses."""
    rig, mesh = _rig(config), config.specimen.mesh
    _check_view(rig, mesh)
    tips = tuple(
        aimed(probe, config.arm, mesh, rng=_rng(config, _ARM, k))
        for k, probe in enumerate(config.probes)
    )
    return _Planned(config, folder, rig, tips)


def _bench(planned: _Planned, variant: Variant) -> _Bench:
    """Put up texture and light; write what the session knows before the first picture."""
    config, folder, rig, mesh = (
        planned.config, planned.folder, planned.rig, planned.config.specimen.mesh,
    )  # fmt: skip
    studio = make_studio(config, rig, variant, rng=_rng(config, _TEXTURE))
    told = misjudged(rig, config.calibration, mesh, rng=_rng(config, _CALIBRATION))
    (folder / "images").mkdir()
    write_mesh(folder / "mesh.ply", mesh)
    write_rig(folder / "rig.toml", told)
    write_rig(folder / "rig_true.toml", rig)
    return _Bench(
        config, folder, rig, planned.tips, studio,
        [head_of_session(config)], [head_of_truth(config)],
    )  # fmt: skip


def _alike(sessions: Sequence[_Planned]) -> list[list[_Planned]]:
    """Sessions whose bodies are pressed at the same places, together; stages alone."""
    groups: list[list[_Planned]] = []
    for session in sessions:
        alike = (one for one in groups if _same_bodies(one[0].config, session.config))
        group = next(alike, None)
        if group is None:
            groups.append([session])
        else:
            group.append(session)
    return groups


def _same_bodies(one: LabConfig, other: LabConfig) -> bool:
    """Whether two configurations, one made from the other, need the same finite elements."""
    a, b = one.specimen, other.specimen
    return (
        one.stage is None
        and one.probes is other.probes
        and (a.body is b.body and a.held is b.held and a.element == b.element)
        and (one.arm.tip, one.arm.radius) == (other.arm.tip, other.arm.radius)
        and replace(one.material, law="linear") == replace(other.material, law="linear")
    )


def _probings(sessions: Sequence[_Planned], variant: Variant, say: Progress) -> None:
    """Every probing of one body in several sessions: physics, pictures, readings, truth."""
    config, tips = sessions[0].config, sessions[0].tips
    say("finite elements", 0.0)
    # Before any light is made: a body that cannot be filled or held is refused here.
    body = _body(config, config.probes[0], tips[0])
    benches, at_rest = [], []
    for session in sessions:
        say("texture and light", 0.02)
        bench = _bench(session, variant)
        rest = bench.studio.mesh.vertices
        at_rest.append(surface_maps(bench.rig, rest, bench.studio.mesh.triangles))
        _take(bench, "rest", [(rest, ())], 0)
        benches.append(bench)
    for k, probe in enumerate(config.probes):
        say(f"probing {probe.name}", 0.1 + 0.9 * k / len(tips))
        # Small elements under this tip only: a body for each is less than one for all.
        body = body if k == 0 else _body(config, probe, tips[k])
        _probing(benches, body, k, at_rest)
    for bench in benches:
        _write(bench)


def _probing(
    benches: Sequence[_Bench], body: Body, k: int, at_rest: Sequence[tuple[SurfaceMap, ...]]
) -> None:
    """One probing on every bench."""
    drawn: Vertices | None = None
    carried = None
    for bench, maps in zip(benches, at_rest, strict=True):
        rest = bench.studio.mesh.vertices
        # From nodal values to the drawn vertices: the same where cameras and mesh are.
        if drawn is None or carried is None or not np.array_equal(rest, drawn):
            drawn, carried = rest, surface_values(body.solid, rest)
        _pressed(bench, body, carried, k, maps)


def _pressed(
    bench: _Bench, body: Body, carried: csr_array, k: int, at_rest: tuple[SurfaceMap, ...]
) -> None:
    """One probing on one bench; `carried` takes nodal values to the drawn vertices."""
    config, mesh, tip = bench.config, bench.studio.mesh, bench.tips[k]
    rest, probe = mesh.vertices, config.probes[k]
    found = probed(
        body, probe, tip, sticking=config.arm.sticking,
        finite=config.material.law == "neo-hookean",
    )  # fmt: skip
    before = rest
    for number, state in enumerate(found.states, start=1):
        after = rest + carried @ state.displacement
        rods = (rod_at(tip, state.place, bench.rig.cameras),)
        blurred = [(moment, rods) for moment in exposure(config, before, after)]
        _take(bench, instant_name(probe, number), blurred, 1000 * (k + 1) + number)
        before = after
    whole = [(rod.vertices, rod.triangles) for rod in rods]
    seen = truth_map(bench.rig, rest, after, mesh.triangles, others=whole, at_rest=at_rest)
    write_truth_map(bench.folder / f"truth_{probe.name}.npz", seen)
    bench.session.append(probe_of_session(config, found, _rng(config, _SENSORS, k)))
    bench.truth.append(probe_of_truth(config, found))


def _steps(bench: _Bench, stage: Stage, say: Progress) -> None:
    """A rigid object on a motion stage."""
    config, rest = bench.config, bench.studio.mesh.vertices
    before = rest
    for k, motion in enumerate(stage_motions(stage)):
        say(f"step s{k}", k / (stage.steps + 1))
        after = rest @ motion[:3, :3].T + motion[:3, 3]
        _take(bench, f"s{k}", [(one, ()) for one in exposure(config, before, after)], k)
        before = after
        read = read_position(motion[:3, 3], config.position_sensor, rng=_rng(config, _SENSORS, k))
        images = f"images/s{k}_{{camera}}.png"
        bench.session.append(toml_table("[[step]]", {"name": f"s{k}", "images": images}))
        bench.truth.append(
            toml_table(
                "[[step]]",
                {"name": f"s{k}", "R": motion[:3, :3], "t": motion[:3, 3], "encoder": read},
            )
        )
    _write(bench)


def _body(config: LabConfig, probe: Probe, tip: Tip) -> Body:
    """The specimen in finite elements, small ones under the tip."""
    material, specimen = config.material, config.specimen
    young, poisson = material.young_modulus, material.poisson_ratio
    solid = make_solid(
        specimen.body.vertices,
        specimen.body.triangles,
        edge=specimen.element,
        fine=(fine_place(tip, probe, young=young, poisson=poisson),),
    )
    held = held_nodes(solid, specimen.held)
    return make_body(solid, held, shear_modulus=material.shear_modulus, poisson_ratio=poisson)


def _take(
    bench: _Bench,
    name: str,
    instants: Sequence[tuple[Vertices, tuple[TriangleMesh, ...]]],
    number: int,
) -> None:
    """Take and keep one picture of every camera."""
    rng = _rng(bench.config, _PICTURES, number)
    pictures = photographed(bench.studio, bench.config, instants, rng=rng)
    for camera, picture in zip(bench.rig.cameras, pictures, strict=True):
        file = bench.folder / "images" / f"{name}_{camera.name}.png"
        done, content = cv2.imencode(".png", picture)
        if not done:
            raise RecordError(f"{file}: the picture cannot be encoded as PNG")
        file.write_bytes(content.tobytes())


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
        if share < _SEEN:
            raise InputError(
                f"camera '{camera.name}' has {100 * share:.0f} % of the object in its picture; must"
                f" be {100 * _SEEN:.0f} % or more: move it away, turn it, or shorten its focal"
                " length"
            )


def _write(bench: _Bench) -> None:
    for name, tables in (("session.toml", bench.session), ("truth.toml", bench.truth)):
        (bench.folder / name).write_text("".join(tables).rstrip() + "\n", encoding="utf-8")


def _rng(config: LabConfig, stream: int, number: int = 0) -> np.random.Generator:
    return np.random.default_rng([config.seed, stream, number])
