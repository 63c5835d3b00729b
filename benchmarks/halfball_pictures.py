"""Are the constants of a half ball unbiased where its motion comes from pictures?

Sessions of the virtual facility: the half ball of the demo, three probings, each session with a
material, a texture, arm errors and noise of its own. Each mean error is printed with its standard
error, from the scatter of single sessions. Run it with

    python -m benchmarks.halfball_pictures [SESSIONS]
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.coverage_of_bodies import NAMES, held
from palpate.lab import LabConfig, choose_variant, make_session, read_lab_config
from palpate.pipeline import fit_session, with_pictures_measured
from palpate.records import Estimate, read_session

DEMO = Path(__file__).parents[1] / "src" / "palpate" / "lab" / "configs" / "demo.toml"
SESSIONS = 20
# Of the materials [-], and of Young's modulus [Pa].
RATIOS, YOUNG = (0.0, 0.47), (20e3, 200e3)


def half_ball_bench(seed: int) -> LabConfig:
    """The demo's bench with a material of its own, pressed as far as the demo's is.

    Parameters
    ----------
    seed : int                      of the material and of all that the bench draws

    Returns
    -------
    LabConfig
    """
    config, rng = read_lab_config(DEMO), np.random.default_rng([seed, 5])
    young = float(np.exp(rng.uniform(*np.log(YOUNG))))
    share = young / config.material.young_modulus
    probes = tuple(
        probe if probe.force is None else replace(probe, force=share * probe.force)
        for probe in config.probes
    )
    material = replace(
        config.material, young_modulus=young, poisson_ratio=float(rng.uniform(*RATIOS))
    )
    return replace(config, seed=2000 + seed, material=material, probes=probes)


def fitted_pictures(folder: Path) -> Estimate:
    """Constants from the pictures and readings of a session.

    Parameters
    ----------
    folder : Path                   of the session

    Returns
    -------
    Estimate
    """
    return fit_session(with_pictures_measured(read_session(folder))).estimate


def main() -> None:
    """Print each session's errors, their means, and how often intervals hold."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else SESSIONS
    errors, holding = [], []
    for seed in range(count):
        config = half_ball_bench(seed)
        young, ratio = config.material.young_modulus, config.material.poisson_ratio
        with tempfile.TemporaryDirectory() as name:
            make_session(config, Path(name), variant=choose_variant())
            estimate = fitted_pictures(Path(name))
        young_modulus, poisson_ratio = estimate.young_modulus, estimate.poisson_ratio
        errors.append([100.0 * (young_modulus.value / young - 1.0), poisson_ratio.value - ratio])
        truth = dict(zip(NAMES, (ratio, young / (2.0 * (1.0 + ratio)), young), strict=True))
        holding.append(held(estimate, truth))
        print(
            f"seed {seed:2d} E {errors[-1][0]:+6.2f} % (+-"
            f" {100.0 * young_modulus.std / young:5.2f})   nu {ratio:.3f} {errors[-1][1]:+.4f} (+-"
            f" {poisson_ratio.std:.4f})   {estimate.status}",
            flush=True,
        )
    mean, error = np.mean(errors, axis=0), np.std(errors, axis=0, ddof=1) / np.sqrt(count)
    counts = ", ".join(f"{n} {k}" for n, k in zip(NAMES, np.sum(holding, axis=0), strict=True))
    print(
        f"mean error of E {mean[0]:+.2f} % (+- {error[0]:.2f}), of nu {mean[1]:+.5f}"
        f" (+- {error[1]:.5f}); of {count} sessions intervals hold: {counts}"
    )


if __name__ == "__main__":
    main()
