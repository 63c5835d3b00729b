"""Gauss-Newton equations of the objective, with the parameters of each probing eliminated, and the
covariances that follow from them."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.linalg.lapack import dposvx

from palpate.estimation.noise import Moments, moments_of
from palpate.estimation.problem import Problem

_LONGEST_STEP = 2.0
# Lower bound of the mean slope of the score over the mean weight: far from the minimum the slope
# may be negative, and the step would lead uphill.
SMALLEST_SLOPE = 0.3
_RIDGE = 1e-13
# Reciprocal condition number from which a combination of parameters counts as undetermined.
_SINGULAR = 1e-12


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Gauss-Newton equations at a point, with the parameters of each probing eliminated.

    Attributes
    ----------
    common : (d, d) float           information about the common parameters, priors included
    gradient : (d,) float           minus half the gradient by these
    parts : (k, d, d) float         contribution of each probing to `common`
    part_gradients : (k, d) float   contribution of each probing to `gradient`
    own : tuple of (n, n) float     information about each probing's own parameters
    solutions : tuple of (n, d + 1) float    minus the change of these per unit of each common
                                    parameter; last column: their step with the common ones fixed
    """

    common: Float[np.ndarray, "d d"]
    gradient: Float[np.ndarray, " d"]
    parts: Float[np.ndarray, "k d d"]
    part_gradients: Float[np.ndarray, "k d"]
    own: tuple[Float[np.ndarray, "_ _"], ...]
    solutions: tuple[Float[np.ndarray, "_ _"], ...]

    @cached_property
    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Posterior covariance of the common parameters; very large but finite along a combination
        without information."""
        scale = diagonal_root(self.common)
        unit = self.common / np.outer(scale, scale)
        return np.linalg.inv(unit + _RIDGE * np.eye(len(unit))) / np.outer(scale, scale)

    @cached_property
    def own_covariances(self) -> list[Float[np.ndarray, "_ _"]]:
        """Posterior covariance of each probing's own parameters, (n, n)."""
        return [
            np.linalg.inv(information) + solution[:, :-1] @ self.covariance @ solution[:, :-1].T
            for information, solution in zip(self.own, self.solutions, strict=True)
        ]

    @cached_property
    def std(self) -> Float[np.ndarray, " n"]:
        """Posterior standard deviation of every entry of theta."""
        every = (self.covariance, *self.own_covariances)
        return np.sqrt(np.concatenate([np.diag(covariance) for covariance in every]))

    def covariance_with(self, direction: Float[np.ndarray, "2"]) -> Float[np.ndarray, " n"]:
        """Posterior covariance of every entry of theta with a combination of (nu, log G)."""
        common = self.covariance[:, :2] @ direction
        covariances = (-solution[:, :-1] @ common for solution in self.solutions)
        return np.concatenate([common, *covariances])

    def step(
        self, fixed: Sequence[int], poisson_ratio: float, bounds: tuple[float, float]
    ) -> Float[np.ndarray, " n"]:
        """Step of theta; where it would leave the bounds of nu it ends there, the others follow.

        Parameters
        ----------
        fixed : sequence of int     common parameters that stay as they are
        poisson_ratio : float [-]
        bounds : (float, float)     of Poisson's ratio
        """
        free = np.setdiff1d(np.arange(len(self.gradient)), fixed)
        step = _solved(self.common, self.gradient, free)
        target = poisson_ratio + step[0]
        if not bounds[0] <= target <= bounds[1]:
            bound = float(np.clip(target, *bounds)) - poisson_ratio
            others = free[free != 0]
            step = _solved(self.common, self.gradient - self.common[:, 0] * bound, others)
            step[0] = bound
        step[1] = np.clip(step[1], -_LONGEST_STEP, _LONGEST_STEP)
        moves = [solution[:, -1] - solution[:, :-1] @ step for solution in self.solutions]
        return np.concatenate([step, *moves])


