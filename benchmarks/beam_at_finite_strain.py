"""The shipped beam by CalculiX: truth of a material that stiffens, and of a beam that sags.

    python -m benchmarks.beam_at_finite_strain

where `ccx` is installed; ten minutes of one core. The beam of `examples/beam` under its own loads,
of E 246 kPa and nu 0.45, in ten-node tetrahedra that are other ones than the fit's; where it sags,
its weight acts first, and displacements are counted from there. Its points get noise of 0.1 mm.
"""

import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import skfem

from benchmarks.machine import ROOT
from palpate.pipeline import fit_session
from palpate.records import Session, read_session
from palpate.shapes import Points
from palpate.solids import held_nodes, make_solid, pressure_load, surface_values
from palpate.solids.finite_elements import quadratic_basis

YOUNG, NU, NOISE = 246e3, 0.45, 1e-4
STIFFENING = 5.0
GRAVITY = 9.81


def pressed(session: Session, stiffening: float, *, sags: bool) -> list[Points]:
    """Displacement of the points of every probing [m]."""
    contact, forces = session.probings[0].contact, [probing.force for probing in session.probings]
    radius = float(contact.radius)
    solid = make_solid(session.mesh, edge=8e-3, fine=[(contact.point, 1.3 * radius, 0.3 * radius)])
    share = pressure_load(solid, contact.point, radius, contact.pressure)
    volume = skfem.LinearForm(lambda v, _: 1.0 * v).assemble(quadratic_basis(solid))
    weight = -session.density * GRAVITY * volume if sags else np.zeros(len(volume))
    sizes = sorted({0.0, *(float(-force[2]) for force in forces)})
    shear = 0.5 * YOUNG / (1.0 + NU)
    first, volume = 0.5 * shear, 2.0 * 3.0 * (1.0 - 2.0 * NU) / YOUNG
    law = (first, stiffening * first, 0.0, volume, 1e9 * volume, 1e9 * volume)
    lines = [
        "*NODE, NSET=BODY",
        *_rows(solid.nodes),
        "*ELEMENT, TYPE=C3D10, ELSET=SOLID",
        *_rows(solid.elements + 1),
        "*NSET, NSET=HELD",
        *(f"{k + 1}," for k in np.flatnonzero(held_nodes(solid, session.held_triangles))),
        "*MATERIAL, NAME=SOFT",
        "*HYPERELASTIC, YEOH",
        ", ".join(f"{constant:.12g}" for constant in law),
        "*SOLID SECTION, ELSET=SOLID, MATERIAL=SOFT",
        "*BOUNDARY",
        "HELD, 1, 3, 0.",
    ]
    for size in sizes:
        nodal = weight - size * share
        lines += ["*STEP, NLGEOM, INC=400", "*STATIC", "0.2, 1., 1e-5, 0.5", "*CLOAD"]
        lines += [f"{k + 1}, 3, {nodal[k]:.12g}" for k in np.flatnonzero(weight - share)]
        lines += ["*NODE PRINT, NSET=BODY, FREQUENCY=1000", "U", "*END STEP"]
    seen = surface_values(solid, session.probings[0].displacement.surface.position)
    moved = [seen @ displacement for displacement in _run("\n".join([*lines, ""]), len(sizes))]
    return [moved[sizes.index(float(-force[2]))] - moved[0] for force in forces]


def _rows(table: np.ndarray) -> Iterator[str]:
    for k, row in enumerate(table):
        yield ", ".join([str(k + 1), *(f"{value:.12g}" for value in row)])


def _run(text: str, steps: int) -> list[Points]:
    """Displacement of all nodes at the end of every step."""
    if shutil.which("ccx") is None:
        raise SystemExit("CalculiX (ccx) is not installed: there is nothing to compare with")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "beam.inp").write_text(text, encoding="ascii")
        subprocess.run(["ccx", "beam"], cwd=folder, check=True, capture_output=True)
        printed = (Path(folder) / "beam.dat").read_text(encoding="ascii")
    parts = re.split(r"displacements \(vx.*\n", printed)[1:]
    if len(parts) < steps:
        raise SystemExit("CalculiX found no equilibrium")
    return [
        np.array([line.split()[1:] for line in part.splitlines() if line.strip()], dtype=float)
        for part in parts
    ]


def main() -> None:
    """Print what the fit says of each beam."""
    session = read_session(ROOT / "examples" / "beam")
    for stiffening, sags in ((0.0, False), (0.0, True), (STIFFENING, False), (STIFFENING, True)):
        rng, probings = np.random.default_rng(3), []
        for probing, exact in zip(
            session.probings, pressed(session, stiffening, sags=sags), strict=True
        ):
            moved = exact + NOISE * rng.normal(size=exact.shape)
            field = replace(probing.displacement, displacement=moved)
            probings.append(replace(probing, displacement=field))
        for finite_strain in (False, True):
            start = time.perf_counter()
            weight = np.array([0.0, 0.0, -GRAVITY]) if sags else None
            of = replace(session, probings=tuple(probings), gravity=weight, gravity_at_rest=True)
            estimate = fit_session(of, finite_strain=finite_strain).estimate
            young = estimate.young_modulus
            print(
                f"C2 / C1 {stiffening:g}, {'sags' if sags else 'weightless'},"
                f" {'finite' if finite_strain else 'small'} strain: {estimate.status.value},"
                f" E {young.value / 1e3:.1f} kPa, {100 * (young.value / YOUNG - 1):+.1f} %, 95 %"
                f" {young.ci95[0] / 1e3:.0f} to {young.ci95[1] / 1e3:.0f};"
                f" {time.perf_counter() - start:.0f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
