"""The minimum of the objective: Gauss-Newton with the parameters of each probing eliminated, and
the noise levels that its residuals ask for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.estimation.correlation import correlation_excess
from palpate.estimation.noise import NoiseModel, noise_levels
from palpate.estimation.normal_equations import (
    SMALLEST_SLOPE,
    NormalEquations,
    determined,
    diagonal_root,
    normal_equations,
    residual_moments,
)
from palpate.estimation.observed_rows import ObservedRows
from palpate.estimation.problem import Problem, make_problem

_STARTS, _ROBUST_ROUNDS = 9, 4
_MAX_STEPS, _MAX_HALVINGS, _MAX_ROUNDS = 50, 20, 25
# Steps between two updates of the noise levels.
_STEPS_A_ROUND = 2
# Reach of an expansion of the model in Poisson's ratio, and the change from which it is renewed:
# the error is of second order.
_REACH, _RENEWED = 0.06, 3e-3
# Change of the objective, over 1 + itself, and step over its standard error, that end a search.
_OBJECTIVE_TOLERANCE, _STEP_OVER_ERROR = 1e-10, 1e-4
# A search that gains so little a step has converged for all that a reader cares.
_IRRELEVANT = 1e-3
_LEVEL_TOLERANCE = 0.01
# Parameters that the claimed size of the model's error counts for when residuals ask for a larger.
_CLAIM_PARAMETERS = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """A minimum of the objective, or the best point of a search that ended early.

    Attributes
    ----------
    problem : Problem
    theta : (n,) float
    residual : tuple of (r,) float [m]      of each probing's rows
    normal : NormalEquations                at this point
    value : float                           of the objective
    converged : bool
    """

    problem: Problem
    theta: Float[np.ndarray, " t"]
    residual: tuple[Float[np.ndarray, " _"], ...]
    normal: NormalEquations
    value: float
    converged: bool

    @property
    def poisson_ratio(self) -> float:
        """Poisson's ratio [-]."""
        return float(self.theta[0])

    @property
    def shear_modulus(self) -> float:
        """Shear modulus [Pa]."""
        return float(np.exp(self.theta[1]))


def fitted(
    probes: tuple[ObservedRows, ...], noise: NoiseModel, poisson_range: tuple[float, float]
) -> Minimum:
    """The minimum of the objective over all probings, with its noise levels.

    Parameters
    ----------
    probes : tuple of ObservedRows
    noise : NoiseModel
    poisson_range : (float, float) [-]

    Returns
    -------
    Minimum
    """
    ratio, modulus = _start(probes, poisson_range)
    problem = make_problem(probes, noise, poisson_ratio=ratio, shear_modulus=modulus)
    theta = np.zeros(problem.layout.size)
    theta[:2] = ratio, np.log(modulus)
    return with_noise(problem, theta, poisson_range)


def with_noise(
    problem: Problem, theta: Float[np.ndarray, " t"], poisson_range: tuple[float, float]
) -> Minimum:
    """The minimum, with noise levels and the size of the model's error that its residuals ask for.

    Parameters
    ----------
    problem : Problem               with the levels to start from
    theta : (n,) float              start
    poisson_range : (float, float)

    Returns
    -------
    Minimum
    """
    independent = _settled(problem, theta, poisson_range, excess=1.0)
    problem, theta = independent.problem, independent.theta
    excess = correlation_excess(problem, theta, independent.residual, independent.normal)
    if excess < 1.0 + _LEVEL_TOLERANCE:
        return independent
    # Not brought up to date: with less information residuals are others, and so is their scatter.
    return _settled(problem, theta, poisson_range, excess=excess)


def _settled(
    problem: Problem,
    theta: Float[np.ndarray, " t"],
    poisson_range: tuple[float, float],
    *,
    excess: float,
) -> Minimum:
    """The minimum, with levels that its residuals ask for, and less information by an excess of
    correlation."""
    for _ in range(_MAX_ROUNDS):
        found = gauss_newton(problem, theta, poisson_range=poisson_range, steps=_STEPS_A_ROUND)
        updated = _updated(found, excess)
        settled, theta = _is_settled(problem, updated), found.theta
        if settled:
            break
        problem = replace(updated, expansions=found.problem.expansions)
    last = gauss_newton(problem, theta, poisson_range=poisson_range)
    return replace(last, converged=bool(last.converged and settled))


def _is_settled(before: Problem, after: Problem) -> bool:
    """Whether two problems differ by no more than what is irrelevant."""
    variances = zip(before.variance(), after.variance(), strict=True)
    change = max(float(np.abs(new / old - 1.0).mean()) for old, new in variances)
    for name in ("scale", "information"):
        change = max(change, abs(getattr(after, name) / getattr(before, name) - 1.0))
    return change < _LEVEL_TOLERANCE


