"""The minimum of the objective: Gauss-Newton with the parameters of each probing eliminated, and
the noise levels that its residuals ask for.

Errors of neighbouring points are correlated, and so are those of probings that share pictures:
`_correlation_excess` finds by how much they make the displacements tell less than as many
independent points would.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.measured_components import MeasuredComponents
from palpate.estimation.noise import NoiseModel, noise_levels
from palpate.estimation.normal_equations import (
    SMALLEST_SLOPE,
    Evaluation,
    determined,
    diagonal_root,
)
from palpate.estimation.problem import Problem, make_problem
from palpate.geometry import morton_order

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
# Blocks of neighbouring points a probing, and the fewest points of a block. With errors of a single
# probing correlated over a seventh of the surface, intervals hold in 93 % with eight blocks and in
# 78 % with 32, by simulation; with independent errors eight make them an eighth wider.
_BLOCKS, _MIN_POINTS = 8, 6
# Share of a match's variance that is due to the reference picture, and common to all later ones.
_REFERENCE_SHARE = 0.5


def fitted(
    probes: tuple[MeasuredComponents, ...], noise: NoiseModel, poisson_range: tuple[float, float]
) -> Evaluation:
    """The minimum of the objective over all probings, with its noise levels.

    Parameters
    ----------
    probes : tuple of MeasuredComponents
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
    excess = _correlation_excess(independent)
    if excess < 1.0 + _LEVEL_TOLERANCE:
        return independent
    # Not brought up to date: with less information residuals are others, and so is their scatter.
    return _settled(problem, theta, poisson_range, excess=excess)


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
        factor, reach = 1.0, _REACH
        for _ in range(_MAX_HALVINGS):
            ratio = at.theta[0]
            bounds = (max(poisson_range[0], ratio - reach), min(poisson_range[1], ratio + reach))
            step = at.normal.step(fixed, ratio, bounds)
            trial = Evaluation(at.problem, at.theta + factor * step)
            if trial.value > at.value:
                factor *= 0.5
                continue
            # The expansion leaves out how the errors' effects change with Poisson's ratio.
            trial = _renewed(trial)
            if trial.value <= at.value:
                break
            reach *= 0.5
        else:
            # No step in this direction lowers the objective: only rounding error is left.
            at.converged = True
            break
        gain = at.value - trial.value
        moved = np.abs(factor * step[:2]) * diagonal_root(at.normal.common)[:2]
        at = trial
        at.converged = gain < _IRRELEVANT
        if gain < _OBJECTIVE_TOLERANCE * (1.0 + abs(at.value)) or moved.max() < _STEP_OVER_ERROR:
            at.converged = True
            break
    return at


def at_constants(minimum: Evaluation, poisson_ratio: float, shear_modulus: float) -> Evaluation:
    """The objective at given constants, with the errors that fit best there.

    Parameters
    ----------
    minimum : Evaluation            its problem, and where the search starts
    poisson_ratio : float [-]
    shear_modulus : float [Pa]      > 0

    Returns
    -------
    Evaluation
    """
    theta = minimum.theta.copy()
    theta[:2] = poisson_ratio, np.log(shear_modulus)
    held = (poisson_ratio, poisson_ratio)
    return gauss_newton(minimum.problem, theta, fixed=(0, 1), poisson_range=held)


def stated_excess(at: Evaluation) -> float:
    """As `_correlation_excess`, from what is stated of the points alone: which are neighbours, and
    which probings share pictures.

    Parameters
    ----------
    at : Evaluation

    Returns
    -------
    float [-]                       at least 1
    """
    return _stated_excess(at.problem, _projected_designs(at), _neighbours_sharing(at))


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
        minimum = gauss_newton(problem, theta, poisson_range=poisson_range, steps=_STEPS_A_ROUND)
        theta, before, problem = minimum.theta, problem, _updated(minimum, excess)
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


def _updated(minimum: Evaluation, excess: float) -> Problem:
    """The problem with noise levels, size of the model's error and calibration as the residuals ask
    for."""
    problem, theta = minimum.problem, minimum.theta
    total, unknown = determined(minimum)
    rows = sum(len(row) for row in minimum.residual)
    lift = rows / max(rows - total, 0.5)
    expected = problem.expected
    squares = [lift * row**2 for row in minimum.residual]
    white = [problem.scale**2 * unknown_rows.variance for unknown_rows in problem.unknown]
    level = noise_levels(problem.probes, squares, white)
    coefficients = np.concatenate([theta[block.unknown] for block in problem.layout.blocks])
    asked = _CLAIM_PARAMETERS + float(coefficients @ coefficients)
    scale = float(np.sqrt(max(1.0, asked / (_CLAIM_PARAMETERS + unknown))))
    moments = minimum.moments(lift)
    calibrated = min(moments.slope, expected.slope) / max(moments.power, expected.power)
    calibrated = max(calibrated, SMALLEST_SLOPE * expected.information)
    return replace(problem, level=level, scale=scale, information=calibrated / excess)


