"""Bootstrap over probings, or over blocks of points where there is one probing only.

Refits are one scoring step each from the statistics of the probings, so a thousand of them cost a
few milliseconds. For small spreads that is the refit itself; towards a bound or along a flat valley
it is not, and the profile is to be preferred.
"""

import numpy as np
from jaxtyping import Float

from palpate.estimation.intervals.sandwich import Scores


def bootstrap_constants(
    scores: Scores, *, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "b 2"]:
    """Deviations of (nu, log G) from the estimate, one for each resampled set of probings.

    Parameters
    ----------
    scores : Scores
    count : int                     number of resamples
    rng : numpy Generator

    Returns
    -------
    (b, 2) float                    drawn from the model where there is one probing only
    """
    k = len(scores.score)
    if k < 2:
        value, vector = np.linalg.eigh(scores.covariance())
        root = vector * np.sqrt(np.maximum(value, 0.0))
        return rng.normal(size=(count, 2)) @ root.T
    times = rng.multinomial(k, np.full(k, 1.0 / k), size=count).astype(np.float64)
    centred = scores.score - scores.score.mean(0)
    total = np.einsum("bk,kij->bij", times, scores.information)
    size = np.sqrt(np.maximum(np.einsum("bii->bi", total), np.finfo(float).tiny))
    unit = total / (size[:, :, None] * size[:, None, :]) + 1e-10 * np.eye(2)
    step = np.linalg.solve(unit, ((times @ centred) / size)[..., None])[..., 0] / size
    # k resampled probings scatter by (k - 1) / k of what they stand for.
    return step * np.sqrt(k / (k - 1))
