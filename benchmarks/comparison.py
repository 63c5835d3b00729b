"""The same data through Palpate, a fit of finite elements, virtual fields and Hertz's half space.

    python -m benchmarks.comparison FOLDER [SEEDS]

Bodies, truth and sessions are those of `benchmarks.coverage_of_bodies`: three pushes, 1 % noise and
whatever else a careful laboratory gets wrong. FOLDER keeps the truth, which takes minutes a body.
All are told mesh, support, forces, contacts and displacements. Palpate alone is told how wrong they
may be; virtual fields and Hertz alone see under the tool.
"""

import csv
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import approx_fprime, least_squares
from scipy.stats import t as student

from benchmarks.coverage_of_bodies import FARTHEST, NOISE, Measured, measured_body, session
from palpate.geometry import TriangleMesh
from palpate.pipeline import fit_session
from palpate.records import Session
from palpate.records.contact import smooth_pressure
from palpate.records.error_priors import ErrorPriors
from palpate.solids import (
    held_nodes,
    make_body,
    make_solid,
    pressure_load,
    solve_load,
    surface_values,
)

BODIES = ("block", "slab")
TABLE = Path(__file__).parent / "data" / "comparison.csv"
# Elements under a tool over its radius. With exact data the fitted E of the block is 0.3 % low,
# that of the slab 2.6 %.
_FINE = 0.4
# Displacement in the middle of a pressure (1 - r^2 / a^2)^2 on a half space, over
# F (1 - nu^2) / (E a): 0.75 under Hertz's own.
_MIDDLE = 3.2 / np.pi
# Value, lower and upper end of a 95 % interval: of E and nu, or of E alone.
Answer = Float[np.ndarray, "constants 3"]


def palpate(given: Session, _: Measured) -> Answer:
    """What `palpate fit` says."""
    estimate = fit_session(given).estimate
    return np.array([[a.value, *a.ci95] for a in (estimate.young_modulus, estimate.poisson_ratio)])


def finite_elements(given: Session, _: Measured) -> Answer:
    """Quadratic tetrahedra fitted by SciPy, interval from Jacobian and residuals."""
    contacts = [probing.contact for probing in given.probings]
    areas = np.linalg.norm(_areas(given.mesh), axis=1)
    edge = np.sqrt(4 / np.sqrt(3) * areas.mean())
    fine = [(contact.point, 1.2 * contact.radius, _FINE * contact.radius) for contact in contacts]
    solid = make_solid(given.mesh, edge=edge, fine=fine)
    held = held_nodes(solid, given.held_triangles)
    loads = [
        pressure_load(solid, a.point, a.radius, smooth_pressure)[:, None] * probing.force
        for a, probing in zip(contacts, given.probings, strict=True)
    ]
    fields = [probing.displacement for probing in given.probings]
    seen = [np.isfinite(field.displacement[:, 0]) for field in fields]
    at = surface_values(solid, fields[0].points)

    def residual(unknown: np.ndarray) -> np.ndarray:
        body = make_body(solid, held, shear_modulus=np.exp(unknown[0]), poisson_ratio=unknown[1])
        return np.concatenate(
            [
                ((at @ solve_load(body, load) - field.displacement) / field.std)[points].ravel()
                for load, field, points in zip(loads, fields, seen, strict=True)
            ]
        )

    start, bounds = (np.log(1e4), 0.3), ([-np.inf, -0.9], [np.inf, 0.499])
    fit = least_squares(residual, start, bounds=bounds, x_scale=(1.0, 0.1), diff_step=1e-4)
    freedom = len(fit.fun) - 2
    covariance = 2 * fit.cost / freedom * np.linalg.inv(fit.jac.T @ fit.jac)
    young = lambda unknown: 2 * np.exp(unknown[0]) * (1 + unknown[1])  # noqa: E731
    return _with_intervals((young, lambda unknown: unknown[1]), fit.x, covariance, freedom)


def virtual_fields(given: Session, body: Measured) -> Answer:
    """Linear virtual displacements z b that vanish on the support need the strain's integral only,
    which follows from the surface: sum of u n over it. Three equations a push."""
    rows: list[list[float]] = []
    right: list[float] = []
    area = _areas(given.mesh)
    for probing, moved in zip(given.probings, _seen_everywhere(given, body), strict=True):
        gradient = moved[given.mesh.triangles].mean(axis=1).T @ area
        strain = 0.5 * (gradient + gradient.T)
        rows += [[np.trace(strain) * (a == 2), 2 * strain[a, 2]] for a in range(3)]
        right += list(probing.force * probing.contact.point[2])
    matrix = np.array(rows)
    (lame, shear), (square,), *_ = np.linalg.lstsq(matrix, np.array(right))
    freedom = len(right) - 2
    covariance = square / freedom * np.linalg.inv(matrix.T @ matrix)
    young = lambda x: x[1] * (3 * x[0] + 2 * x[1]) / (x[0] + x[1])  # noqa: E731
    ratio = lambda x: 0.5 * x[0] / (x[0] + x[1])  # noqa: E731
    return _with_intervals((young, ratio), np.array([lame, shear]), covariance, freedom)