def _renewed(at: Evaluation) -> Evaluation:
    """The objective at the same point, with the model expanded about it."""
    problem = _about(at.problem, at.theta[0])
    return at if problem is at.problem else Evaluation(problem, at.theta)


def _about(problem: Problem, poisson_ratio: float) -> Problem:
    """The problem with its model expanded about a Poisson's ratio, or near enough."""
    if abs(problem.expansions[0].poisson_ratio - poisson_ratio) < _RENEWED:
        return problem
    return problem.expanded(float(poisson_ratio))


def _start(
    probes: Sequence[MeasuredComponents], poisson_range: tuple[float, float]
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
    probes: Sequence[MeasuredComponents], poisson_ratio: float
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
    moved, measured, weight = (np.concatenate(column) for column in zip(*columns, strict=True))
    return moved, measured, weight


def _correlation_excess(at: Evaluation) -> float:
    """Factor on the variance of the constants from noise, over that for independent points.

    Parameters
    ----------
    at : Evaluation                 at a minimum

    Returns
    -------
    float [-]                       at least 1; the mean over nu and log G

    Source
    ------
    Pauli, Racugno and Ventura, Bayesian composite marginal likelihoods, Statistica Sinica 21 (2011)
    """
    designs, sharing = _projected_designs(at), _neighbours_sharing(at)
    return _stated_excess(at.problem, designs, sharing) * _block_excess(at, designs, sharing)


def _stated_excess(
    problem: Problem, designs: Sequence[Float[np.ndarray, "_ 2"]], sharing: float
) -> float:
    plain = sum(design.T @ design for design in designs)
    mixed = [p.correlated(d, sharing) for p, d in zip(problem.probes, designs, strict=True)]
    whole = sum(design.T @ product for design, product in zip(designs, mixed, strict=True))
    whole = whole + _REFERENCE_SHARE * _between_probings(problem.probes, designs, mixed)
    ratio = float(np.trace(np.linalg.lstsq(plain, whole, rcond=1e-12)[0])) / 2.0
    return max(1.0, ratio)


def _block_excess(
    at: Evaluation, designs: Sequence[Float[np.ndarray, "_ 2"]], sharing: float
) -> float:
    """Scatter of the scores of blocks of neighbouring points, over what their noise explains: shows
    correlation that nobody stated; the claim, 1, counts as one more degree of freedom."""
    problem, normal, d = at.problem, at.normal, at.problem.layout.common
    metric = np.linalg.pinv(sum(design.T @ design for design in designs), hermitian=True)
    # Residuals that are smaller than claimed prove nothing.
    power = max(at.moments().power, problem.expected.power)
    scores, variances = _scores(at), problem.variance()
    observed = mean = square = 0.0
    for index, (probe, design) in enumerate(zip(problem.probes, designs, strict=True)):
        block = _blocks(probe)
        if block is None:
            continue
        sigma = np.sqrt(variances[index])
        chosen = block[None] == np.arange(_BLOCKS)[:, None]
        parts = (chosen[:, None] * design.T).reshape(2 * _BLOCKS, -1)
        sums = (parts @ scores[index]).reshape(_BLOCKS, 2)
        information = np.einsum("bir,jr->bij", parts.reshape(_BLOCKS, 2, -1), design.T)
        # What the probing's own parameters take of its residuals.
        named = (parts / sigma) @ at.jacobian[index][d:].T
        smooth = problem.unknown[index].with_columns(parts, 1.0 / sigma)
        leak = np.hstack([named, smooth]).reshape(_BLOCKS, 2, -1)
        covariance = np.linalg.inv(normal.own[index])
        taken = (
            np.einsum("bik,kl,bjl->bij", leak, covariance, leak)
            + information @ metric @ information
        )
        plain = np.einsum("bij,ij->b", information, metric)
        lost = np.einsum("bij,ij->b", taken, metric)
        remaining = np.clip(1.0 - lost / np.maximum(plain, np.finfo(float).tiny), 0.0, 1.0)
        correlated = np.stack(
            [part @ probe.correlated(part.T, sharing) for part in parts.reshape(_BLOCKS, 2, -1)]
        )
        noise = remaining[:, None, None] * (correlated @ metric)
        observed += float(np.einsum("bi,ij,bj->", sums, metric, sums))
        mean += float(np.einsum("bii->", noise))
        square += float(np.einsum("bij,bji->", noise, noise))
    if square <= 0.0:
        return 1.0
    degrees = mean**2 / square
    return max(1.0, (1.0 + degrees * observed / (power * mean)) / (1.0 + degrees))


def _blocks(probe: MeasuredComponents) -> Int[np.ndarray, " r"] | None:
    """Number of the block that each row is in, along a space-filling curve, -1 for the tip; None
    where there are too few points."""
    on_surface = np.isfinite(probe.position[:, 0])
    count = int(on_surface.sum())
    if count < _BLOCKS * _MIN_POINTS:
        return None
    block = np.full(len(probe.position), -1)
    order = np.flatnonzero(on_surface)[morton_order(probe.position[on_surface])]
    block[order] = _BLOCKS * np.arange(count) // count
    return block[probe.point_of_row]


def _projected_designs(at: Evaluation) -> list[Float[np.ndarray, "r 2"]]:
    """Derivatives of every row, in standard deviations, by nu and log G, all else following."""
    problem, normal, d = at.problem, at.normal, at.problem.layout.common
    following = -np.linalg.lstsq(normal.common[2:, 2:], normal.common[2:, :2], rcond=1e-12)[0]
    common = np.vstack([np.eye(2), following])
    designs = []
    for table, unknown, solution, variance in zip(
        at.jacobian, problem.unknown, normal.solutions, problem.variance(), strict=True
    ):
        change = -solution[:, :d] @ common
        named = len(table) - d
        moved = np.stack([unknown.moved(coefficients) for coefficients in change[named:].T], axis=1)
        design = table[:d].T @ common + table[d:].T @ change[:named] + moved
        designs.append(design / np.sqrt(variance)[:, None])
    return designs


def _neighbours_sharing(at: Evaluation) -> float:
    """Factor on the nominal correlation of neighbours, 0 to 1, from the residuals of all probings:
    least squares over all pairs of rows, products of their scores against what is expected."""
    power, observed, expected = at.moments().power, 0.0, 0.0
    for probe, score in zip(at.problem.probes, _scores(at), strict=True):
        if probe.neighbours is not None:
            observed += float(score @ (probe.neighbours @ score))
            expected += power * float((probe.neighbours.data**2).sum())
    return float(np.clip(observed / expected, 0.0, 1.0)) if expected > 0.0 else 0.0


def _scores(at: Evaluation) -> list[Float[np.ndarray, " _"]]:
    """Robust score of every row of each probing: its weighted residual in standard deviations."""
    return [
        weight * row / np.sqrt(variance)
        for weight, row, variance in zip(
            at.weights, at.residual, at.problem.variance(), strict=True
        )
    ]


def _between_probings(
    probes: Sequence[MeasuredComponents],
    designs: Sequence[Float[np.ndarray, "_ 2"]],
    mixed: Sequence[Float[np.ndarray, "_ 2"]],
) -> Float[np.ndarray, "2 2"]:
    """Sum over all pairs of probings of the products of their designs at points that both have, in
    pictures with the same reference."""
    names = [_reference_points(probe) for probe in probes]
    counts = Counter(name for first_rows in names for name in first_rows)
    number = {name: k for k, name in enumerate(name for name in counts if counts[name] > 1)}
    plain, correlated = np.zeros((2, len(probes), 3 * len(number), 2))
    for k, first_rows in enumerate(names):
        for name, start in first_rows.items():
            if name in number:
                at, rows = slice(3 * number[name], 3 * number[name] + 3), slice(start, start + 3)
                plain[k, at], correlated[k, at] = designs[k][rows], mixed[k][rows]
    total = plain.sum(axis=0).T @ correlated.sum(axis=0)
    alone = np.einsum("kri,krj->ij", plain, correlated)
    return 0.5 * ((total - alone) + (total - alone).T)


def _reference_points(probe: MeasuredComponents) -> dict[tuple[str, bytes], int]:
    """First row of each point with all components and a reference, by reference and position."""
    reference = probe.observations.reference
    if reference is None:
        return {}
    return {
        (reference, point.tobytes()): int(start)
        for point, start, count in zip(probe.position, probe.start, probe.components, strict=True)
        if count == 3 and np.isfinite(point[0])
    }
