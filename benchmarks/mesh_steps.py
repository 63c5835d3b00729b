"""How far beyond the model's mesh does the truth lie, in the steps between meshes?

The twelve bodies of `bodies.py`, truth from quadratic tetrahedra, no noise, true constants: what
the model leaves over is fitted by what finer edges, wider fits and the grading change, and by the
dips about the contacts. Multiples are counted from what the model has of each step already: from 0
where it is right. Their deviations over the bodies are the priors of `pipeline/model/grading.py`,
`pipeline/model/contacts/perturbations.py` and `pipeline/observations/mesh_errors.py`. Run it with

    python -m benchmarks.mesh_steps FOLDER [BODY ...]

FOLDER keeps the true displacements, which take minutes a body. A step counts only where it explains
what is left over: in thin bodies, which bend as a whole, all of them look alike.
"""

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.bodies import BODIES
from benchmarks.coverage_of_bodies import Measured, measured_body, session
from palpate.estimation import ProbeObservations, ResponseTerms
from palpate.pipeline.observations.mesh_errors import graded_observations
from palpate.records import EXACT

# Standard error of a step's multiple [-], beyond which it says nothing.
_UNKNOWN = 0.3
# Points whose residuals are alike: of the modes of a smooth error there are far fewer than points.
_ALIKE = 20


def step_multiples(body: Measured) -> dict[str, list[tuple[float, float]]]:
    """Kind of step -> multiple of it that fits best, and its standard error: one for the body, or
    one for each contact."""
    shear, ratio = body.truth["shear_modulus"], body.truth["poisson_ratio"]
    columns, residuals = defaultdict[str, list[tuple[int, np.ndarray]]](list), []
    for k, probe in enumerate(graded_observations(session(body, EXACT, 0.0, 0))):
        residual, effects = _left_over(probe, ratio, shear)
        size = np.sqrt(np.nanmean(probe.displacement**2))
        residuals.append(residual / size)
        for name, effect in effects.items():
            columns[name].append((k, effect / size))
    ends = np.cumsum([0, *map(len, residuals)])
    table = np.zeros((ends[-1], len(columns)))
    for column, parts in enumerate(columns.values()):
        for k, effect in parts:
            table[ends[k] : ends[k + 1], column] = effect
    left = np.concatenate(residuals)
    multiple, *_ = np.linalg.lstsq(table, left, rcond=None)
    noise = _ALIKE * float(np.mean((left - table @ multiple) ** 2))
    error = np.sqrt(noise * np.diag(np.linalg.pinv(table.T @ table)))
    found = defaultdict[str, list[tuple[float, float]]](list)
    for name, value, one in zip(columns, multiple, error, strict=True):
        kind = "dips about contacts" if "in dips" in name else name.split(" (in steps")[0]
        found[kind].append((float(value), float(one)))
    return found


def _left_over(
    probe: ProbeObservations, ratio: float, shear: float
) -> tuple[Float[np.ndarray, " r"], dict[str, Float[np.ndarray, " r"]]]:
    """True minus modelled displacement, and what one step of each kind changes."""
    rows = np.flatnonzero(np.isfinite(probe.displacement.ravel()))
    at = ResponseTerms(rows, probe.response_terms(ratio)[rows], ratio)
    load = np.concatenate([np.append(probe.force, 1.0) / shear, probe.motion])
    effects = {}
    for nuisance in probe.nuisances:
        moved = np.einsum("rcp,c->rp", nuisance.effects(at)[:, 0], load)
        for parameter, column in zip(nuisance.parameters, moved.T, strict=True):
            effects[parameter.name] = column / parameter.std
    return probe.displacement.ravel()[rows] - at.value[:, 0] @ load, effects


def main() -> None:
    """Print the multiples of every body, then their mean and deviation over all that are known."""
    folder, names = Path(sys.argv[1]), sys.argv[2:] or list(BODIES)
    every = defaultdict[str, list[float]](list)
    for name in names:
        for kind, found in step_multiples(measured_body(name, folder, oblique=True)).items():
            text = " ".join(f"{value:+.2f}({error:.2f})" for value, error in found)
            print(f"{name:10s} {kind:30s} {text}", flush=True)
            every[kind] += [value for value, error in found if error < _UNKNOWN]
    for kind, values in every.items():
        print(
            f"{kind:30s} mean {np.mean(values):+.2f}, deviation {np.std(values):.2f}, median"
            f" {np.median(values):+.2f} of {len(values)}"
        )


if __name__ == "__main__":
    main()
