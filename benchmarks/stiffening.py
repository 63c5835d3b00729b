"""Does the stiffening of a material come out, from loads of 1 : 4, and only where there is one.

    python -m benchmarks.stiffening

A half ball of 40 mm is pressed near its pole by a ball of 10 mm or by the flat face of
a punch of 6 mm. Its law is Yeoh's as CalculiX and Abaqus have it, other than the estimate's,
which couples shape and volume in its neo-Hookean part; its quadratic tetrahedra are finer than
those of the estimate, and other ones, but the code is the same: CalculiX's own truth is that of
`benchmarks.finite_strain`. Then noise of 1 % of the largest motion is drawn anew, 100 times, of
materials that stiffen and that do not; every draw is fitted about the corrections of the data
without noise.
"""

import csv
import itertools
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.calculix_press import BALL, pressed_body, session_mesh
from palpate.estimation import FitResult, ProbeObservations, fit
from palpate.geometry import closest_points
from palpate.pipeline import fit_session
from palpate.pipeline.model import large_strain
from palpate.pipeline.model.large_strain import estimated_stiffening
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
# Of noise, over the largest motion.
DRAWS, NOISE = 100, 0.01
TABLE = Path(__file__).parent / "data" / "stiffening.csv"
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
    probings: list[Probing] = []
    start = None
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


def fitted(
    session: Session,
) -> tuple[FitResult, list[ProbeObservations], list[ProbeObservations]]:
    """The estimate, the observations that it was made from, and those that told whether the
    material stiffens."""
    seen: list[list[ProbeObservations]] = []

    def recorded(probes: list[ProbeObservations], **options: Any) -> FitResult:
        seen.append(list(probes))
        return fit(probes, **options)

    with patch.object(large_strain, "fit", recorded):
        result = fit_session(session, finite_strain=True)
    told = [
        probes
        for probes in seen
        if any(each.is_material for one in probes[0].nuisances for each in one.parameters)
    ]
    return result, seen[-1], told[-1]


def noisy(
    observations: list[ProbeObservations], noise: list[np.ndarray]
) -> list[ProbeObservations]:
    """Observations with noise."""
    return [
        replace(each, displacement=each.displacement + own)
        for each, own in zip(observations, noise, strict=True)
    ]


def row(tool: str, name: str, session: Session) -> dict[str, Any]:
    """Errors of one estimate, and what draws of its noise say."""
    before = time.perf_counter()
    result, last, telling = fitted(session)
    seconds, found = time.perf_counter() - before, result.estimate
    told = estimated_stiffening(fit(telling))
    rng, held, shown, draws = np.random.default_rng(50), np.zeros(3), 0, []
    true = SHEAR, NU, STIFFENING if name == "stiffens" else 0.0
    largest = max(float(np.abs(each.displacement).max()) for each in last)
    for _ in range(DRAWS):
        noise = [NOISE * largest * rng.standard_normal(each.displacement.shape) for each in last]
        estimate = fit(noisy(last, noise)).estimate
        own = estimated_stiffening(fit(noisy(telling, noise)))
        shown += large_strain.is_stiffening(own)
        constants = estimate.shear_modulus, estimate.poisson_ratio, own
        draws.append([each.value for each in constants])
        held += [a.ci95[0] <= value <= a.ci95[1] for a, value in zip(constants, true, strict=True)]
    rms = np.sqrt(np.mean((np.array(draws) - true) ** 2, axis=0))
    return {
        "tool": tool,
        "material": name,
        "G off [%]": round(100 * (found.shear_modulus.value / SHEAR - 1), 2),
        "nu off": round(found.poisson_ratio.value - NU, 4),
        "C2/C1 told": round(told.value, 3),
        "seconds": round(seconds),
        "draws": DRAWS,
        "called stiffening": shown,
        "rms of G [%]": round(float(100 * rms[0] / SHEAR), 2),
        "rms of nu": round(float(rms[1]), 4),
        "rms of C2/C1": round(float(rms[2]), 3),
        "intervals hold G, nu, C2/C1 [%]": " ".join(f"{100 * x / DRAWS:.0f}" for x in held),
    }


def main() -> None:
    """Print and write every row."""
    rows = []
    for tool, name in itertools.product(FORCES, LAWS):
        rows.append(row(tool, name, pressed(tool, LAWS[name])))
        print(rows[-1], flush=True)
        with TABLE.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
