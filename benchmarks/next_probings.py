"""Three probings where `palpate plan --next` says, against three at random: the interval of nu.

Places are those that a tool can reach on each body; what a probing tells is Fisher's information
with every error that points share. Run it with

    python -m benchmarks.next_probings FOLDER [BODY ...]

FOLDER keeps the true displacements of `benchmarks.coverage_of_bodies`.
"""

import sys
from pathlib import Path

import numpy as np

from benchmarks.coverage_of_bodies import NOISE, measured_body, session
from palpate.estimation import Information
from palpate.pipeline import plan_next
from palpate.records.error_priors import ErrorPriors

FIVE = ("slab", "block", "egg", "bracket", "plate")
DRAWS, COUNT = 50, 3
# Of all triples of places, for the best that could be chosen.
TRIPLES = 3000


def best(information: Information, places: list[int]) -> list[int]:
    """As many places as wanted, one after the other, from nothing."""
    chosen: list[int] = []
    for _ in range(COUNT):
        left = [k for k in places if k not in chosen]
        gain = [np.linalg.det(information.of([*chosen, k])) for k in left]
        chosen.append(left[int(np.argmax(gain))])
    return chosen


def main() -> None:
    """Print the ratio of the standard deviations of nu, chosen over random, median of 50 draws, and
    that of the best places."""
    folder, ratios = Path(sys.argv[1]), []
    for name in sys.argv[2:] or FIVE:
        measured = session(measured_body(name, folder), ErrorPriors(), NOISE, 0)
        plan = plan_next(measured, count=1)
        made = len(measured.probings)
        places = [made + k for k in range(len(plan.point))]
        rng = np.random.default_rng(0)
        chosen = plan.information.bound(best(plan.information, places))["poisson_ratio"]
        drawn = [
            plan.information.bound(rng.choice(places, COUNT, replace=False).tolist())
            for _ in range(DRAWS + TRIPLES)
        ]
        every = [bound["poisson_ratio"] for bound in drawn]
        usual, least = float(np.median(every[:DRAWS])), min(every[DRAWS:])
        ratios.append(chosen / usual)
        print(
            f"{name:10s} {len(places)} places: {ratios[-1]:.2f}, best of {TRIPLES} triples"
            f" {least / usual:.2f}",
            flush=True,
        )
    print(f"median {np.median(ratios):.2f}")


if __name__ == "__main__":
    main()
