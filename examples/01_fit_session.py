"""One call: a session folder in, elastic constants with intervals out.

python examples/01_fit_session.py
"""

from pathlib import Path

from palpate.pipeline import fit_session
from palpate.records import read_session

HERE = Path(__file__).parent


def main() -> float:
    """Fit the half ball (truth: E = 60 kPa, nu = 0.30); gives Young's modulus [Pa]."""
    session = read_session(HERE / "half_ball")
    estimate = fit_session(session).estimate
    print(f"{session.name}: {estimate.status.value}")
    for name in ("shear_modulus", "poisson_ratio", "young_modulus"):
        constant = getattr(estimate, name)
        low, high = constant.ci95
        print(f"{name:14s} {constant.value:10.5g}   95 % interval {low:.5g} to {high:.5g}")
    for probe in estimate.probes:
        print(f"{probe.name}: {probe.observed} points, rms {1e3 * probe.rms_residual:.3f} mm")
    return estimate.young_modulus.value


if __name__ == "__main__":
    main()
