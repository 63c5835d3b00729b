"""Does the stiffening of a material come out, from loads of 1 : 4, and only where there is one.

    python -m benchmarks.stiffening

CalculiX has pressed a half ball of 40 mm near its pole by a ball of 10 mm or by the flat face of
a punch of 6 mm (`benchmarks.calculix_press`). Its law is Yeoh's, other than the estimate's, which
couples shape and volume in its neo-Hookean part. Then noise of 1 % of the largest motion is drawn
anew, 20 times, of materials that stiffen and that do not; every draw is fitted about the
corrections of the data without noise.
"""

import csv
import itertools
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.calculix_press import (
    BALL,
    PUNCH,
    SHEAR_MODULUS,
    STIFFENING,
    pressed_body,
    session_mesh,
)
from benchmarks.finite_strain import STORED
from palpate.estimation import FitResult, ProbeObservations, fit
from palpate.geometry import closest_points
from palpate.pipeline import fit_session
from palpate.pipeline.model import large_strain
from palpate.pipeline.model.stiffening import (
    estimated_stiffening,
    is_stiffening,
)
from palpate.records import (
    EXACT,
    Contact,
    DisplacementField,
    FlatFace,
    Probing,
    Session,
    Sphere,
)

TOOLS = {"ball": Sphere(BALL), "punch": FlatFace(PUNCH)}
MATERIALS = {"stiffens": STIFFENING, "plain": 0.0}
# Of noise, over the largest motion.
DRAWS, NOISE = 20, 0.01
TABLE = Path(__file__).parent / "data" / "stiffening.csv"


def pressed(tool: str, material: str, mesh: str) -> Session:
    """The half ball under three forces at one place."""
    name = f"{tool}_{material}"
    body, surface = pressed_body(name), session_mesh(name)
    low = np.isclose(surface.vertices[surface.triangles][:, :, 2], 0.0, atol=1e-9).all(axis=1)
    free = surface.vertices[:, 2] > 1e-6
    points = surface.vertices[free]
    contact = Contact.under(TOOLS[tool], body.point[0], float(np.ptp(surface.vertices)))
    closest, std = closest_points(surface, points), np.full(3, 1e-3)
    with np.load(STORED / f"{name}-0-{mesh}.npz") as stored:
        moved, forces = stored["displacement"][:, free], stored["force"]
    fields = [DisplacementField(points, field, None, None, closest, "") for field in moved]
    probings = tuple(
        Probing(f"n{k}", contact, force, std, None, None, field, None)
        for k, (force, field) in enumerate(zip(forces, fields, strict=True))
    )
    return Session(
        name, Path(name), surface, np.flatnonzero(low), probings, None, None, None, (),
        errors=EXACT,
    )  # fmt: skip


def fitted(session: Session) -> tuple[FitResult, list[ProbeObservations], list[ProbeObservations]]:
    """The estimate, the observations that it was made from, and those that told whether the
    material stiffens."""
    seen: list[list[ProbeObservations]] = []

    def recorded(probes: list[ProbeObservations], **options: Any) -> FitResult:
        seen.append(list(probes))
        return fit(probes, **options)

    with patch.object(large_strain, "fit", recorded):
        result = fit_session(session, finite_strain=True)
    telling = [
        probes
        for probes in seen
        if any(
            parameter.is_material
            for nuisance in probes[0].nuisances
            for parameter in nuisance.parameters
        )
    ]
    return result, seen[-1], telling[-1]


def noisy(
    observations: list[ProbeObservations], noise: list[np.ndarray]
) -> list[ProbeObservations]:
    """Observations with noise."""
    return [
        replace(probe, displacement=probe.displacement + drawn)
        for probe, drawn in zip(observations, noise, strict=True)
    ]


def row(tool: str, name: str, mesh: str) -> dict[str, Any]:
    """Errors of one estimate, and what draws of its noise say."""
    session, ratio = pressed(tool, name, mesh), pressed_body(f"{tool}_{name}").poisson_ratio
    before = time.perf_counter()
    result, last, telling = fitted(session)
    seconds, fitted_estimate = time.perf_counter() - before, result.estimate
    stiffening = estimated_stiffening(fit(telling))
    rng, held, shown, draws = np.random.default_rng(50), np.zeros(3), 0, []
    true = SHEAR_MODULUS, ratio, MATERIALS[name]
    largest = max(float(np.abs(probe.displacement).max()) for probe in last)
    for _ in range(DRAWS):
        noise = [NOISE * largest * rng.standard_normal(probe.displacement.shape) for probe in last]
        estimate = fit(noisy(last, noise)).estimate
        drawn_stiffening = estimated_stiffening(fit(noisy(telling, noise)))
        shown += is_stiffening(drawn_stiffening)
        constants = estimate.shear_modulus, estimate.poisson_ratio, drawn_stiffening
        draws.append([constant.value for constant in constants])
        held += [a.ci95[0] <= value <= a.ci95[1] for a, value in zip(constants, true, strict=True)]
    rms = np.sqrt(np.mean((np.array(draws) - true) ** 2, axis=0))
    return {
        "tool": tool,
        "material": name,
        "G off [%]": round(100 * (fitted_estimate.shear_modulus.value / SHEAR_MODULUS - 1), 2),
        "nu off": round(fitted_estimate.poisson_ratio.value - ratio, 4),
        "C2/C1 told": round(stiffening.value, 3),
        "seconds": round(seconds),
        "draws": DRAWS,
        "called stiffening": shown,
        "rms of G [%]": round(float(100 * rms[0] / SHEAR_MODULUS), 2),
        "rms of nu": round(float(rms[1]), 4),
        "rms of C2/C1": round(float(rms[2]), 3),
        "intervals hold G, nu, C2/C1 [%]": " ".join(f"{100 * x / DRAWS:.0f}" for x in held),
    }


def main() -> None:
    """Print and write every row."""
    rows = []
    for tool, name in itertools.product(TOOLS, MATERIALS):
        stored = [m for m in ("fine", "coarse") if (STORED / f"{tool}_{name}-0-{m}.npz").exists()]
        rows.append(row(tool, name, stored[0]))
        print(rows[-1], flush=True)
        with TABLE.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
