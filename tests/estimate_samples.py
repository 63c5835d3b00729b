"""An estimate that was never made: constants, one probing, a likelihood."""

import numpy as np

from palpate.estimation import FitResult, LikelihoodMap, ProbeFit
from palpate.records import CONSTANT_NAMES, Constant, Estimate, ProbeEstimate, Status

YOUNG, NU = 6e4, 0.3
SHEAR = YOUNG / (2 * (1 + NU))


def constants(*, known=True):
    """G, nu and E with intervals of a few per cent, or of nothing at all."""
    width = 0.02 if known else np.inf
    return {
        name: Constant(value, width * value, (value - 2 * width * value, value + 2 * width * value))
        for name, value in zip(CONSTANT_NAMES, (SHEAR, NU, YOUNG), strict=True)
    }


def sample_result(session):
    """A result that predicts half of what was measured."""
    field = session.probings[0].displacement
    predicted = np.nan_to_num(0.5 * field.displacement)
    fit = ProbeFit(
        name="n01",
        predicted=predicted,
        residual=field.displacement - predicted,
        weight=np.ones_like(predicted),
        left_out_predicted=None,
    )
    nu, shear = np.linspace(0.0, 0.49, 40), SHEAR * np.linspace(0.8, 1.2, 50)
    deviance = ((nu - NU) / 0.02)[:, None] ** 2 + ((shear / SHEAR - 1) / 0.01) ** 2
    probe = ProbeEstimate("n01", **constants(), observed=20, missing=1, rejected=0,
                          rms_residual=2e-4, prediction_error=None)  # fmt: skip
    estimate = Estimate(
        status=Status.OK,
        **constants(),
        identifiable=dict.fromkeys(CONSTANT_NAMES, True),
        probes=(probe,),
        seconds={},
        method="reduced",
        settings={},
        notes=(),
    )
    return FitResult(estimate, LikelihoodMap(nu, shear, deviance), (fit,))
