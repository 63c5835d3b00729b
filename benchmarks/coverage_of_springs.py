"""Do the intervals hold where the support gives, and what does a fit on springs cost?

The truth comes from quadratic tetrahedra on a bed of springs. A laboratory knows the springs, or
knows them to a fifth and says so as `support_compliance`; all else is wrong by draws from the
priors. Run it with

    python -m benchmarks.coverage_of_springs FOLDER [SESSIONS [BODY ...]]

FOLDER keeps the true displacements, which take minutes a body.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.coverage_of_bodies import (
    NOISE,
    Measured,
    counts,
    errors_of,
    held,
    measured_body,
    session,
)
from palpate.pipeline import fit_session
from palpate.records import EXACT, Estimate, Session, Support
from palpate.records.error_priors import ErrorPriors

# Traction over displacement [N/m^3]: of rubber of 0.1 MPa, 30 mm thick.
STIFFNESS = 3e6
# Of the compliance, where the laboratory does not know it better.
UNSURE = 0.2
BODIES = ("block", "egg")


def measured_session(
    body: Measured, errors: ErrorPriors, noise: float, seed: int, unsure: float
) -> Session:
    """A session that tells the springs, wrong by as much as it says they may be."""
    draw = np.random.default_rng([seed, 77]).normal()
    softer = 1.0 + unsure * float(np.clip(draw, -2.5, 2.5))
    plain = session(body, replace(errors, support_compliance=unsure / STIFFNESS), noise, seed)
    support = Support(plain.held_triangles, stiffness=STIFFNESS / softer)
    return replace(plain, supports=(support,))


def timed(given: Session, folder: Path) -> tuple[Estimate, float]:
    """The fit of a session and the processor's time that it took [s]."""
    start = time.process_time()
    estimate = fit_session(given, cache=folder / "integrals").estimate
    return estimate, time.process_time() - start


def main() -> None:
    """Print errors of clean data, times, and how often intervals hold."""
    folder, count = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 10
    every: dict[str, list[np.ndarray]] = {"known": [], "to a fifth": []}
    for name in sys.argv[3:] or BODIES:
        body = measured_body(name, folder, STIFFNESS)
        clean = measured_session(body, EXACT, 0.0, 0, 0.0)
        rigid = replace(clean, supports=(Support(clean.held_triangles),))
        for kind, given in (("clean", clean), ("clean, taken as rigid", rigid)):
            print(f"{name}: {kind} {errors_of(timed(given, folder)[0], body.truth)}", flush=True)
        for seed in range(count):
            for known, unsure in zip(every, (0.0, UNSURE), strict=True):
                noisy = measured_session(body, ErrorPriors(), NOISE, seed, unsure)
                estimate, seconds = timed(noisy, folder)
                every[known].append(held(estimate, body.truth))
                print(
                    f"{name}: springs {known}, session {seed:2d}, {seconds:4.1f} s "
                    f"{errors_of(estimate, body.truth)}",
                    flush=True,
                )
    for known, holding in every.items():
        print(f"springs {known}: of {len(holding)} sessions intervals hold {counts(holding)}")


if __name__ == "__main__":
    main()