@dataclass(eq=False)
class Evaluation:
    """The objective at one point; what is asked of it is computed once.

    Parameters
    ----------
    problem : Problem
    theta : (n,) float
    converged : bool                whether a search ended here, at a minimum
    known_residual : sequence or None   `residual`, where it is known from elsewhere
    """

    problem: Problem
    theta: Float[np.ndarray, " t"]
    converged: bool = False
    known_residual: Sequence[Float[np.ndarray, " _"]] | None = None

    @property
    def poisson_ratio(self) -> float:
        """Poisson's ratio [-]."""
        return float(self.theta[0])

    @property
    def shear_modulus(self) -> float:
        """Shear modulus [Pa]."""
        return float(np.exp(self.theta[1]))

    @cached_property
    def _linearised(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        return self.problem.linearised(self.theta)

    @property
    def residual(self) -> list[Float[np.ndarray, " _"]]:
        """Measured minus predicted displacement of each probing's rows, (r,) [m]."""
        return self._linearised[0] if self.known_residual is None else list(self.known_residual)

    @property
    def jacobian(self) -> list[Float[np.ndarray, "_ _"]]:
        """Derivative of each probing's prediction (`Problem.linearised`)."""
        return self._linearised[1]

    @cached_property
    def squared(self) -> list[Float[np.ndarray, " _"]]:
        """Squared length of every point's residual in standard deviations."""
        problem = self.problem
        return [
            probe.squared_length(row / np.sqrt(variance))
            for probe, row, variance in zip(
                problem.probes, self.residual, problem.variance(), strict=True
            )
        ]

    @cached_property
    def weights(self) -> list[Float[np.ndarray, " _"]]:
        """Robust weight of every row of each probing."""
        noise = self.problem.noise
        return [
            noise.weight(square, probe.components)[probe.point_of_row]
            for probe, square in zip(self.problem.probes, self.squared, strict=True)
        ]

    @cached_property
    def value(self) -> float:
        """The objective, f."""
        problem = self.problem
        loss = sum(
            float(problem.noise.loss(square, probe.components).sum())
            for probe, square in zip(problem.probes, self.squared, strict=True)
        )
        return problem.information * loss + float(problem.precision() @ self.theta**2)

    @cached_property
    def normal(self) -> NormalEquations:
        """Its Gauss-Newton equations."""
        return _normal_equations(self)

    def curvature_factor(self) -> float:
        """Expected curvature of the loss over its robust weights: scoring, not plain reweighting,
        takes the mean slope of the score in place of the mean weight."""
        weight = [
            weights[probe.start]
            for weights, probe in zip(self.weights, self.problem.probes, strict=True)
        ]
        slope = self.moments().slope / float(np.concatenate(weight).mean())
        return self.problem.information * max(slope, SMALLEST_SLOPE)

    def moments(self, lift: float = 1.0) -> Moments:
        """Moments of the robust score over all points.

        Parameters
        ----------
        lift : float                factor on the squares, for degrees of freedom that were lost
        """
        components = np.concatenate([probe.components for probe in self.problem.probes])
        return moments_of(self.problem.noise, lift * np.concatenate(self.squared), components)


def _normal_equations(at: Evaluation) -> NormalEquations:
    parts, gradients, inner, solutions = zip(*_eliminated(at, at.jacobian), strict=True)
    precision, d = at.problem.precision(), at.problem.layout.common
    prior = precision[:d]
    return NormalEquations(
        np.diag(prior) + np.sum(parts, axis=0),
        np.sum(gradients, axis=0) - prior * at.theta[:d],
        np.stack(parts),
        np.stack(gradients),
        inner,
        solutions,
    )


def information_of_common(
    at: Evaluation,
) -> tuple[Float[np.ndarray, "d d"], Float[np.ndarray, " d"]]:
    """Information about the common parameters and minus half the gradient by these, all others
    eliminated, as `Evaluation.normal` has them; of one probing after the other, and none is kept.

    Parameters
    ----------
    at : Evaluation                 with many common parameters: then its tables are large
    """
    problem, d = at.problem, at.problem.layout.common
    tables = (problem.table(k, at.theta) for k in range(len(problem.probes)))
    prior = problem.precision()[:d]
    information, gradient = np.diag(prior), -prior * at.theta[:d]
    for part, own, _, _ in _eliminated(at, tables):
        information += part
        gradient += own
    return information, gradient


def _eliminated(
    at: Evaluation, jacobian: Iterable[Float[np.ndarray, "_ _"]]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """What each probing contributes to the equations of the common parameters, (d, d) and (d,), the
    information about its own parameters, and how these follow from the common ones
    (`NormalEquations`)."""
    problem, theta, layout = at.problem, at.theta, at.problem.layout
    precision, d = problem.precision(), layout.common
    factor, variances = at.curvature_factor(), problem.variance()
    for index, (block, table, row) in enumerate(
        zip(layout.blocks, jacobian, at.residual, strict=True)
    ):
        weight = at.weights[index] / variances[index]
        products = gram(problem, index, np.vstack([table, row]), weight)
        information, score = factor * products, problem.information * products[:, len(table)]
        information = np.delete(np.delete(information, len(table), 0), len(table), 1)
        score = np.delete(score, len(table))
        prior = precision[block.whole]
        own_information = information[d:, d:] + np.diag(prior)
        own_score = score[d:] - prior * theta[block.whole]
        solution = np.linalg.solve(
            own_information, np.column_stack([information[d:, :d], own_score])
        )
        part = information[:d, :d] - information[:d, d:] @ solution[:, :d]
        gradient = score[:d] - information[:d, d:] @ solution[:, d]
        yield part, gradient, own_information, solution


def gram(
    problem: Problem,
    index: int,
    columns: Float[np.ndarray, "s r"],
    weight: Float[np.ndarray, " r"],
) -> Float[np.ndarray, "t t"]:
    """Weighted products of some columns of one probing and after them the patterns of its model's
    error.

    Parameters
    ----------
    problem : Problem
    index : int                     of the probing
    columns : (s, r) float
    weight : (r,) float [1/m^2]

    Returns
    -------
    (t, t) float                    t = s + `UnknownRows.count`
    """
    named = (columns * weight) @ columns.T
    cross, whole = problem.unknown[index].products(columns, weight)
    return np.block([[named, cross], [cross.T, whole]])


def determined(minimum: Evaluation) -> tuple[float, float]:
    """How many parameters the data determine, in all, and among those of the model's error.

    Parameters
    ----------
    minimum : Evaluation

    Returns
    -------
    (float, float)                  effective degrees of freedom

    Source
    ------
    MacKay, Bayesian interpolation, Neural Computation 4 (1992), eq. 4.5
    """
    layout = minimum.problem.layout
    determinacy = 1.0 - minimum.problem.precision() * minimum.normal.std**2
    unknown = sum(float(determinacy[block.unknown].sum()) for block in layout.blocks)
    return float(determinacy.sum()), unknown


def _solved(matrix: np.ndarray, right: np.ndarray, free: np.ndarray) -> Float[np.ndarray, " d"]:
    """Least squares on a unit diagonal: well defined even where one combination is not
    determined."""
    solution = np.zeros(len(right))
    if not free.size:
        return solution
    part = matrix[np.ix_(free, free)]
    scale = diagonal_root(part)
    part, right = part / np.outer(scale, scale), right[free] / scale
    # Twenty times as fast as least squares, which singular matrices need.
    *_, scaled, condition, _, _, _ = dposvx(part, right)
    if not condition > _SINGULAR:
        scaled = np.linalg.lstsq(part, right, rcond=_SINGULAR)[0]
    solution[free] = scaled.ravel() / scale
    return solution


def diagonal_root(matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, " n"]:
    """Square root of an information matrix's diagonal, with a floor far below any relevant
    information."""
    size = np.diag(matrix)
    return np.sqrt(np.maximum(size, max(1e-15 * float(size.max()), 1e-200)))
