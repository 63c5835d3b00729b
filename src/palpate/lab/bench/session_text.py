"""A session and its truth as text: what the facility leaves is read like any other session."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.geometry import closest_points
from palpate.lab.bench.arm import Pressed
from palpate.lab.bench.readings import read_sensor, sensor_std
from palpate.lab.config import LabConfig, Probe
from palpate.records import SESSION_FORMAT

Table = Mapping[str, Any]


def toml_value(value: Any) -> str:
    """A value as TOML: texts, numbers with all their digits, truth values, lists, inline tables.

    Parameters
    ----------
    value : str, bool, int, float, sequence, array or mapping of these

    Returns
    -------
    str                             what stands behind "key = "

    Raises
    ------
    TypeError                       anything else
    """
    if isinstance(value, Mapping):
        inside = ", ".join(f"{key} = {toml_value(item)}" for key, item in value.items())
        return f"{{ {inside} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    return json.dumps(value, ensure_ascii=False, default=_plain)


def toml_table(header: str, values: Mapping[str, Any]) -> str:
    """A table: its header, a line for each key, an empty line; values that are None are left out.

    Parameters
    ----------
    header : str                    as "[object]", or empty for the root
    values : mapping

    Returns
    -------
    str

    Raises
    ------
    TypeError                       a value that TOML does not know
    """
    lines = [header] if header else []
    lines += [f"{key} = {toml_value(value)}" for key, value in values.items() if value is not None]
    return "\n".join(lines) + "\n\n"


def instant_name(probe: Probe, number: int) -> str:
    """Name of a probing's pictures at an instant.

    Parameters
    ----------
    probe : Probe
    number : int                    1 to `probe.steps`

    Returns
    -------
    str                             the last instant has the probing's own name
    """
    return probe.name if number == probe.steps else f"{probe.name}_{number}"


def probe_tables(
    config: LabConfig, done: Pressed, *, rng: np.random.Generator
) -> tuple[Table, Table]:
    """A probing as the bench knows it, from readings and where the arm was sent; and its truth.

    The contact is what a person at the bench would write down: for a sphere Hertz's pressure over
    the touched circle, for a punch an even one over its face.

    Parameters
    ----------
    config : LabConfig              its sensors
    done : Pressed
    rng : Generator                 of the readings

    Returns
    -------
    session, truth : mapping        one table for each file, in SI units
    """
    probe, tip, last = done.probe, done.tip, done.states[-1]
    travel = last.depth * tip.direction
    session = {
        "name": probe.name,
        "contact": {
            "point": probe.point,
            "radius": tip.radius if tip.profile == "uniform" else last.radius,
            "profile": tip.profile,
        },
        "force": read_sensor(last.force, config.force_sensor, rng=rng),
        "force_std": sensor_std(last.force, config.force_sensor) or None,
        "tip_displacement": read_sensor(travel, config.position_sensor, rng=rng),
        "tip_displacement_std": sensor_std(travel, config.position_sensor) or None,
        "images": {
            "rest": "images/rest_{camera}.png",
            "loaded": [
                f"images/{instant_name(probe, number)}_{{camera}}.png"
                for number in range(1, probe.steps + 1)
            ],
        },
    }
    truth = {
        "name": probe.name,
        # The tip's axis goes through the sphere's centre, one radius above the place.
        "contact_point": closest_points(config.specimen.mesh, tip.point[None]).position[0],
        "contact_radius": last.radius,
        "direction": tip.direction,
        "force": last.force,
        "depth": last.depth,
        "load_steps": [state.depth / last.depth for state in done.states],
    }
    return session, truth


def step_tables(
    config: LabConfig, name: str, motion: Float[np.ndarray, "4 4"], *, rng: np.random.Generator
) -> tuple[Table, Table]:
    """A step of a stage as the bench knows it; and its true motion, with the encoder's reading.

    Parameters
    ----------
    config : LabConfig              its position sensor
    name : str                      of the step
    motion : (4, 4) float [m]       from the first instant, object frame
    rng : Generator                 of the reading

    Returns
    -------
    session, truth : mapping        one table for each file
    """
    turn, shift = motion[:3, :3], motion[:3, 3]
    encoder = read_sensor(shift, config.position_sensor, rng=rng)
    session = {"name": name, "images": f"images/{name}_{{camera}}.png"}
    return session, {"name": name, "R": turn, "t": shift, "encoder": encoder}


def write_session(folder: Path, config: LabConfig, measured: Sequence[tuple[Table, Table]]) -> None:
    """Write session.toml and truth.toml.

    Parameters
    ----------
    folder : Path
    config : LabConfig
    measured : sequence of tables   of the session and of the truth, of every probing or step

    Raises
    ------
    OSError                         they cannot be written
    """
    material, staged = config.material, config.stage is not None
    heads: dict[str, list[tuple[str, Table]]] = {
        "session.toml": [
            ("", {"format": SESSION_FORMAT, "name": config.name}),
            ("[object]", {"mesh": "mesh.ply", "length_unit": "m"}),
            *([] if staged else [("[support]", config.specimen.support)]),
            ("[rig]", {"cameras": "rig.toml"}),
        ],
        "truth.toml": [
            (
                "",
                {
                    "young_modulus": material.young_modulus,
                    "poisson_ratio": material.poisson_ratio,
                    "shear_modulus": material.shear_modulus,
                    "law": material.law,
                    "seed": config.seed,
                },
            )
        ],
    }
    header = "[[step]]" if staged else "[[probe]]"
    for (name, head), rows in zip(heads.items(), zip(*measured, strict=True), strict=True):
        tables = head + [(header, row) for row in rows]
        text = "".join(toml_table(title, values) for title, values in tables)
        (folder / name).write_text(text.rstrip() + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """An array or its scalar as Python's own."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"no TOML for a {type(value).__name__}")
