"""What a session's file and its truth say of the facility's measurements."""

import numpy as np

from palpate.geometry import closest_points
from palpate.lab.bench.arm import Probed, contact_told
from palpate.lab.bench.readings import force_std, position_std, read_force, read_position
from palpate.lab.bench.session_writing import toml_table
from palpate.lab.config import LabConfig, Probe
from palpate.records import SESSION_FORMAT


def instant_name(probe: Probe, number: int) -> str:
    """Name of a probing's pictures: the last instant has the probing's own."""
    return probe.name if number == probe.steps else f"{probe.name}_{number}"


def head_of_session(config: LabConfig) -> str:
    """Name, object, support and rig."""
    support = "" if config.stage is not None else toml_table("[support]", config.specimen.support)
    return (
        toml_table("", {"format": SESSION_FORMAT, "name": config.name})
        + toml_table("[object]", {"mesh": "mesh.ply", "length_unit": "m"})
        + support
        + toml_table("[rig]", {"cameras": "rig.toml"})
    )


def probe_of_session(config: LabConfig, found: Probed, rng: np.random.Generator) -> str:
    """What the bench knows of a probing: readings, and where the arm was sent."""
    contact, last, probe = contact_told(found), found.states[-1], found.probe
    force = read_force(last.force, config.force_sensor, rng=rng)
    way = read_position(last.depth * found.tip.direction, config.position_sensor, rng=rng)
    sigma = force_std(last.force, config.force_sensor)
    loaded = [
        f"images/{instant_name(probe, number)}_{{camera}}.png"
        for number in range(1, probe.steps + 1)
    ]
    return toml_table(
        "[[probe]]",
        {
            "name": probe.name,
            "contact": {
                "point": contact.point, "radius": contact.radius, "profile": contact.profile,
            },
            "force": force,
            "force_std": sigma or None,
            "tip_displacement": way,
            "tip_displacement_std": position_std(config.position_sensor) or None,
            "images": {"rest": "images/rest_{camera}.png", "loaded": loaded},
        },
    )  # fmt: skip


def head_of_truth(config: LabConfig) -> str:
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


def probe_of_truth(config: LabConfig, found: Probed) -> str:
    """Where, how, and how hard it was really probed."""
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
