"""One call: a session folder in, elastic constants with intervals out.

python examples/01_fit_session.py
"""

from pathlib import Path

import palpate

HERE = Path(__file__).parent


def main() -> float:
    """Fit the half ball (truth: E = 60 kPa, nu = 0.30); gives Young's modulus [Pa]."""
    result = palpate.fit(HERE / "half_ball")
    print(result)
    low, high = result.poisson_ratio.ci95
    print(f"Poisson's ratio between {low:.3f} and {high:.3f}, with 95 %")
    for probe in result.estimate.probes:
        print(f"{probe.name}: {probe.observed} points, rms {1e3 * probe.rms_residual:.3f} mm")
    return result.young_modulus.value


if __name__ == "__main__":
    main()
