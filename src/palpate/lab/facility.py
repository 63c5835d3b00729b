"""The virtual facility: from a configuration to a session folder with its truth.

The session is an ordinary one and holds nothing but what a bench would give. Beside it `truth.toml`
and the truth maps tell what really was.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from palpate.errors import InputError, RecordError
from palpate.geometry import TriangleMesh, closest_points, write_mesh
from palpate.lab.arm import Probed, aimed, contact_told, fine_place, probed, rod_at
from palpate.lab.config import LabConfig, Probe
from palpate.lab.contact import Tip
from palpate.lab.finite_elements import Body, held_nodes, make_body, surface_values
from palpate.lab.mitsuba_variant import Variant
from palpate.lab.photographs import Studio, exposure, make_studio, photographed
from palpate.lab.readings import force_std, position_std, read_force, read_position
from palpate.lab.session_writing import toml_table
from palpate.lab.stage import stage_motions
from palpate.lab.stereo_head import make_head, misjudged
from palpate.lab.tetrahedra import make_solid
from palpate.lab.truth_maps import surface_maps, truth_map, write_truth_map
from palpate.records import SESSION_FORMAT, Rig, read_rig, write_rig
from palpate.shapes import Vertices
from palpate.vision import project

__all__ = ["Progress", "make_session"]

Progress = Callable[[str, float], None]
# One stream of random numbers for each purpose, so that a further probing changes no other.
_TEXTURE, _ARM, _SENSORS, _CALIBRATION, _PICTURES = range(5)
# Share of the object's vertices that every camera must see in its picture.
_SEEN = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """What is put up before the first picture."""

    config: LabConfig
    folder: Path
    rig: Rig
    told: Rig
    studio: Studio


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
    say = progress or _silent
    rig = _rig(config)
    _check_view(rig, config.specimen.mesh)
    tips = tuple(
        aimed(probe, config.arm, config.specimen.mesh, rng=_rng(config, _ARM, k))
        for k, probe in enumerate(config.probes)
    )
    say("texture and light", 0.0)
    studio = make_studio(config, rig, variant, rng=_rng(config, _TEXTURE))
    told = misjudged(rig, config.calibration, config.specimen.mesh, rng=_rng(config, _CALIBRATION))
    bench = _Bench(config, folder, rig, told, studio)
    try:
        (folder / "images").mkdir()
        write_mesh(folder / "mesh.ply", config.specimen.mesh)
        write_rig(folder / "rig.toml", told)
        write_rig(folder / "rig_true.toml", rig)
        if config.stage is None:
            _probings(bench, tips, say)
        else:
            _steps(bench, say)
    except OSError as error:
        raise RecordError(f"{folder}: cannot be written ({error.strerror})") from error


def _probings(bench: _Bench, tips: tuple[Tip, ...], say: Progress) -> None:
    """Every probing: physics, pictures, readings, truth."""
    config, studio = bench.config, bench.studio
    rest = studio.mesh.vertices
    at_rest = surface_maps(bench.rig, rest, studio.mesh.triangles)
    _take(bench, "rest", [(rest, ())], 0)
    session, truth = [_head_of_session(config)], [_head_of_truth(config)]
    for k, (probe, tip) in enumerate(zip(config.probes, tips, strict=True)):
        say(f"probing {probe.name}", 0.1 + 0.9 * k / len(tips))
        # Small elements under this tip only: a body for each is less than one for all.
        body = _body(config, probe, tip)
        carried = surface_values(body.solid, rest)
        found = probed(
            body, probe, tip, sticking=config.arm.sticking,
            finite=config.material.law == "neo-hookean",
        )  # fmt: skip
        before = rest
        for number, state in enumerate(found.states, start=1):
            after = rest + carried @ state.displacement
            rods = (rod_at(tip, state.place, bench.rig.cameras),)
            name = _instant(probe, number)
            blurred = [(moment, rods) for moment in exposure(config, before, after)]
            _take(bench, name, blurred, 1000 * (k + 1) + number)
            before = after
        whole = [(rod.vertices, rod.triangles) for rod in rods]
        seen = truth_map(
            bench.rig, rest, after, studio.mesh.triangles, others=whole, at_rest=at_rest
        )
        write_truth_map(bench.folder / f"truth_{probe.name}.npz", seen)
        session.append(_probe_of_session(config, found, _rng(config, _SENSORS, k)))
        truth.append(_probe_of_truth(config, found))
    _write(bench.folder, session, truth)


def _steps(bench: _Bench, say: Progress) -> None:
    """A rigid object on a motion stage."""
    config, rest = bench.config, bench.studio.mesh.vertices
    stage = config.stage
    if stage is None:
        raise InputError("there is no stage")
    session, truth = [_head_of_session(config)], [_head_of_truth(config)]
    before = rest
    for k, motion in enumerate(stage_motions(stage)):
        say(f"step s{k}", 0.2 + 0.8 * k / (stage.steps + 1))
        after = rest @ motion[:3, :3].T + motion[:3, 3]
        _take(bench, f"s{k}", [(one, ()) for one in exposure(config, before, after)], k)
        before = after
        read = read_position(motion[:3, 3], config.position_sensor, rng=_rng(config, _SENSORS, k))
        images = f"images/s{k}_{{camera}}.png"
        session.append(toml_table("[[step]]", {"name": f"s{k}", "images": images}))
        truth.append(
            toml_table(
                "[[step]]",
                {"name": f"s{k}", "R": motion[:3, :3], "t": motion[:3, 3], "encoder": read},
            )
        )
    _write(bench.folder, session, truth)


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


def _instant(probe: Probe, number: int) -> str:
    """Name of a probing's pictures: the last instant has the probing's own."""
    return probe.name if number == probe.steps else f"{probe.name}_{number}"


def _head_of_session(config: LabConfig) -> str:
    support = "" if config.stage is not None else toml_table("[support]", config.specimen.support)
    return (
        toml_table("", {"format": SESSION_FORMAT, "name": config.name})
        + toml_table("[object]", {"mesh": "mesh.ply", "length_unit": "m"})
        + support
        + toml_table("[rig]", {"cameras": "rig.toml"})
    )


def _probe_of_session(config: LabConfig, found: Probed, rng: np.random.Generator) -> str:
    """What the bench knows of a probing: readings, and where the arm was sent."""
    contact, last, probe = contact_told(found), found.states[-1], found.probe
    force = read_force(last.force, config.force_sensor, rng=rng)
    way = read_position(last.depth * found.tip.direction, config.position_sensor, rng=rng)
    sigma = force_std(last.force, config.force_sensor)
    loaded = [
        f"images/{_instant(probe, number)}_{{camera}}.png" for number in range(1, probe.steps + 1)
    ]
    return toml_table(
        "[[probe]]",
        {
            "name": probe.name,
            "contact": {
                "point": contact.point, "radius": contact.radius, "profile": contact.profile.value,
            },
            "force": force,
            "force_std": sigma or None,
            "tip_displacement": way,
            "tip_displacement_std": position_std(config.position_sensor) or None,
            "images": {"rest": "images/rest_{camera}.png", "loaded": loaded},
        },
    )  # fmt: skip


def _head_of_truth(config: LabConfig) -> str:
    material = config.material
    values = {
        "young_modulus": material.young_modulus,
        "poisson_ratio": material.poisson_ratio,
        "shear_modulus": material.shear_modulus,
        "law": material.law,
        "seed": config.seed,
    }
    return toml_table("", values)


def _probe_of_truth(config: LabConfig, found: Probed) -> str:
    last = found.states[-1]
    # The tip's axis goes through the sphere's centre, one radius above the place.
    touched = closest_points(config.specimen.mesh, found.tip.point[None]).position[0]
    return toml_table(
        "[[probe]]",
        {
            "name": found.probe.name,
            "contact_point": touched,
            "contact_radius": last.radius,
            "direction": found.tip.direction,
            "force": last.force,
            "depth": last.depth,
            "load_steps": [state.depth / last.depth for state in found.states],
        },
    )


def _write(folder: Path, session: list[str], truth: list[str]) -> None:
    (folder / "session.toml").write_text("".join(session).rstrip() + "\n", encoding="utf-8")
    (folder / "truth.toml").write_text("".join(truth).rstrip() + "\n", encoding="utf-8")


def _rng(config: LabConfig, stream: int, number: int = 0) -> np.random.Generator:
    return np.random.default_rng([config.seed, stream, number])


def _silent(stage: str, fraction: float) -> None:
    """Progress of a caller who does not want to know."""
