"""Small problems with closed forms, and dense linear algebra to check them with."""

from collections.abc import Sequence

import numpy as np

from palpate.estimation import ProbeObservations
from palpate.estimation.gauss_newton import gauss_newton
from palpate.estimation.measured_components import observed_rows_of
from palpate.estimation.noise import NOISE_MODELS
from palpate.estimation.normal_equations import Evaluation
from palpate.estimation.problem import Problem, make_problem

__all__ = ["RANGE", "dense_information", "minimum_of", "patterns", "problem_of"]

RANGE = (0.0, 0.4999)


def problem_of(
    probes: Sequence[ProbeObservations],
    noise: str = "gaussian",
    *,
    poisson_ratio: float = 0.28,
    shear_modulus: float = 2.1e4,
) -> Problem:
    """The objective with the claimed noise levels, expanded near the truth of `half_space`."""
    rows = tuple(observed_rows_of(probe) for probe in probes)
    return make_problem(
        rows, NOISE_MODELS[noise], poisson_ratio=poisson_ratio, shear_modulus=shear_modulus
    )


def minimum_of(problem: Problem, poisson_range: tuple[float, float] = RANGE) -> Evaluation:
    """Its minimum at these levels."""
    theta = np.zeros(problem.layout.size)
    theta[:2] = 0.28, np.log(2.1e4)
    return gauss_newton(problem, theta, poisson_range=poisson_range)


def patterns(problem: Problem, index: int) -> np.ndarray:
    """Columns of the model's error of unknown shape, (n, r)."""
    unknown = problem.unknown[index]
    rows = [unknown.moved(coefficients) for coefficients in np.eye(unknown.count)]
    return np.reshape(rows, (unknown.count, len(unknown.variance)))


def dense_information(minimum: Evaluation) -> np.ndarray:
    """Information about all of theta at once, (t, t), for least squares."""
    problem, layout = minimum.problem, minimum.problem.layout
    information = np.diag(problem.precision())
    variances = problem.variance()
    for index, (block, table) in enumerate(zip(layout.blocks, minimum.jacobian, strict=True)):
        rows = np.zeros((layout.size, table.shape[1]))
        rows[: layout.common] = table[: layout.common]
        rows[block.whole] = np.vstack([table[layout.common :], patterns(problem, index)])
        information += rows / variances[index] @ rows.T
    return information
