"""Tables of session.toml and truth.toml; a session of the facility is read like any other."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from jaxtyping import Float

from palpate.geometry import closest_points
from palpate.lab.config import LabConfig, Probe
from palpate.records import SESSION_FORMAT, SLIDES, STICKS, Rig, check_file_names, write_text
from palpate.solids import Press, Tip

Table = dict[str, Any]
# Name of the pictures before any push.
AT_REST = "rest"


def instant_name(probe: Probe, number: int) -> str:
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
    loaded = [instant_name(probe, number) for number in range(1, probe.steps + 1)]
    session = {
        "name": probe.name,
        "contact": {
            "point": probe.point.tolist(),
            "tool": tip.tool,
            "tool_radius": tip.radius,
            "friction": STICKS if config.arm.sticking else SLIDES,
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
    place = closest_points(config.specimen.mesh, tip.point[None]).position[0]
    truth = {
        "name": probe.name,
        "contact_point": place.tolist(),
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
