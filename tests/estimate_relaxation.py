"""The modulus over time of a body that was never measured, for the tests of what shows it."""

import numpy as np

from palpate.records import Constant, RelaxationEstimate, RelaxationPoint, RelaxationTerm
from palpate.relaxation import CreepCompliance

# Relative to the unrelaxed compliance.
TRUTH = CreepCompliance(1.0, np.array([0.3, 0.5]), np.array([3.0, 60.0]))


def constant(value: float) -> Constant:
    """Known to 2 %."""
    return Constant(value, 0.02 * value, (0.96 * value, 1.04 * value))


def sample_relaxation(unrelaxed: float) -> RelaxationEstimate:
    """That of `TRUTH`, without an end in the long term."""
    modulus = TRUTH.relaxation()
    times = 10.0 ** (np.arange(0, 21) / 10.0)
    return RelaxationEstimate(
        constant="shear_modulus", age=12.0, rise=0.5, hold=100.0, unrelaxed=unrelaxed,
        terms=tuple(
            RelaxationTerm(constant(float(t)), float(g))
            for g, t in zip(modulus.terms, modulus.times, strict=True)
        ),
        curve=tuple(
            RelaxationPoint(float(t), constant(unrelaxed * float(g)))
            for t, g in zip(times, modulus.at(times), strict=True)
        ),
        instantaneous=constant(unrelaxed), long_term=None,
        remarks=("The long-term modulus is not determined: hold for 200 s.",),
    )  # fmt: skip
