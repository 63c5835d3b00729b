"""Correlation of the errors of neighbouring points, and between probings that share pictures: by
how much it makes the displacements tell less than as many independent points would."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.normal_equations import Evaluation
from palpate.estimation.observed_rows import ObservedRows
from palpate.estimation.problem import Problem
from palpate.geometry import morton_order

# Blocks of neighbouring points a probing, and the fewest points of a block. With errors of a single
# probing correlated over a seventh of the surface, intervals hold in 93 % with eight blocks and in
# 78 % with 32, by simulation; with independent errors eight make them an eighth wider.
_BLOCKS, _MIN_POINTS = 8, 6
# Share of a match's variance that is due to the reference picture, and common to all later ones.
_REFERENCE_SHARE = 0.5


def correlation_excess(at: Evaluation) -> float:
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


def stated_excess(at: Evaluation) -> float:
    """As `correlation_excess`, from what is stated of the points alone: which are neighbours, and
    which probings share pictures.

    Parameters
    ----------
    at : Evaluation

    Returns
    -------
    float [-]                       at least 1
    """
    return _stated_excess(at.problem, _projected_designs(at), _neighbours_sharing(at))


def _stated_excess(
    problem: Problem, designs: Sequence[Float[np.ndarray, "_ 2"]], sharing: float
) -> float:
    plain = sum(design.T @ design for design in designs)
    mixed = [p.correlated(d, sharing) for p, d in zip(problem.probes, designs, strict=True)]
    whole = sum(design.T @ each for design, each in zip(designs, mixed, strict=True))
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
        own = np.linalg.inv(normal.own[index])
        taken = np.einsum("bik,kl,bjl->bij", leak, own, leak) + information @ metric @ information
        plain = np.einsum("bij,ij->b", information, metric)
        lost = np.einsum("bij,ij->b", taken, metric)
        kept = np.clip(1.0 - lost / np.maximum(plain, np.finfo(float).tiny), 0.0, 1.0)
        correlated = np.stack(
            [part @ probe.correlated(part.T, sharing) for part in parts.reshape(_BLOCKS, 2, -1)]
        )
        noise = kept[:, None, None] * (correlated @ metric)
        observed += float(np.einsum("bi,ij,bj->", sums, metric, sums))
        mean += float(np.einsum("bii->", noise))
        square += float(np.einsum("bij,bji->", noise, noise))
    if square <= 0.0:
        return 1.0
    degrees = mean**2 / square
    return max(1.0, (1.0 + degrees * observed / (power * mean)) / (1.0 + degrees))


def _blocks(probe: ObservedRows) -> Int[np.ndarray, " r"] | None:
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
        own = -solution[:, :d] @ common
        named = len(table) - d
        moved = np.stack([unknown.moved(each) for each in own[named:].T], axis=1)
        design = table[:d].T @ common + table[d:].T @ own[:named] + moved
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
    probes: Sequence[ObservedRows],
    designs: Sequence[Float[np.ndarray, "_ 2"]],
    mixed: Sequence[Float[np.ndarray, "_ 2"]],
) -> Float[np.ndarray, "2 2"]:
    """Sum over all pairs of probings of the products of their designs at points that both have, in
    pictures with the same reference."""
    names = [_reference_points(probe) for probe in probes]
    counts = Counter(name for own in names for name in own)
    number = {name: k for k, name in enumerate(name for name in counts if counts[name] > 1)}
    plain, correlated = np.zeros((2, len(probes), 3 * len(number), 2))
    for k, own in enumerate(names):
        for name, start in own.items():
            if name in number:
                at, rows = slice(3 * number[name], 3 * number[name] + 3), slice(start, start + 3)
                plain[k, at], correlated[k, at] = designs[k][rows], mixed[k][rows]
    total = plain.sum(axis=0).T @ correlated.sum(axis=0)
    alone = np.einsum("kri,krj->ij", plain, correlated)
    return 0.5 * ((total - alone) + (total - alone).T)


def _reference_points(probe: ObservedRows) -> dict[tuple[str, bytes], int]:
    """First row of each point with all components and a reference, by reference and position."""
    reference = probe.observations.reference
    if reference is None:
        return {}
    return {
        (reference, place.tobytes()): int(start)
        for place, start, count in zip(probe.position, probe.start, probe.components, strict=True)
        if count == 3 and np.isfinite(place[0])
    }
