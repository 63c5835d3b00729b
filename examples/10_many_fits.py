"""Many fits on one model: do the intervals hold the truth as often as they say?

python examples/10_many_fits.py
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.estimation import fit
from palpate.pipeline import make_object_model, session_observations
from palpate.records import read_session

HERE = Path(__file__).parent
POISSON_RATIO, SHEAR_MODULUS = 0.30, 60e3 / 2.6
SIGMA = 3e-5  # of each component of a displacement [m]
REPEATS = 12


def main() -> float:
    """Fit repeats that differ by their noise; gives the share of intervals that hold nu."""
    session = read_session(HERE / "half_ball")
    # Integrals and factorisation, once: they depend on neither the noise nor the material.
    model = make_object_model(session)
    probes = session_observations(session, model)
    rng = np.random.default_rng(1)
    hits, values = 0, []
    for _ in range(REPEATS):
        repeat = []
        for probe in probes:
            count = len(probe.position)
            unit = probe.response.value(POISSON_RATIO)[: 3 * count]
            force = probe.force + probe.force_std * rng.standard_normal(3)
            moved = (unit[:, :3] @ force / SHEAR_MODULUS).reshape(-1, 3)
            noisy = moved + SIGMA * rng.standard_normal(moved.shape)
            std = np.full(moved.shape, SIGMA)
            # A tip that was not measured keeps its rows of the response, and says nothing.
            tip = np.full(3, np.nan)
            repeat.append(replace(probe, displacement=noisy, std=std, tip_displacement=tip))
        nu = fit(repeat).estimate.poisson_ratio
        hits += nu.ci95[0] <= POISSON_RATIO <= nu.ci95[1]
        values.append(nu.value)
    print(f"nu {np.mean(values):.4f}, spread {np.std(values, ddof=1):.4f}, truth {POISSON_RATIO}")
    print(f"{hits} of {REPEATS} intervals of 95 % hold it")
    return hits / REPEATS


if __name__ == "__main__":
    main()
