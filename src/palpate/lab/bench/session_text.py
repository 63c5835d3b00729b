"""A session and its truth as text: what the facility leaves is read like any other session."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from palpate.geometry import closest_points
from palpate.lab.bench.arm import Pressed
from palpate.lab.bench.readings import read_sensor, sensor_std
from palpate.lab.config import LabConfig, Probe
from palpate.records import SESSION_FORMAT, ContactProfile


def toml_value(value: Any) -> str:
    """A value as TOML: texts, numbers with all their digits, truth values, lists, inline tables.

    Parameters
    ----------
    value : str, bool, int, float, sequence, array or mapping of these

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
    """
    lines = [header] if header else []
    lines += [f"{key} = {toml_value(value)}" for key, value in values.items() if value is not None]
    return "\n".join(lines) + "\n\n"


def instant_name(probe: Probe, number: int) -> str:
    """Name of a probing's pictures: the last instant has the probing's own."""
    return probe.name if number == probe.steps else f"{probe.name}_{number}"


def session_head(config: LabConfig) -> str:
    """Name, object, support and rig."""
    support = "" if config.stage is not None else toml_table("[support]", config.specimen.support)
    return (
        toml_table("", {"format": SESSION_FORMAT, "name": config.name})
        + toml_table("[object]", {"mesh": "mesh.ply", "length_unit": "m"})
        + support
        + toml_table("[rig]", {"cameras": "rig.toml"})
    )


def session_probe(config: LabConfig, done: Pressed, rng: np.random.Generator) -> str:
    """What the bench knows of a probing: readings, and where the arm was sent.

    The contact is what a person at the bench would write down: for a sphere Hertz's pressure over
    the touched circle, for a punch an even one over its face.
    """
    probe, tip, last = done.probe, done.tip, done.states[-1]
    travel = last.depth * tip.direction
    values = {
        "name": probe.name,
        "contact": {
            "point": probe.point,
            "radius": tip.radius if tip.profile is ContactProfile.UNIFORM else last.radius,
            "profile": tip.profile.value,
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
    return toml_table("[[probe]]", values)


def session_step(name: str) -> str:
    """A step of a motion stage."""
    return toml_table("[[step]]", {"name": name, "images": f"images/{name}_{{camera}}.png"})


def truth_head(config: LabConfig) -> str:
    """Constants, law and seed."""
    material = config.material
    values = {
        "young_modulus": material.young_modulus,
        "poisson_ratio": material.poisson_ratio,
        "shear_modulus": material.shear_modulus,
        "law": material.law,
        "seed": config.seed,
    }
    return toml_table("", values)


def truth_probe(config: LabConfig, done: Pressed) -> str:
    """Where, how, and how hard it was really probed."""
    last = done.states[-1]
    # The tip's axis goes through the sphere's centre, one radius above the place.
    touched = closest_points(config.specimen.mesh, done.tip.point[None]).position[0]
    return toml_table(
        "[[probe]]",
        {
            "name": done.probe.name,
            "contact_point": touched,
            "contact_radius": last.radius,
            "direction": done.tip.direction,
            "force": last.force,
            "depth": last.depth,
            "load_steps": [state.depth / last.depth for state in done.states],
        },
    )


def truth_step(
    config: LabConfig, name: str, motion: np.ndarray, *, rng: np.random.Generator
) -> str:
    """A step's true motion, and what the stage's encoder says of it."""
    read = read_sensor(motion[:3, 3], config.position_sensor, rng=rng)
    values = {"name": name, "R": motion[:3, :3], "t": motion[:3, 3], "encoder": read}
    return toml_table("[[step]]", values)


def _plain(value: Any) -> Any:
    """An array or its scalar as Python's own."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"no TOML for a {type(value).__name__}")
