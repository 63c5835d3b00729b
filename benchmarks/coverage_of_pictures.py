"""Do intervals hold where the motion comes from pictures, on unlike bodies and materials?

Sessions of the virtual facility: the bodies of `benchmarks/benches`, each with other materials,
textures, lamps and noise; the arm touches 0.5 mm beside the place that it is sent to, and the force
sensor is off by a gain of 1 %, both as a laboratory says. Bodies are finite elements in contact
with a rigid tip. Run it with

    python -m benchmarks.coverage_of_pictures [SESSIONS]
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.coverage_of_bodies import NAMES, held
from palpate.lab import LabConfig, choose_variant, make_sessions, read_lab_config
from palpate.pipeline import fit_session, with_pictures_measured
from palpate.records import Session, read_session
from palpate.records.error_priors import ErrorPriors

BENCHES = sorted((Path(__file__).parent / "benches").glob("*.toml"))
SESSIONS = 24
# Of the materials [-], and of Young's modulus [Pa].
RATIOS, YOUNG = (0.0, 0.47), (20e3, 200e3)


def drawn(seed: int) -> LabConfig:
    """One bench with a material of its own."""
    config, rng = read_lab_config(BENCHES[seed % len(BENCHES)]), np.random.default_rng([seed, 3])
    young = float(np.exp(rng.uniform(*np.log(YOUNG))))
    share = young / config.material.young_modulus
    # Pressed as far as the bench's own material is.
    probes = tuple(
        probe if probe.force is None else replace(probe, force=share * probe.force)
        for probe in config.probes
    )
    return replace(
        config,
        seed=1000 + seed,
        material=replace(
            config.material, young_modulus=young, poisson_ratio=float(rng.uniform(*RATIOS))
        ),
        force_sensor=replace(config.force_sensor, noise=share * config.force_sensor.noise),
        arm=replace(config.arm, placement=ErrorPriors().contact_point),
        probes=probes,
    )


def with_gain(session: Session, seed: int) -> Session:
    """The session as a sensor whose gain is off would have written it."""
    rng = np.random.default_rng([seed, 4])
    gain = 1.0 + session.errors.force_gain * rng.normal()
    return replace(
        session,
        probings=tuple(
            replace(probing, force=gain * probing.force) for probing in session.probings
        ),
    )


def main() -> None:
    """Print each session's constants, and how often intervals hold."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else SESSIONS
    holding = []
    for seed in range(count):
        config = drawn(seed)
        young, ratio = config.material.young_modulus, config.material.poisson_ratio
        with tempfile.TemporaryDirectory() as name:
            make_sessions([(config, Path(name))], variant=choose_variant())
            session = with_gain(read_session(Path(name)), seed)
            estimate = fit_session(with_pictures_measured(session)).estimate
        truth = dict(zip(NAMES, (ratio, young / (2 * (1 + ratio)), young), strict=True))
        holding.append(held(estimate, truth))
        young_modulus, poisson_ratio = estimate.young_modulus, estimate.poisson_ratio
        print(
            f"{config.name:32s} E {100 * (young_modulus.value / young - 1):+6.2f} % (+-"
            f" {100 * young_modulus.std / young:5.2f})   nu {ratio:.3f}"
            f" {poisson_ratio.value - ratio:+.4f} (+- {poisson_ratio.std:.4f})   {estimate.status}"
            f"   {holding[-1]}",
            flush=True,
        )
    counts = ", ".join(f"{n} {k}" for n, k in zip(NAMES, np.sum(holding, axis=0), strict=True))
    print(f"of {count} sessions intervals hold: {counts}")


if __name__ == "__main__":
    main()