def hertz(given: Session, body: Measured, poisson_ratio: float | None = None) -> Answer:
    """A half space under each push alone: mean of E, interval from the scatter of the pushes."""
    ratio = body.shape.poisson_ratio if poisson_ratio is None else poisson_ratio
    young: list[float] = []
    fields = _seen_everywhere(given, body)
    for probing, push, moved in zip(given.probings, body.pushes, fields, strict=True):
        nearest = np.linalg.norm(given.mesh.vertices - push.point, axis=1).argmin()
        depth = moved[nearest] @ push.inward
        force = probing.force @ push.inward
        young.append(_MIDDLE * force * (1 - ratio**2) / (probing.contact.radius * depth))
    half = student.ppf(0.975, len(young) - 1) * np.std(young, ddof=1) / np.sqrt(len(young))
    return np.mean(young) + np.array([[0.0, -half, half]])


METHODS: dict[str, Callable[[Session, Measured], Answer]] = {
    "Palpate": palpate,
    "finite elements, least squares": finite_elements,
    "virtual fields": virtual_fields,
    "half space, nu as it is": hertz,
    "half space, nu 0.5": lambda given, body: hertz(given, body, 0.5),
}


def _areas(mesh: TriangleMesh) -> Float[np.ndarray, "m 3"]:
    """Normal of every triangle times its area."""
    corner = mesh.vertices[mesh.triangles]
    return 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])


def _with_intervals(
    constants: Sequence[Callable[[np.ndarray], float]],
    best: np.ndarray,
    covariance: np.ndarray,
    freedom: int,
) -> Answer:
    """Values of functions of what was fitted, to first order."""
    answer = []
    for constant in constants:
        slope = approx_fprime(best, constant, 1e-6 * np.abs(best))
        half = student.ppf(0.975, freedom) * np.sqrt(slope @ covariance @ slope)
        answer.append(constant(best) + np.array([0.0, -half, half]))
    return np.array(answer)


def _seen_everywhere(given: Session, body: Measured) -> list[np.ndarray]:
    """Displacement of every vertex: also under the tool, with the same noise."""
    rng, support = np.random.default_rng(49), given.mesh.triangles[given.held_triangles]
    every = []
    for probing, moved in zip(given.probings, body.moved, strict=True):
        true = FARTHEST / np.linalg.norm(moved, axis=1).max() * moved
        full = true + NOISE * np.sqrt((true**2).mean()) * rng.normal(size=true.shape)
        field = probing.displacement.displacement
        full[body.seen] = np.where(np.isfinite(field), field, full[body.seen])
        full[support] = 0.0
        every.append(full)
    return every


def row(name: str, body: Measured, seed: int) -> dict[str, str | int]:
    """Processor seconds and errors of one method on one session."""
    given = session(body, ErrorPriors(), NOISE, seed)
    before = time.process_time()
    answer = METHODS[name](given, body)
    row: dict[str, str | int] = {"body": body.name, "method": name, "seed": seed}
    row["seconds"] = f"{time.process_time() - before:.3f}"
    ratio, young = body.shape.poisson_ratio, body.truth["young_modulus"]
    for what, (value, low, high), true, unit in zip(
        ("E", "nu"), answer, (young, ratio), (young / 100, 1.0), strict=False
    ):
        row[f"{what} off"] = f"{(value - true) / unit:.4f}"
        row[f"{what} +-"] = f"{(high - low) / 2 / unit:.4f}"
        row[f"{what} held"] = int(low <= true <= high)
    return row


def lines(rows: Sequence[dict[str, str]]) -> list[str]:
    """Lines of the table in docs/comparison.md."""
    table_rows = []
    for key in dict.fromkeys((result["body"], result["method"]) for result in rows):
        matching = [result for result in rows if (result["body"], result["method"]) == key]
        cells = [*key, f"{np.median([float(result['seconds']) for result in matching]):.2g}"]
        for what, digits in (("E", 1), ("nu", 3)):
            if not matching[0][f"{what} off"]:
                cells += ["-", "-", "-"]
                continue
            off, half = (
                np.array([float(result[f"{what} {name}"]) for result in matching])
                for name in ("off", "+-")
            )
            cells += [f"{off.mean():+.{digits}f}; {np.sqrt((off**2).mean()):.{digits}f}"]
            cells += [f"{np.median(half):.{digits}f}"]
            cells += [
                f"{sum(int(result[f'{what} held']) for result in matching)} of {len(matching)}"
            ]
        table_rows.append(f"| {' | '.join(cells)} |")
    return table_rows


def main() -> None:
    """Measure, write every row, and print the page's table."""
    folder, seeds = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 5
    bodies = [measured_body(name, folder, seen=1.0) for name in BODIES]
    for method in METHODS.values():  # Kernels are compiled before anything is timed.
        method(session(bodies[0], ErrorPriors(), NOISE, seeds), bodies[0])
    columns = ["body", "method", "seed", "seconds"]
    columns += [f"{what} {name}" for what in ("E", "nu") for name in ("off", "+-", "held")]
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval="", lineterminator="\n")
        writer.writeheader()
        for body in bodies:
            for name in METHODS:
                for seed in range(seeds):
                    writer.writerow(answer := row(name, body, seed))
                    print(answer, flush=True)
                    file.flush()
    with TABLE.open(newline="", encoding="utf-8") as file:
        print("\n".join(lines(list(csv.DictReader(file)))))


if __name__ == "__main__":
    main()
