"""Exact data: does a right model call itself right, and how near is it?

The twelve bodies of `bodies.py`, truth from quadratic tetrahedra on two or three meshes, no noise.
The first test that any sceptic makes. Run it with

    python -m benchmarks.exact_bodies FOLDER [BODY ...]

FOLDER keeps the true displacements, which take minutes a body. Every line is one session: error of
E and nu with their standard deviations, status, which intervals hold, the largest posterior
standard deviation over its prior's, and forces left out: in two sessions of each body one is told
wrong.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.bodies import BODIES
from benchmarks.coverage_of_bodies import Measured, errors_of, held, measured_body, session
from palpate.pipeline import fit_session
from palpate.records import EXACT, Estimate, Session, Status
from palpate.records.error_priors import ErrorPriors

# Told standard deviation of displacements, over their root mean square.
TOLD = (0.001, 0.01)
# The probing whose force is told wrong, in two sessions of each body, and by how much.
WRONG, BY = "n2", (0.05, -0.05)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one session gave.

    Attributes
    ----------
    body, variant : str
    young, poisson : float          error of E, relative, and of nu
    is_ok : bool
    held : (3,) bool                which intervals hold
    freed : str                     the note on forces that were left out
    widest : float                  largest posterior over prior standard deviation
    """

    body: str
    variant: str
    young: float
    poisson: float
    is_ok: bool
    held: np.ndarray
    freed: str
    widest: float


def variants(body: Measured) -> Iterator[tuple[str, Session]]:
    """The sessions of a body, all exact, by what they tell."""
    exact = session(body, EXACT, 0.0, 0)
    usual = replace(exact, errors=ErrorPriors())
    yield "as it is", usual
    yield "every prior exact", exact
    yield "forces exact", replace(usual, errors=replace(usual.errors, force=0.0, force_gain=0.0))
    yield "force_std 0.1 %", replace(usual, errors=replace(usual.errors, force=0.001))
    yield "one probing", replace(usual, probings=usual.probings[:1])
    yield "three probings", replace(usual, probings=usual.probings[:3])
    yield "with tips", _with_tips(usual, body)
    for share in TOLD:
        yield f"std {100 * share:g} % of the motion", _with_std(usual, share)
    for share in BY:
        yield f"force of {WRONG} {100 * share:+g} %", _with_wrong_force(usual, share)


def _with_tips(given: Session, body: Measured) -> Session:
    """The displacement of every contact point, too, which is a place that is seen."""
    probings = []
    for probing, push, moved in zip(given.probings, body.pushes, body.moved, strict=True):
        nearest = int(np.linalg.norm(body.points - push.point, axis=1).argmin())
        size = float(np.linalg.norm(probing.force))
        probings.append(replace(probing, tip_displacement=size * moved[nearest]))
    return replace(given, probings=tuple(probings))


def _with_std(given: Session, share: float) -> Session:
    probings = []
    for probing in given.probings:
        field = probing.displacement
        sigma = share * float(np.sqrt(np.nanmean(field.displacement**2)))
        claimed = replace(field, std=np.full_like(field.displacement, sigma))
        probings.append(replace(probing, displacement=claimed))
    return replace(given, probings=tuple(probings))


def _with_wrong_force(given: Session, share: float) -> Session:
    probings = [
        replace(probing, force=(1.0 + share) * probing.force) if probing.name == WRONG else probing
        for probing in given.probings
    ]
    return replace(given, probings=tuple(probings))


def outcome(body: Measured, variant: str, estimate: Estimate) -> Outcome:
    """What a session gave."""
    truth = body.truth
    errors = [*estimate.errors, *(error for probe in estimate.probes for error in probe.errors)]
    return Outcome(
        body.name,
        variant,
        estimate.young_modulus.value / truth["young_modulus"] - 1.0,
        estimate.poisson_ratio.value - truth["poisson_ratio"],
        estimate.status is Status.OK,
        held(estimate, truth),
        next((note for note in estimate.notes if "was left out" in note), ""),
        max((error.std / error.prior_std for error in errors), default=0.0),
    )


def main() -> None:
    """Print every session, then how many are right."""
    folder, names = Path(sys.argv[1]), sys.argv[2:] or list(BODIES)
    outcomes = []
    for name in names:
        body = measured_body(name, folder, oblique=True)
        print(f"{name}: truth extrapolated by {100 * body.own:.2f} %")
        for variant, given in variants(body):
            estimate = fit_session(given, cache=folder / "integrals").estimate
            result = outcome(body, variant, estimate)
            outcomes.append(result)
            marks = "".join("." if holds else "x" for holds in result.held)
            print(
                f"  {variant:24s} {errors_of(estimate, body.truth)} {marks}"
                f" {result.widest:.3f} {result.freed}",
                flush=True,
            )
    print(_summary(outcomes))


def _summary(every: list[Outcome]) -> str:
    outcomes = [result for result in every if WRONG not in result.variant]
    wrong = [result for result in every if WRONG in result.variant]
    freed = sum(result.freed.count("'") == 2 and WRONG in result.freed for result in wrong)
    young = 100 * np.abs([result.young for result in outcomes])
    poisson = np.abs([result.poisson for result in outcomes])
    intervals = np.mean([result.held for result in outcomes])
    return (
        f"of {len(outcomes)} sessions: ok {sum(result.is_ok for result in outcomes)}; E off by at"
        f" most {young.max():.2f} %, 95 of 100 by {np.quantile(young, 0.95):.2f} %, half by"
        f" {np.median(young):.2f} %; nu by {poisson.max():.4f}, {np.quantile(poisson, 0.95):.4f},"
        f" {np.median(poisson):.4f}; intervals hold {100 * intervals:.1f} %; forces left out in"
        f" {sum(bool(result.freed) for result in outcomes)}; widest posterior over prior"
        f" {max(result.widest for result in outcomes):.4f}. Of {len(wrong)} wrong forces {freed}"
        " were found and no other, E off by at most"
        f" {100 * max(abs(result.young) for result in wrong):.2f} %"
    )


if __name__ == "__main__":
    main()
