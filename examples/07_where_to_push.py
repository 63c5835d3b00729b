"""Where to push so that Poisson's ratio comes out best: the bound of Cramer and Rao.

python examples/07_where_to_push.py
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.estimation import fisher_information
from palpate.pipeline import make_object_model, session_observations
from palpate.records import read_session

HERE = Path(__file__).parent
POISSON_RATIO = 0.30
SHEAR_MODULUS = 60e3 / 2.6
SIGMA = 5e-5  # of each component of a displacement [m]


def main() -> dict[str, float]:
    """Bound on the standard deviation of nu for each probing of the half ball, and for all."""
    session = read_session(HERE / "half_ball")
    model = make_object_model(session)
    probes = session_observations(session, model)
    # What the bound asks is where one looks and how well, not what was seen there.
    probes = [
        replace(
            probe,
            displacement=np.zeros_like(probe.position),
            std=np.full(probe.position.shape, SIGMA),
        )
        for probe in probes
    ]
    bounds = {}
    for name, chosen in [*((probe.name, [probe]) for probe in probes), ("all", probes)]:
        bound = fisher_information(
            chosen, poisson_ratio=POISSON_RATIO, shear_modulus=SHEAR_MODULUS
        ).bound()
        bounds[name] = bound["poisson_ratio"]
        relative = bound["shear_modulus"] / SHEAR_MODULUS
        print(f"{name:4s} nu +- {bound['poisson_ratio']:.4f}   G +- {100 * relative:.2f} %")
    best = min((name for name in bounds if name != "all"), key=bounds.__getitem__)
    print(f"for nu push at {best}")
    return bounds


if __name__ == "__main__":
    main()
