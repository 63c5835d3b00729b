"""A published relaxation curve as a Prony series, and what the series says of a time not seen.

python examples/15_relaxation_curve.py
"""

from pathlib import Path

import numpy as np

from palpate.relaxation import Motion, fit_creep

CURVE = Path(__file__).parent / "relaxation" / "modulus.csv"
LAST = 360.0  # what is fitted: the first tenth of the hour [s]


def main() -> float:
    """Fit the beginning of the curve; gives the largest error there, over the modulus."""
    time, modulus = np.loadtxt(CURVE, delimiter=",", skiprows=1).T
    seen = time <= LAST
    # The strain rises from 0 to the first reading, and is held: the force is as the modulus.
    force = np.append(0.0, modulus[seen])
    held = Motion(
        np.append(0.0, time[seen]), force, np.arange(1, len(force)), np.ones(len(force) - 1),
        np.ones(len(force) - 1), len(force) - 1,
    )  # fmt: skip
    fit = fit_creep([held], shortest=time[0], longest=LAST / 3)
    relaxation = fit.compliance.relaxation()
    fitted = relaxation.at(time) / relaxation.at(time[seen][-1:]) * modulus[seen][-1]

    print(f"{fit.terms} terms; of the modulus at once:")
    for part, rest in zip(relaxation.terms, relaxation.times, strict=True):
        print(f"  {100 * part / relaxation.instantaneous:4.1f} % relaxes in {rest:.3g} s")
    print("     t        E  series")
    for k in np.searchsorted(time, [0.1, 1.0, 10.0, 100.0, 300.0, 1000.0, 3500.0]):
        after = "" if seen[k] else "  not seen by the fit"
        print(f"{time[k]:6.3g} s {modulus[k]:5.0f} {fitted[k]:5.0f} MPa{after}")
    return float(np.abs(fitted / modulus - 1.0)[seen].max())


if __name__ == "__main__":
    main()
