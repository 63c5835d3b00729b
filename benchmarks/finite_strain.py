"""Constants of an object that was pressed far, with and without the correction for finite strain.

    python -m benchmarks.finite_strain

A glued neo-Hookean cube of 40 mm under a round patch of 12 mm, in quadratic tetrahedra that are
other ones than those of the correction; E and nu are compared with those that a linear cube of the
same elements gives. Two minutes of one core. The law of the material is the one that the correction
assumes.

    python -m benchmarks.finite_strain calculix [BODY-MESH ...]

Bodies into which CalculiX has pressed a ball of 10 mm, a fifth and a half of its radius deep, as
`benchmarks/data/calculix_press` holds them; the sessions name the ball, the fit finds what it
touches. Several minutes of one core for each body. CalculiX's neo-Hookean law keeps volume and
shape apart, other than the correction's; the estimate knows both.
"""

import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from benchmarks.bodies import box_mesh
from benchmarks.calculix_press import BALL, DEPTHS, SHEAR_MODULUS, pressed_body, session_mesh
from palpate.geometry import TriangleMesh, closest_points
from palpate.pipeline import fit_session
from palpate.records import (
    EXACT,
    Contact,
    DisplacementField,
    Probing,
    Session,
    Sphere,
)
from palpate.records.contact import PRESSURES
from palpate.solids import (
    held_nodes,
    make_body,
    make_solid,
    pressure_load,
    solve_finite,
    solve_load,
    surface_values,
)

SHEAR, NU, SIDE, RADIUS = 2e4, 0.3, 0.04, 12e-3
PLACE = np.array([1e-3, -1e-3, SIDE])
PUSHES = (1.5, 3.0)
STORED = Path(__file__).parent / "data" / "calculix_press"


def cube(push: float, moved: np.ndarray | None = None) -> Session:
    """The cube as a session, with displacements (n, 3) [m] of the vertices that are not held."""
    mesh = box_mesh(40, 40, 40)(10e-3)
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    points = seen_points(mesh)
    moved = np.zeros_like(points) if moved is None else moved
    field = DisplacementField(points, moved, None, None, closest_points(mesh, points), "")
    force = np.array([0.0, 0.0, -push])
    contact = Contact(PLACE, RADIUS, "smooth")
    probing = Probing("n", contact, force, np.full(3, 1e-3), None, None, field, None)
    return Session("cube", Path("cube"), mesh, held, (probing,), None, None, None, (), errors=EXACT)


def seen_points(mesh: TriangleMesh) -> np.ndarray:
    """Vertices off the ground."""
    return mesh.vertices[mesh.vertices[:, 2] > 1e-6]


def pressed(name: str, mesh: str, depth: int) -> Session:
    """A body of CalculiX's presses as a session that names the ball."""
    body, surface = pressed_body(name), session_mesh(name)
    low = np.isclose(surface.vertices[surface.triangles][:, :, 2], 0.0, atol=1e-9).all(axis=1)
    free = surface.vertices[:, 2] > 1e-6
    points = surface.vertices[free]
    probings = []
    for number, point in enumerate(body.point):
        file = STORED / f"{name}-{number}-{mesh}.npz"
        if not file.exists():
            continue
        with np.load(file) as stored:
            if not np.allclose(stored["position"], surface.vertices, rtol=0.0, atol=1e-9):
                raise SystemExit(f"{file} belongs to another mesh: make it again")
            moved, force = stored["displacement"][depth][free], stored["force"][depth]
        field = DisplacementField(points, moved, None, None, closest_points(surface, points), "")
        contact = Contact.under(Sphere(BALL), point, float(np.ptp(surface.vertices)))
        std = np.full(3, 1e-3)
        probings.append(Probing(f"n{number}", contact, force, std, None, None, field, None))
    return Session(
        name, Path(name), surface, np.flatnonzero(low), tuple(probings), None, None, None, (),
        errors=EXACT,
    )  # fmt: skip


def against_calculix(wanted: Iterable[str]) -> None:
    """Print errors of E and nu for each body, mesh and depth."""
    for key in wanted:
        name, mesh = key.rsplit("-", 1)
        ratio = pressed_body(name).poisson_ratio
        young = 2.0 * SHEAR_MODULUS * (1.0 + ratio)
        for number, depth in enumerate(DEPTHS):
            session = pressed(name, mesh, number)
            print(f"{key}, {len(session.probings)} presses, {depth:g} of the ball's radius deep")
            for corrected in (False, True):
                estimate = fit_session(session, finite_strain=corrected).estimate
                error = estimate.young_modulus.value / young - 1.0
                low, high = (100 * (end / young - 1.0) for end in estimate.young_modulus.ci95)
                least, most = (end - ratio for end in estimate.poisson_ratio.ci95)
                print(
                    f"  {'corrected' if corrected else 'linear':9s} E {100 * error:+6.2f} %"
                    f" ({low:+.2f} to {high:+.2f}), nu"
                    f" {estimate.poisson_ratio.value - ratio:+.4f} ({least:+.4f} to {most:+.4f})"
                    f"   {estimate.status}",
                    *(note for note in estimate.notes if note.startswith("Finite strain")),
                    flush=True,
                )


def against_ourselves() -> None:
    """Print errors of E and nu against the linear cube's, for each push."""
    for push in PUSHES:
        still = cube(push)
        solid = make_solid(still.mesh, edge=9e-3, fine=[(PLACE, RADIUS, 4e-3)])
        held = held_nodes(solid, still.held_triangles)
        body = make_body(solid, held, shear_modulus=SHEAR, poisson_ratio=NU)
        share = pressure_load(solid, PLACE, RADIUS, PRESSURES["smooth"])
        load = share[:, None] * still.probings[0].force
        seen = surface_values(solid, seen_points(still.mesh))
        nodal = solve_finite(body, load)
        truth = fit_session(cube(push, seen @ solve_load(body, load))).estimate
        depth = float(np.abs(nodal).max()) / RADIUS
        print(f"pressed in by {100 * depth:.0f} % of the contact's radius")
        for name, corrected in (("linear", False), ("corrected", True)):
            estimate = fit_session(cube(push, seen @ nodal), finite_strain=corrected).estimate
            error = estimate.young_modulus.value / truth.young_modulus.value - 1
            print(
                f"  {name:9s} E {100 * error:+6.2f} %, nu"
                f" {estimate.poisson_ratio.value - truth.poisson_ratio.value:+.4f}"
                f"   {estimate.status}",
                flush=True,
            )


if __name__ == "__main__":
    if sys.argv[1:2] == ["calculix"]:
        against_calculix(sys.argv[2:] or ("half_ball-coarse", "block-coarse"))
    else:
        against_ourselves()
