"""Do the intervals of known regions hold, with errors drawn from their priors?

The bodies and parts of `heterogeneous.py`, solved by elements whose faces follow the parts, pressed
ten times; what a session tells is wrong by draws from its priors, as in `coverage_of_bodies.py`.
Run it with

    python -m benchmarks.coverage_of_regions FOLDER [SESSIONS [BODY ...]] [--kind KIND ...]

FOLDER keeps the true displacements, and gets `regions.csv`: a row a session.
"""

import argparse
import csv
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.bodies import BODIES
from benchmarks.body_truth import SHEAR_MODULUS, Contact
from benchmarks.coverage_of_bodies import NOISE, Measured, constants, held, session
from benchmarks.heterogeneous import FITTED, PREDICTED, REGIONS, pushes, regions_of, true_motion
from palpate.pipeline import Material, fit_session
from palpate.records.error_priors import ErrorPriors

COLUMNS = (
    "body", "kind", "session", "status", "off", "sigma", "region_held", "ratio_off", "ratio_sigma",
    "nu_held", "shear_held", "young_held", "seconds",
)  # fmt: skip
Row = dict[str, str | float]


def measured(name: str, kind: str, folder: Path) -> Measured:
    """A body with one region under ten pushes, and its true displacements."""
    shape = BODIES[name]
    mesh = shape.make(shape.edge)
    at = pushes(mesh, shape, FITTED + PREDICTED, seed=0)
    moved = true_motion(name, kind, folder, at, 0)[:FITTED]
    places = tuple(Contact(point, force) for point, force in at[:FITTED])
    return Measured(name, mesh, shape, mesh.vertices, places, moved, 0.0, 0.0)


def fitted(body: Measured, kind: str, seed: int, folder: Path) -> Row:
    """What a fit of one draw says of the region and of the rest."""
    start, true = time.perf_counter(), REGIONS[kind][1]
    drawn = session(body, ErrorPriors(), NOISE, seed)
    drawn = replace(drawn, regions=regions_of(body.mesh, kind))
    cache = folder / "integrals"
    estimate = fit_session(drawn, cache=cache, material=Material.REGIONS).estimate
    (region,) = estimate.regions
    moduli = (region.shear_modulus, np.log(SHEAR_MODULUS) + true), (region.ratio, true)
    (off, sigma), (ratio_off, ratio_sigma) = (
        (float(np.log(modulus.value) - log), modulus.std / modulus.value) for modulus, log in moduli
    )
    low, high = region.shear_modulus.ci95
    holds = held(estimate, constants(body.shape))
    values = (
        body.name, kind, seed, str(estimate.status), off, sigma,
        int(low <= SHEAR_MODULUS * np.exp(true) <= high), ratio_off, ratio_sigma,
        *map(int, holds), time.perf_counter() - start,
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def summary(rows: Iterable[Row]) -> str:
    """How far off log G of the regions is, and how often intervals hold."""
    of = {name: np.array([row[name] for row in rows]) for name in COLUMNS[4:]}
    off, count = of["off"], len(of["off"])
    counts = ", ".join(
        f"{name} {int(of[f'{name}_held'].sum())}" for name in ("region", "nu", "shear", "young")
    )
    return (
        f"of {count}: log G off by {off.mean():+.3f} in the mean, {np.sqrt((off**2).mean()):.3f}"
        f" rms, over its sigma {np.sqrt(((off / of['sigma']) ** 2).mean()):.2f}; its ratio"
        f" {of['ratio_off'].mean():+.3f}, over its sigma"
        f" {np.sqrt(((of['ratio_off'] / of['ratio_sigma']) ** 2).mean()):.2f}; held: {counts};"
        f" {of['seconds'].mean():.0f} s each"
    )


def main() -> None:
    """Print a line a session and a kind, and write the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coverage_of_regions")
    parser.add_argument("folder", type=Path)
    parser.add_argument("sessions", type=int, nargs="?", default=20)
    parser.add_argument("body", nargs="*", default=["block"])
    parser.add_argument("--kind", nargs="+", choices=REGIONS, default=list(REGIONS))
    given = parser.parse_args()
    every: list[Row] = []
    for name in given.body:
        for kind in given.kind:
            body, rows = measured(name, kind, given.folder), list[Row]()
            for seed in range(given.sessions):
                rows.append(fitted(body, kind, seed, given.folder))
                row = rows[-1]
                print(
                    f"{name} {kind}: session {seed}, log G off by {row['off']:+.3f}"
                    f" (+- {row['sigma']:.3f}) {row['status']} {row['seconds']:.0f} s",
                    flush=True,
                )
                with (given.folder / "regions.csv").open("w", newline="") as file:
                    writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
                    writer.writeheader()
                    writer.writerows([*every, *rows])
            every += rows
            print(f"{name} {kind}: {summary(rows)}", flush=True)
    print(f"all: {summary(every)}")


if __name__ == "__main__":
    main()
