"""Whether the data contradict the model, and which force disagrees with the others."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.special import chdtrc, ndtri

from palpate.estimation.gauss_newton import with_noise
from palpate.estimation.measured_components import FIRST_CLAIMED, GROUP_NAMES
from palpate.estimation.noise import FINEST
from palpate.estimation.normal_equations import Evaluation
from palpate.estimation.problem import FORCES, Problem
from palpate.geometry import morton_order
from palpate.records import IMPOSSIBLE
from palpate.shapes import Points, Vector3

# Chance that a check says of a sound session that something is wrong: that a force is off, that the
# errors together contradict the model, that pushes contradict each other, and so on.
FALSE_ALARM = 1 / 400
# So many forces must agree for each that does not.
_AGREEING = 3
# A force is as good as unknown with a standard deviation of so many times its size.
_FREE = 10.0
# What residuals have in common contradicts the model where its own error is more than so many times
# as large as comparisons of meshes say, or it is itself so many times as large as that error.
_LARGEST_SCALE, _LARGEST_PATTERN = 2.0, 5.0
# Probability of a family of errors beyond which its priors contradict the data: that of five
# standard deviations.
_IMPOSSIBLE_FAMILY = float(chdtrc(1, IMPOSSIBLE**2))
# A component is reversed if its residuals exceed so many times its own displacement and this
# fraction of that of all components, in at least so many rows.
_REVERSED_FACTOR, _LEAST_FRACTION_OF_ALL, _LEAST_ROWS = 1.3, 0.1, 8
# Fewer points show no pattern; more cost time and add no information.
_FEWEST_POINTS, _MOST_POINTS = 30, 1000
# Lengths below are fractions of the diagonal of the points' bounding box.
_BLOCK, _DISTANT, _NEAR = 0.1, (0.2, 0.4), 0.15
# Standard errors of the correlation across the body; energy of residuals over that of noise that is
# spread evenly; mean over median of the squared length of a three-component Gaussian vector.
_SIGNIFICANT, _CONCENTRATED, _MEAN_OVER_MEDIAN = 10.0, 4.0, 1.27
# Noise level over the claim, and energy of smoothed residuals over that of independent ones, from
# which neighbours contradict the claim together.
_EXCEEDED, _ALIKE = 1.5, 2.0
# A median over so many neighbours tolerates three outliers.
_FEWEST_NEIGHBOURS, _NEIGHBOUR_SHARE = 7, 30
_LONGEST = 3.0


@dataclass(frozen=True, slots=True)
class Contradiction:
    """How the data contradict the model.

    Attributes
    ----------
    kind : str                      "unexplained", "errors", "reversed"
    sigmas : float                  how far beyond what is allowed: size of the model's error over
                                    the expected one, or root mean square error of the family in
                                    prior standard deviations, or residual over motion
    source : str                    family of the errors, or component; else the probing where most
                                    is left over
    share : float [-]               of the motion that the model does not explain
    place : (3,) float [m]          where that is largest
    landmark : str                  the landmark near that place, empty where none is
    """

    kind: str
    sigmas: float
    source: str
    share: float = 0.0
    place: tuple[float, ...] = ()
    landmark: str = ""


def with_outlying_forces_freed(
    minimum: Evaluation, poisson_range: tuple[float, float]
) -> tuple[Evaluation, dict[str, float]]:
    """Set forces free that disagree with the others, one at a time, as long as three agree for
    each: two constants are fitted, so that two pushes agree on wrong ones, too.

    A force is held by its prior; setting it free lowers the objective by the square of its
    deviation from what all else says about it, over the variance of the difference.

    Parameters
    ----------
    minimum : Evaluation            of all probings
    poisson_range : (float, float)

    Returns
    -------
    Evaluation                      with these forces unknown
    probing's name -> float         deviation of each, in standard deviations of the disagreement,
                                    along the force
    """
    freed: dict[str, float] = {}
    count = len(minimum.problem.probes)
    limit = -float(ndtri(0.5 * FALSE_ALARM / count))
    for _ in range((count - 1) // _AGREEING):
        deviation = np.abs(force_deviations(minimum))
        deviation[[probe.name in freed for probe in minimum.problem.probes]] = 0.0
        worst = int(deviation.argmax())
        if deviation[worst] < limit:
            break
        free = with_noise(*_freed(minimum, worst), poisson_range)
        if not free.converged:
            break
        freed[minimum.problem.probes[worst].name] = float(deviation[worst])
        minimum = free
    return minimum, freed


def force_deviations(minimum: Evaluation) -> Float[np.ndarray, " k"]:
    """Deviation of every force from what all else says about it, along the force, in standard
    deviations; 0 where the force is exact or zero.

    Parameters
    ----------
    minimum : Evaluation

    Returns
    -------
    (k,) float [-]
    """
    problem, covariances = minimum.problem, minimum.normal.own_covariances
    deviations = []
    for probe, block, covariance in zip(
        problem.probes, problem.layout.blocks, covariances, strict=True
    ):
        seen = probe.observations
        length = float(np.linalg.norm(seen.force))
        along = seen.force_std * seen.force / max(length, np.finfo(float).tiny)
        left = float(along @ along - along @ covariance[:3, :3] @ along)
        known = left > 1e-9 * float(along @ along)
        deviations.append(along @ minimum.theta[block.force] / np.sqrt(left) if known else 0.0)
    return np.array(deviations)


def _freed(minimum: Evaluation, index: int) -> tuple[Problem, Float[np.ndarray, " n"]]:
    """The problem with one force unknown, and a start."""
    problem, theta = minimum.problem, minimum.theta.copy()
    probe = problem.probes[index]
    seen, block = probe.observations, problem.layout.blocks[index]
    std = np.full(3, _FREE * float(np.linalg.norm(seen.force)))
    theta[block.force] *= seen.force_std / std
    probes = list(problem.probes)
    probes[index] = replace(probe, observations=replace(seen, force_std=std))
    return replace(problem, probes=tuple(probes)), theta


def contradictions(minimum: Evaluation) -> tuple[Contradiction, ...]:
    """What contradicts the model, the clearest first.

    Parameters
    ----------
    minimum : Evaluation            of all probings

    Returns
    -------
    tuple of Contradiction          empty where nothing does
    """
    return (*_reversed(minimum), *_impossible_families(minimum), *_unexplained(minimum))


def _reversed(minimum: Evaluation) -> list[Contradiction]:
    """Components whose residuals exceed what moved: under a correct model noise is part of the
    measurement, so they cannot. Needs only a few points and no claimed noise level."""
    probes = minimum.problem.probes
    group = np.concatenate([probe.group for probe in probes]) % FIRST_CLAIMED
    measured = np.concatenate([probe.measured for probe in probes])
    residual = np.concatenate(minimum.residual)
    overall, suspects = float(np.sqrt((measured**2).mean())), []
    for index in np.unique(group):
        chosen = group == index
        left, motion = (float(np.sqrt((x[chosen] ** 2).mean())) for x in (residual, measured))
        is_large = left > _LEAST_FRACTION_OF_ALL * overall
        if is_large and chosen.sum() >= _LEAST_ROWS and left > _REVERSED_FACTOR * motion:
            size = left / max(motion, FINEST * overall)
            suspects.append(Contradiction("reversed", size, GROUP_NAMES[index]))
    return suspects


def _impossible_families(minimum: Evaluation) -> list[Contradiction]:
    """Families of errors that are farther off than their priors allow, each by itself or all of
    them together: a wrong model bends many of them a little."""
    families = defaultdict[str, list[tuple[float, float]]](list)
    for source, value, std in _errors(minimum):
        # The square of an estimate is on average what the data take of its prior's variance.
        families[source].append((abs(value), 1.0 - std**2))
    contradictions = []
    for source, family in families.items():
        farthest = max(value for value, _ in family)
        if _chance(family) < _IMPOSSIBLE_FAMILY or farthest > IMPOSSIBLE:
            contradictions.append(Contradiction("errors", farthest, source))
    if not contradictions and _chance(
        [error for family in families.values() for error in family]
    ) < (FALSE_ALARM):
        source = min(families, key=lambda name: _chance(families[name]))
        contradictions = [
            Contradiction("errors", max(value for value, _ in families[source]), source)
        ]
    return sorted(contradictions, key=lambda contradiction: -contradiction.sigmas)


def _chance(errors: Sequence[tuple[float, float]]) -> float:
    """Probability that errors are together so far off, from their sizes and degrees of freedom."""
    square, degrees = sum(value**2 for value, _ in errors), sum(freedom for _, freedom in errors)
    return float(chdtrc(max(degrees, 1.0), square))


def _errors(minimum: Evaluation) -> Iterator[tuple[str, float, float]]:
    """Source, value and standard deviation of every named error, in standard deviations of its
    prior; then the deviations of the forces."""
    problem, theta, std = minimum.problem, minimum.theta, minimum.normal.std
    named = [(problem.shared, problem.layout.errors)]
    named += [(problem.own(k), block.errors) for k, block in enumerate(problem.layout.blocks)]
    for parameters, where in named:
        for parameter, value, deviation in zip(parameters, theta[where], std[where], strict=True):
            if not parameter.is_material:
                yield parameter.source, float(value), float(deviation)
    yield from (
        (FORCES, float(deviation), 0.0)
        for deviation in force_deviations(minimum)
        if deviation != 0.0
    )


def _unexplained(minimum: Evaluation) -> list[Contradiction]:
    """Probings whose residuals are alike across the body, or stand out at one place, by more than
    the model's own error: noise is independent from point to point, or shared by neighbours."""
    problem, layout = minimum.problem, minimum.problem.layout
    contradictions = []
    for probe, block, unknown, residual in zip(
        problem.probes, layout.blocks, problem.unknown, minimum.residual, strict=True
    ):
        left = probe.unwhitened(residual + unknown.moved(minimum.theta[block.unknown]))
        whole = (probe.components == 3) & np.isfinite(probe.position[:, 0])
        points = np.flatnonzero(whole)
        if len(points) < _FEWEST_POINTS:
            continue
        points = points[morton_order(probe.position[points])][:: -(-len(points) // _MOST_POINTS)]
        claim = np.sqrt(np.add.reduceat(probe.unit**2, probe.start) / probe.components)[points]
        # Where the surface turns away from the cameras, errors are large and alike.
        weight = (np.median(claim) / claim)[:, None]
        rows = probe.start[points, None] + np.arange(3)
        position = probe.position[points]
        moved = np.sqrt(((probe.unwhitened(probe.measured)[rows] * weight) ** 2).mean())
        known = np.sqrt(((unknown.size[points, None] * weight) ** 2).mean())
        known = max(float(known), FINEST * float(moved))
        exceeds = bool(problem.level[probe.group].min() > _EXCEEDED) and probe.has_claims
        size, where, square = _pattern(position, left[rows] * weight, exceeds=exceeds)
        if size > (0.0 if problem.scale > _LARGEST_SCALE else _LARGEST_PATTERN * known):
            share = float(np.sqrt(square.mean() / 3.0) / moved)
            landmark = _landmark(probe.observations.landmarks, where, position)
            contradictions.append(
                Contradiction(
                    "unexplained",
                    max(size / known, problem.scale),
                    probe.name,
                    share,
                    tuple(where.tolist()),
                    landmark,
                )
            )
    return sorted(contradictions, key=lambda contradiction: -contradiction.share)


def _pattern(
    position: Points, residual: Float[np.ndarray, "n 3"], *, exceeds: bool
) -> tuple[float, Vector3, Float[np.ndarray, " n"]]:
    """Size [m] of what residuals have in common across the body, at one place, or, where they
    exceed what was claimed, among neighbours; 0 where noise explains it. Then where it is largest,
    and the squares of the smoothed residuals."""
    count = max(_FEWEST_NEIGHBOURS, len(position) // _NEIGHBOUR_SHARE)
    smooth = np.median(residual[cKDTree(position).query(position, count)[1]], axis=1)
    square = (smooth**2).sum(axis=1)
    noise = _MEAN_OVER_MEDIAN * float(np.median(square))
    local = np.sqrt(max(float(square.mean()) - noise, 0.0) / 3.0)
    white = np.pi / 2.0 / count * float((residual**2).sum(axis=1).mean())
    stands_out = square.mean() > _CONCENTRATED * noise
    if exceeds and square.mean() > _ALIKE * white:
        local, stands_out = float(np.sqrt(square.mean() / 3.0)), True
    errors, shared = _distant_correlation(
        position / np.linalg.norm(np.ptp(position, axis=0)), residual
    )
    size = max(local if stands_out else 0.0, shared if errors > _SIGNIFICANT else 0.0)
    return float(size), position[int(square.argmax())], square


def _distant_correlation(
    position: Points, residual: Float[np.ndarray, "n 3"]
) -> tuple[float, float]:
    """Correlation of residuals of distant blocks: in standard errors, and as a length [m].

    Residuals are summed over blocks; under the null hypothesis of noise the signs of the blocks'
    sums are random, which gives the variance of the sum over all pairs of blocks exactly. Single
    residuals are truncated to three times the median length.
    """
    length = np.linalg.norm(residual, axis=1)
    longest = _LONGEST * float(np.median(length))
    tiny = np.finfo(float).tiny
    truncated = residual * np.minimum(1.0, longest / np.maximum(length, tiny))[:, None]
    cells = np.floor(position / _BLOCK).astype(np.int64)
    _, block, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = np.zeros((len(count), 6))
    np.add.at(sums, block.ravel(), np.hstack([position, truncated]))
    centre, total = sums[:, :3] / count[:, None], sums[:, 3:] / np.sqrt(count)[:, None]
    distance = np.linalg.norm(centre[:, None] - centre[None], axis=2)
    first, second = np.nonzero(np.triu((distance > _DISTANT[0]) & (distance < _DISTANT[1])))
    products = (total[first] * total[second]).sum(axis=1)
    spread = float(np.sqrt((products**2).sum()))
    if spread == 0.0:
        return 0.0, 0.0
    mean = products.sum() / np.sqrt(count[first] * count[second]).sum()
    return float(products.sum()) / spread, float(np.sqrt(max(mean, 0.0) / 3.0))


def _landmark(
    landmarks: Mapping[str, Float[np.ndarray, "_ 3"]],
    point: Vector3,
    position: Float[np.ndarray, "p 3"],
) -> str:
    """The landmark nearest to a place, if one is near."""
    reach = _NEAR * float(np.linalg.norm(np.ptp(position[np.isfinite(position[:, 0])], axis=0)))
    distance = {
        name: float(np.linalg.norm(points - point, axis=1).min())
        for name, points in landmarks.items()
    }
    nearest = min(distance, key=lambda name: distance[name], default="")
    return nearest if nearest and distance[nearest] < reach else ""
