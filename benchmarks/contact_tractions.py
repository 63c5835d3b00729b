"""What a sphere's outward tractions do to the constants, for a model that presses along one way.

    python -m benchmarks.contact_tractions

The demonstration's half ball is pressed by a frictionless sphere in finite elements. Exact
displacements of the vertices more than 10 mm from the contact are fitted, with the true force,
point and radius: once of the forces as they are, normal to the dented surface, then of their
components along the press alone; and as they are for a session that names the tool, whose pressure
has an outward part.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.geometry import closest_points
from palpate.lab import built_in, half_ball, read_lab_config
from palpate.lab.arm import aim, solid_under
from palpate.pipeline import fit_session
from palpate.records import (
    EXACT,
    Contact,
    DisplacementField,
    Probing,
    Session,
    Sphere,
)
from palpate.solids import held_nodes, make_body, press_to_force, surface_values
from palpate.solids.finite_elements import solve_load

_EDGE, _AWAY = 0.0042, 0.010


def main() -> None:
    """Print both rows."""
    config = read_lab_config(built_in()["demo"])
    mesh = half_ball(radius=0.04, edge=_EDGE)
    held = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < 1e-6).all(axis=1))
    free = mesh.vertices[np.setdiff1d(np.arange(len(mesh.vertices)), mesh.triangles[held])]
    probings: dict[str, list[Probing]] = {
        name: [] for name in ("as they are", "along the press", "the tool named")
    }
    material, specimen = config.material, config.specimen
    for k, probe in enumerate(config.probes):
        tip = aim(probe, config.arm, specimen.mesh, rng=np.random.default_rng([1, 1, k]))
        solid = solid_under(specimen, tip, probe, material)
        body = make_body(
            solid, held_nodes(solid, specimen.held), shear_modulus=material.shear_modulus,
            poisson_ratio=material.poisson_ratio,
        )  # fmt: skip
        pressed = press_to_force(body, tip, float(probe.force or 0.0))
        way = pressed.force / np.linalg.norm(pressed.force)
        straight = solve_load(body, (pressed.load @ way)[:, None] * way)
        point = closest_points(mesh, probe.point[None]).position[0]
        contact = Contact(point, pressed.radius, "hertz")
        seen = free[np.linalg.norm(free - point, axis=1) > _AWAY]
        for name, moved in (("as they are", pressed.displacement), ("along the press", straight)):
            field = DisplacementField(
                seen,
                surface_values(solid, seen) @ moved,
                None,
                None,
                closest_points(mesh, seen),
                "",
            )
            probings[name].append(
                Probing(f"n{k}", contact, pressed.force, None, None, None, field, None)
            )
        ball = Contact.under(Sphere(tip.radius), point)
        probings["the tool named"].append(replace(probings["as they are"][-1], contact=ball))
    for name, several in probings.items():
        session = Session(
            "half ball", Path(), mesh, held, tuple(several), None, None, None, (), errors=EXACT
        )
        estimate = fit_session(session).estimate
        young, ratio = estimate.young_modulus, estimate.poisson_ratio
        print(
            f"forces {name:16s} E {100 * (young.value / material.young_modulus - 1):+.2f} %"
            f" (+- {100 * young.std / young.value:.2f}),"
            f" nu {ratio.value - material.poisson_ratio:+.4f} (+- {ratio.std:.4f})",
            flush=True,
        )


if __name__ == "__main__":
    main()
