"""Does the stiffening of a material come out, from loads of 1 : 4, and only where there is one.

    python -m benchmarks.stiffening [TOOL ...]

A half ball of 40 mm is pressed near its pole by a ball of 10 mm or by the flat face of
a punch of 6 mm. Its law is Yeoh's as CalculiX and Abaqus have it, other than the estimate's,
which couples shape and volume in its neo-Hookean part; its quadratic tetrahedra are finer than
those of the estimate, and other ones, but the code is the same: CalculiX's own truth is that of
`benchmarks.finite_strain`. Then noise of 1 % of the largest motion is drawn anew, 200 times, of
materials that stiffen and that do not; every draw is fitted about the corrections of the data
without noise.
"""

import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.calculix_press import BALL, pressed_body, session_mesh
from palpate.geometry import closest_points
from palpate.pipeline import fit_session
from palpate.records import EXACT, FLAT, SPHERE, DisplacementField, Probing, Session, Tool
from palpate.solids import (
    LawOf,
    Punch,
    Sphere,
    SplitNeoHookean,
    held_nodes,
    make_body,
    make_solid,
    press_finite,
    surface_values,
    yeoh,
)

SHEAR, NU, STIFFENING = 2e4, 0.3, 3.0
# Largest force of each tool [N], and the others over it.
FORCES = {"ball": 1.6, "punch": 1.6}
LOADS = np.array([0.25, 0.5, 1.0])
PUNCH = 6e-3
LAWS = {
    "stiffens": yeoh(STIFFENING, SplitNeoHookean),
    "neo-Hookean": SplitNeoHookean,
}


def pressed(tool: str, law: LawOf) -> Session:
    """The half ball under three forces at one place."""
    body, mesh = pressed_body("half_ball"), session_mesh("half_ball")
    point, inward = body.point[0], body.inward[0]
    low = np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0, atol=1e-9).all(axis=1)
    points = mesh.vertices[mesh.vertices[:, 2] > 1e-6]
    solid = make_solid(body.surface, edge=8e-3, fine=[(point, 0.8 * BALL, 2e-3)])
    flat = np.isclose(body.surface.vertices[body.surface.triangles][:, :, 2], 0.0, atol=1e-9)
    held = held_nodes(solid, np.flatnonzero(flat.all(axis=1)))
    truth = make_body(solid, held, shear_modulus=SHEAR, poisson_ratio=NU)
    seen = surface_values(solid, points)
    kind, tip = {
        "ball": (Tool(SPHERE, BALL), Sphere(BALL, point, inward)),
        "punch": (Tool(FLAT, PUNCH), Punch(PUNCH, point, inward)),
    }[tool]
    contact = kind.contact(point, float(np.ptp(mesh.vertices)))
    probings, start = [], None
    for force in FORCES[tool] * LOADS:
        start = press_finite(truth, tip, force, law=law, start=start)
        nodal = start.displacement
        place = closest_points(mesh, points)
        field = DisplacementField(points, seen @ nodal, None, None, place, "")
        print(f"  {force:.2f} N: {1e3 * float((nodal @ inward).max()):.2f} mm", flush=True)
        std = np.full(3, 1e-3)
        probings.append(
            Probing(f"n{len(probings)}", contact, force * inward, std, None, None, field, None)
        )
    return Session(
        tool, Path(tool), mesh, np.flatnonzero(low), tuple(probings), None, None, None, (),
        errors=EXACT,
    )  # fmt: skip


def main(tools: list[str]) -> None:
    for tool in tools:
        for name, law in LAWS.items():
            print(f"{tool}, {name}", flush=True)
            session = pressed(tool, law)
            before = time.perf_counter()
            found = fit_session(session, finite_strain=True).estimate
            seconds = time.perf_counter() - before
            shear, nu, stiff = found.shear_modulus, found.poisson_ratio, found.stiffening
            print(
                f"  G {100 * (shear.value / SHEAR - 1):+.2f} % {shear.ci95},"
                f" nu {nu.value - NU:+.4f} {nu.ci95}, stiffening {stiff}, {found.status},"
                f" {seconds:.0f} s",
                flush=True,
            )
            print("  ", *found.notes, *found.details, sep="\n    ", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:] or list(FORCES))
