"""How much the spatial correlation of residuals widens an interval.

Residuals of neighbouring points of a full field are correlated. Points are cut into compact blocks
along a Morton curve; if points were independent, the scores of a block would have a known
covariance. The ratio of what is seen to that is the factor on the variance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.search import LocalProbe
from palpate.geometry import morton_order

_MAX_HALVINGS = 7
_MIN_POINTS_PER_BLOCK = 6
_MIN_BLOCKS = 8
# Standard errors by which a factor must exceed 1.
_SIGNIFICANT = 3.0


@dataclass(frozen=True, slots=True)
class CorrelationFactor:
    """Factor on the variance of the constants for correlated residuals.

    Parameters
    ----------
    variance : float            >= 1; exactly 1 where no correlation shows
    degrees : float             degrees of freedom of the factor, infinite where it is 1
    block_points : float        mean number of points in the blocks it was taken from, 1 = none
    """

    variance: float
    degrees: float
    block_points: float


def correlation_factor(
    local: Sequence[LocalProbe],
    projection: Sequence[Float[np.ndarray, "_ 2"]],
    *,
    score_variance: float,
) -> CorrelationFactor:
    """Factor on the variance of the constants, pooled over all probings.

    Parameters
    ----------
    local : sequence of LocalProbe      at the joint minimum
    projection : (d + n, 2) for each    takes the shifts out of the design of (nu, log G)
    score_variance : float              mean square of the robust score

    Returns
    -------
    CorrelationFactor                   the largest over block sizes, where any is significant
    """
    parts = [
        _block_sums(probe, turn)
        for probe, turn in zip(local, projection, strict=True)
        if np.isfinite(probe.rows.position[:, 0]).sum() >= _MIN_BLOCKS * _MIN_POINTS_PER_BLOCK
    ]
    if not parts:
        return CorrelationFactor(1.0, np.inf, 1.0)
    metric = np.linalg.pinv(sum(part.information.sum(0) for part in parts), hermitian=True)
    best, found = CorrelationFactor(1.0, np.inf, 1.0), False
    level = 0
    while True:
        seen, expected, points = [], [], []
        for part in parts:
            if len(part.score) >> level >= _MIN_BLOCKS:
                merged = part.merged(level)
                seen.append(np.einsum("bi,ij,bj->b", merged.score, metric, merged.score))
                expected.append(score_variance * merged.expected(metric))
                points.append(part.points / len(merged.score))
        if not seen:
            return best if found else CorrelationFactor(1.0, np.inf, 1.0)
        want = np.concatenate(expected)
        ratio = float(np.concatenate(seen).sum() / want.sum())
        degrees = float(want.sum() ** 2 / (want**2).sum())
        found = found or ratio > 1 + _SIGNIFICANT * np.sqrt(2 / degrees)
        if ratio > best.variance:
            best = CorrelationFactor(ratio, degrees, float(np.mean(points)))
        level += 1


@dataclass(frozen=True, slots=True, eq=False)
class _BlockSums:
    """Sums over the blocks of one probing; b blocks in Morton order, a power of two."""

    score: Float[np.ndarray, "b 2"]
    information: Float[np.ndarray, "b 2 2"]
    leak: Float[np.ndarray, "b 2 n"]
    shift_covariance: Float[np.ndarray, "n n"]
    points: int

    def merged(self, level: int) -> "_BlockSums":
        """Sums over blocks 2**level times as large."""
        count = len(self.score) >> level
        return _BlockSums(
            self.score.reshape(count, -1, 2).sum(1),
            self.information.reshape(count, -1, 2, 2).sum(1),
            self.leak.reshape(count, -1, *self.leak.shape[1:]).sum(1),
            self.shift_covariance,
            self.points,
        )

    def expected(self, metric: np.ndarray) -> np.ndarray:
        """Mean of score' metric score of each block for independent points, leverage taken off."""
        plain = np.einsum("bij,ij->b", self.information, metric)
        constants = np.einsum(
            "bij,jk,bkl,li->b", self.information, metric, self.information, metric
        )
        leak = np.einsum("bij,jk,blk,li->b", self.leak, self.shift_covariance, self.leak, metric)
        return plain - constants - leak


def _block_sums(probe: LocalProbe, projection: np.ndarray) -> _BlockSums:
    """Scores and information of the finest blocks of one probing, the tip left out."""
    rows = probe.rows
    order = morton_order(rows.position)
    order = order[: int(np.isfinite(rows.position[:, 0]).sum())]
    finest = min(_MAX_HALVINGS, int(np.log2(len(order) / _MIN_POINTS_PER_BLOCK)))
    clean, shifts = probe.design @ projection, probe.design[:, probe.common :]
    row_score = rows.per_row(probe.weight) * probe.residual
    columns = np.concatenate(
        [
            clean * row_score[:, None],
            clean[:, [0]] * clean,
            clean[:, [1]] * clean,
            clean[:, [0]] * shifts,
            clean[:, [1]] * shifts,
        ],
        axis=1,
    )
    point_sums = np.add.reduceat(columns, rows.start, axis=0)[order]
    first = np.arange(2**finest) * len(order) // 2**finest
    sums = np.add.reduceat(point_sums, first, axis=0)
    normal = shifts.T @ shifts + np.eye(shifts.shape[1])
    return _BlockSums(
        sums[:, :2],
        sums[:, 2:6].reshape(-1, 2, 2),
        sums[:, 6:].reshape(-1, 2, shifts.shape[1]),
        np.linalg.inv(normal),
        len(order),
    )
