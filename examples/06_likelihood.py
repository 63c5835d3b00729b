"""The likelihood over shear modulus and Poisson's ratio, and how the two hang together.

python examples/06_likelihood.py
"""

from pathlib import Path

import numpy as np

from palpate.pipeline import fit_session
from palpate.records import read_session

HERE = Path(__file__).parent


def main() -> float:
    """Fit one probing of the half ball; gives the correlation of G and nu."""
    result = fit_session(read_session(HERE / "half_ball", probes=["p1"]))
    likelihood = result.likelihood
    weight = np.exp(-0.5 * likelihood.deviance)  # (nu, G)
    weight /= weight.sum()
    nu, shear = likelihood.poisson_ratio[:, None], likelihood.shear_modulus[None]

    def mean(values: np.ndarray) -> float:
        return float((weight * values).sum())

    nu_off, shear_off = nu - mean(nu), shear - mean(shear)
    nu_std, shear_std = np.sqrt(mean(nu_off**2)), np.sqrt(mean(shear_off**2))
    correlation = mean(nu_off * shear_off) / (nu_std * shear_std)
    inside = likelihood.deviance < likelihood.height(0.95)
    print(f"nu {mean(nu):.3f} +- {nu_std:.3f}, G {mean(shear):.0f} +- {shear_std:.0f} Pa")
    print(f"correlation {correlation:+.2f}")
    for row in np.flatnonzero(inside.any(axis=1))[::4]:
        shears = likelihood.shear_modulus[inside[row]]
        print(f"nu {nu[row, 0]:.3f}: G {shears[0]:.0f} to {shears[-1]:.0f} Pa (95 % region)")
    return correlation


if __name__ == "__main__":
    main()
