"""The minimum of the objective: Gauss-Newton with the parameters of each probing eliminated, and
the noise levels that its residuals ask for."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from palpate.estimation.correlation import correlation_excess
from palpate.estimation.noise import NoiseModel, noise_levels
from palpate.estimation.normal_equations import (
    SMALLEST_SLOPE,
    Evaluation,
    determined,
    diagonal_root,
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


def fitted(
    probes: tuple[ObservedRows, ...], noise: NoiseModel, poisson_range: tuple[float, float]
) -> Evaluation:
    """The minimum of the objective over all probings, with its noise levels.

    Parameters
    ----------
    probes : tuple of ObservedRows
    noise : NoiseModel
    poisson_range : (float, float) [-]

    Returns
    -------
    Evaluation
    """
    ratio, modulus = _start(probes, poisson_range)
    problem = make_problem(probes, noise, poisson_ratio=ratio, shear_modulus=modulus)
    theta = np.zeros(problem.layout.size)
    theta[:2] = ratio, np.log(modulus)
    return with_noise(problem, theta, poisson_range)


def with_noise(
    problem: Problem, theta: Float[np.ndarray, " t"], poisson_range: tuple[float, float]
) -> Evaluation:
    """The minimum, with noise levels and the size of the model's error that its residuals ask for.

    Parameters
    ----------
    problem : Problem               with the levels to start from
    theta : (n,) float              start
    poisson_range : (float, float)

    Returns
    -------
    Evaluation
    """
    independent = _settled(problem, theta, poisson_range, excess=1.0)
    problem, theta = independent.problem, independent.theta
    excess = correlation_excess(independent)
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
) -> Evaluation:
    """The minimum, with levels that its residuals ask for, and less information by an excess of
    correlation."""
    for _ in range(_MAX_ROUNDS):
        found = gauss_newton(problem, theta, poisson_range=poisson_range, steps=_STEPS_A_ROUND)
        theta, before, problem = found.theta, problem, _updated(found, excess)
        settled = _is_settled(before, problem)
        if settled:
            break
    last = gauss_newton(problem, theta, poisson_range=poisson_range)
    last.converged = last.converged and settled
    return last


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
) -> Evaluation:
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
    Evaluation
    """
    theta = np.array(theta)
    theta[0] = np.clip(theta[0], *poisson_range)
    at = Evaluation(_about(problem, theta[0]), theta)
    for _ in range(steps):
        about = at.problem.expansions[0].poisson_ratio
        bounds = (max(poisson_range[0], about - _REACH), min(poisson_range[1], about + _REACH))
        step = at.normal.step(fixed, at.theta[0], bounds)
        for factor in 0.5 ** np.arange(_MAX_HALVINGS):
            trial = Evaluation(at.problem, at.theta + factor * step)
            if trial.value <= at.value:
                break
        else:
            # No step in this direction lowers the objective: only rounding error is left.
            at.converged = True
            break
        gain = at.value - trial.value
        moved = np.abs(factor * step[:2]) * diagonal_root(at.normal.common)[:2]
        renewed = _about(at.problem, trial.theta[0])
        at = trial if renewed is at.problem else Evaluation(renewed, trial.theta)
        at.converged = gain < _IRRELEVANT
        if gain < _OBJECTIVE_TOLERANCE * (1.0 + abs(at.value)) or moved.max() < _STEP_OVER_ERROR:
            at.converged = True
            break
    return at


def _updated(minimum: Evaluation, excess: float) -> Problem:
    """The problem with noise levels, size of the model's error and calibration as the residuals ask
    for."""
    problem, theta = minimum.problem, minimum.theta
    total, unknown = determined(minimum)
    rows = sum(len(row) for row in minimum.residual)
    lift = rows / max(rows - total, 0.5)
    expected = problem.expected
    squares = [lift * row**2 for row in minimum.residual]
    white = [problem.scale**2 * each.variance for each in problem.unknown]
    level = noise_levels(problem.probes, squares, white)
    coefficients = np.concatenate([theta[block.unknown] for block in problem.layout.blocks])
    asked = _CLAIM_PARAMETERS + float(coefficients @ coefficients)
    scale = float(np.sqrt(max(1.0, asked / (_CLAIM_PARAMETERS + unknown))))
    moments = minimum.moments(lift)
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