def gauss_newton(
    problem: Problem,
    theta: Float[np.ndarray, " t"],
    *,
    fixed: Sequence[int] = (),
    poisson_range: tuple[float, float],
    steps: int = _MAX_STEPS,
) -> Minimum:
    """Minimise the objective at given noise levels; every step lowers it.

    Parameters
    ----------
    problem : Problem
    theta : (n,) float              start
    fixed : sequence of int         common parameters that stay as they are: 0 for Poisson's ratio,
                                    1 for the shear modulus
    poisson_range : (float, float)  Poisson's ratio stays inside
    steps : int                     most steps

    Returns
    -------
    Minimum
    """
    theta = np.array(theta)
    theta[0] = np.clip(theta[0], *poisson_range)
    problem = _about(problem, theta[0])
    residual = problem.residual(theta)
    value, converged = problem.objective(theta, residual), False
    normal = normal_equations(problem, theta, residual)
    for _ in range(steps):
        about = problem.expansions[0].poisson_ratio
        bounds = (max(poisson_range[0], about - _REACH), min(poisson_range[1], about + _REACH))
        step = normal.step(fixed, theta[0], bounds)
        for factor in 0.5 ** np.arange(_MAX_HALVINGS):
            trial = theta + factor * step
            trial_residual = problem.residual(trial)
            trial_value = problem.objective(trial, trial_residual)
            if trial_value <= value:
                break
        else:
            # No step in this direction lowers the objective: only rounding error is left.
            converged = True
            break
        gain, moved = (
            value - trial_value,
            np.abs(factor * step[:2]) * diagonal_root(normal.common)[:2],
        )
        theta, residual, value = trial, trial_residual, trial_value
        renewed = _about(problem, theta[0])
        if renewed is not problem:
            problem, residual = renewed, renewed.residual(theta)
            value = problem.objective(theta, residual)
        normal = normal_equations(problem, theta, residual)
        converged = gain < _IRRELEVANT
        if gain < _OBJECTIVE_TOLERANCE * (1.0 + abs(value)) or moved.max() < _STEP_OVER_ERROR:
            converged = True
            break
    return Minimum(problem, theta, tuple(residual), normal, value, bool(converged))


def _updated(minimum: Minimum, excess: float) -> Problem:
    """The problem with noise levels, size of the model's error and calibration as the residuals ask
    for."""
    problem, theta = minimum.problem, minimum.theta
    total, unknown = determined(problem, minimum.normal)
    rows = sum(len(row) for row in minimum.residual)
    lift = rows / max(rows - total, 0.5)
    expected = problem.expected
    squares = [lift * row**2 for row in minimum.residual]
    white = [problem.scale**2 * each.variance for each in problem.unknown]
    level = noise_levels(problem.probes, squares, white)
    coefficients = np.concatenate([theta[block.unknown] for block in problem.layout.blocks])
    asked = _CLAIM_PARAMETERS + float(coefficients @ coefficients)
    scale = float(np.sqrt(max(1.0, asked / (_CLAIM_PARAMETERS + unknown))))
    moments = residual_moments(problem, minimum.residual, lift)
    calibrated = min(moments.slope, expected.slope) / max(moments.power, expected.power)
    calibrated = max(calibrated, SMALLEST_SLOPE * expected.information)
    return replace(problem, level=level, scale=scale, information=calibrated / excess)


def _about(problem: Problem, poisson_ratio: float) -> Problem:
    """The problem with its model expanded about a Poisson's ratio, or near enough."""
    if abs(problem.expansions[0].poisson_ratio - poisson_ratio) < _RENEWED:
        return problem
    return problem.expanded(float(poisson_ratio))


def _start(
    probes: Sequence[ObservedRows], poisson_range: tuple[float, float]
) -> tuple[float, float]:
    """The best of several Poisson's ratios, each with its best shear modulus, for the measured
    forces and without errors; robust, as gross outliers would decide otherwise."""
    best = (np.inf, 0.0, 1.0)
    for ratio in np.linspace(*poisson_range, _STARTS):
        moved, measured, weight = _at(probes, float(ratio))
        compliance = 1.0
        used = weight
        for _ in range(_ROBUST_ROUNDS):
            compliance = float((used * moved) @ measured) / max(
                float((used * moved) @ moved), np.finfo(float).tiny
            )
            residual = np.abs(measured - compliance * moved) * np.sqrt(weight)
            middle = max(float(np.median(residual)), np.finfo(float).tiny ** 0.25)
            used = weight / (1.0 + residual / middle)
        if compliance > 0.0 and residual.sum() < best[0]:
            best = (float(residual.sum()), float(ratio), 1.0 / compliance)
    return best[1], best[2]


def _at(
    probes: Sequence[ObservedRows], poisson_ratio: float
) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, " r"], Float[np.ndarray, " r"]]:
    """Displacement for a shear modulus of 1, measured displacement, and weight, of all rows."""
    columns = []
    for probe in probes:
        seen = probe.observations
        terms = probe.whitened(seen.response_terms(poisson_ratio)[probe.rows])
        moved = terms[:, 0, :4] @ np.append(seen.force, 1.0)
        measured = probe.measured - terms[:, 0, 4:] @ seen.motion
        if terms.shape[1] > 1:
            measured = measured - terms[:, 1, :4] @ np.append(seen.force, 1.0)
        columns.append((moved, measured, 1.0 / probe.unit**2))
    moved, measured, weight = (np.concatenate(each) for each in zip(*columns, strict=True))
    return moved, measured, weight
