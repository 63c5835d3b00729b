"""Whether stiffness changes with the load, from pushes of unlike force at one place.

What one modulus predicts of every push fits it up to an amplitude; where the object stiffens, or
its shape does, amplitudes fall with the force: the modulus is proportional to force^exponent. What
the model leaves over in proportion to the force, the same in all pushes at a place, is no scatter.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import ndtri

from palpate.estimation import FALSE_ALARM, Evaluation
from palpate.records import HALF_95, Constant, LoadDependence, Session

# Forces less unlike than so tell nothing of a dependence.
_UNLIKE = 1.25
# Standard deviations from which a dependence counts as shown.
_SHOWN = -float(ndtri(0.5 * FALSE_ALARM))
# Fewest points that several pushes have in common, for what they leave over to be compared.
_FEWEST = 3


def load_dependence(session: Session, minimum: Evaluation) -> LoadDependence | None:
    """The exponent that pushes at the same place ask for.

    Parameters
    ----------
    session : Session               k probings
    minimum : Evaluation            the fit of one modulus to them, in this order

    Returns
    -------
    LoadDependence or None          None: no place was pushed with forces of unlike size
    """
    force = np.array([np.linalg.norm(probing.force) for probing in session.probings])
    stiffness, variance = np.zeros((2, len(force)))
    load, used = np.zeros(len(force)), np.zeros(len(force), dtype=bool)
    level = []
    for group in _places(session, force):
        amplitude, variance[group] = _amplitudes(minimum, group, force[group])
        if (amplitude <= 0.0).any():
            continue
        load[group] = np.log(force[group]) - np.log(force[group]).mean()
        level.append(-float(np.log(amplitude).mean()))
        stiffness[group] = -np.log(amplitude) - level[-1]
        used[group] = True
    if not level:
        return None
    square = float(load @ load)
    exponent = float(load @ stiffness) / square
    noise = float(load**2 @ variance) / square**2
    free = int(used.sum()) - len(level) - 1
    off = stiffness - exponent * load
    scatter = float(off @ off) / free / square if free else 0.0
    ends = force[used].min(), force[used].max()
    middle = float(np.log(force[used]).mean())
    low, high = np.exp(np.mean(level) + exponent * (np.log(ends) - middle))
    std = float(np.sqrt(max(noise, scatter)))
    interval = exponent - HALF_95 * std, exponent + HALF_95 * std
    return LoadDependence(
        Constant(exponent, std, interval), (float(ends[0]), float(ends[1])),
        (float(low), float(high)),
    )  # fmt: skip


def is_shown(dependence: LoadDependence | None) -> bool:
    """Whether pushes rule out a linear object.

    Parameters
    ----------
    dependence : LoadDependence or None      None: nothing tells
    """
    return (
        dependence is not None and abs(dependence.exponent.value) > _SHOWN * dependence.exponent.std
    )


def _places(session: Session, force: Float[np.ndarray, " k"]) -> Iterator[Int[np.ndarray, " g"]]:
    """Numbers of the pushes at each place that was pushed with forces of unlike size."""
    left = [k for k in range(len(force)) if force[k] > 0.0]
    while left:
        first = session.probings[left[0]]
        same = np.array([k for k in left if session.probings[k].repeats(first)])
        left = [k for k in left if k not in same]
        if force[same].max() > _UNLIKE * force[same].min():
            yield same


def _amplitudes(
    minimum: Evaluation, group: Int[np.ndarray, " g"], force: Float[np.ndarray, " g"]
) -> tuple[Float[np.ndarray, " g"], Float[np.ndarray, " g"]]:
    """Measured displacement over the predicted one in every push at a place, and the variance of
    its logarithm."""
    predicted = [_predicted(minimum, int(k)) for k in group]
    seen = [minimum.problem.probes[k].observations for k in group]
    measured = [push.displacement for push in seen]
    present = [np.isfinite(values).all(axis=1) for values in measured]
    amplitude = np.array([
        float(u[row].ravel() @ w[row].ravel()) / float((w[row] ** 2).sum())
        for u, w, row in zip(measured, predicted, present, strict=True)
    ])  # fmt: skip
    left = [u - a * w for u, a, w in zip(measured, amplitude, predicted, strict=True)]
    common = _common([push.position for push in seen], present)
    if common.sum() >= _FEWEST:
        mean = np.mean([values[common] / f for values, f in zip(left, force, strict=True)], axis=0)
        left = [values[common] - f * mean for values, f in zip(left, force, strict=True)]
        present = [np.ones(len(values), dtype=bool) for values in left]
        predicted = [values[common] for values in predicted]
    variance = [
        float((r[row] ** 2).mean() / (w[row] ** 2).sum())
        for r, w, row in zip(left, predicted, present, strict=True)
    ]
    force_error = [
        float(np.linalg.norm(push.force_std * push.force)) / f**2
        for push, f in zip(seen, force, strict=True)
    ]
    return amplitude, np.array(variance) / amplitude**2 + np.square(force_error)


def _predicted(minimum: Evaluation, index: int) -> Float[np.ndarray, "n 3"]:
    """Displacement of a push's points with the force that was measured, and without its errors."""
    theta, block = minimum.theta.copy(), minimum.problem.layout.blocks[index]
    theta[block.force] = 0.0
    theta[block.errors] = 0.0
    return minimum.problem.predicted_points(index, theta)


def _common(
    places: Sequence[Float[np.ndarray, "_ 3"]], present: Sequence[Bool[np.ndarray, " _"]]
) -> Bool[np.ndarray, " n"]:
    """Points that all pushes measured, where all have the same ones; else none."""
    if any(not np.array_equal(places[0], points) for points in places[1:]):
        return np.zeros(len(places[0]), dtype=bool)
    return np.logical_and.reduce(present)
