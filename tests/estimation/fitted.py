"""Minima of small problems with closed forms, for the tests of what is made from them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from palpate.estimation import ProbeObservations
from palpate.estimation.intervals.uncertainty import Uncertainty, uncertainty_of
from palpate.estimation.noise.registry import NOISE_MODELS
from palpate.estimation.observed_rows import observed_rows_of
from palpate.estimation.responses.table import response_table
from palpate.estimation.search.misfit import LocalProbe, Misfit
from palpate.estimation.search.scoring import Minimum, scored_minimum
from palpate.estimation.search.variable_projection import FixedWeights, fixed_weights

__all__ = ["RANGE", "dense_information", "minimum_of", "misfit_of", "uncertainty_at", "weights_at"]

RANGE = (0.0, 0.4999)


def misfit_of(probes: Sequence[ProbeObservations], noise: str = "gaussian") -> Misfit:
    """Misfit with the claimed noise levels."""
    rows = tuple(observed_rows_of(probe) for probe in probes)
    return Misfit(rows, np.ones(8), NOISE_MODELS[noise])


def minimum_of(misfit: Misfit, poisson_range: tuple[float, float] = RANGE) -> Minimum:
    """Minimum from a start near the truth of `half_space_probes`."""
    return scored_minimum(misfit, misfit.start(0.28, 2.1e4), poisson_range=poisson_range)


def weights_at(
    misfit: Misfit, minimum: Minimum, poisson_range: tuple[float, float] = RANGE
) -> FixedWeights:
    """The misfit with the weights of its minimum."""
    return fixed_weights(
        misfit.probes,
        response_table(misfit.probes, poisson_range),
        misfit.level,
        [one.weight for one in minimum.probes],
        np.array([one.force_weight for one in minimum.probes]),
    )


def uncertainty_at(
    probes: Sequence[ProbeObservations],
    noise: str = "gaussian",
    poisson_range: tuple[float, float] = RANGE,
) -> Uncertainty:
    """Everything that intervals are made from."""
    misfit = misfit_of(probes, noise)
    minimum = minimum_of(misfit, poisson_range)
    return uncertainty_of(misfit, minimum, weights_at(misfit, minimum, poisson_range))


def dense_information(
    one: LocalProbe, *, row_variance: np.ndarray | float = 1.0, force_variance: float = 1.0
) -> Float[np.ndarray, "2 2"]:
    """X' C^-1 X with the force's error as correlated noise of the displacements: C = V + P P' f."""
    design, push = one.design[:, :2], one.design[:, 2:]
    covariance = (
        np.diag(np.broadcast_to(row_variance, len(design))) + force_variance * push @ push.T
    )
    return design.T @ np.linalg.solve(covariance, design)
