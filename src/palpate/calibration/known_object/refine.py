"""Refinement of a rig from pictures of a textured object, by points seen in several cameras.

The rays of all cameras to a point must intersect, and the points must lie on the object's surface.
The residuals of both conditions correct the camera parameters, with the covariance of the
calibration as the prior. Rays alone do not determine the scale, and hardly separate the angle
between the cameras from the depth of the object; the known surface does.

Source: Triggs et al., Bundle adjustment: a modern synthesis (2000), with the points eliminated;
noise and correlation between neighbouring points as in `geometry/registration`.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtri

from palpate.calibration.known_object.body import GROUPS, Body, KnownSurface
from palpate.calibration.known_object.ties import (
    Ties,
    jacobians,
    residuals,
    tie_points,
    variance_inflation,
)
from palpate.errors import CalibrationError
from palpate.geometry import compact_groups
from palpate.records import Rig, RigCovariance
from palpate.shapes import PointScalars
from palpate.vision import calibration_numbers, moved_rig

_MAX_STEPS = 30
# Convergence in prior standard deviations; and the step below which derivatives are not renewed.
_SMALL_STEP, _NEAR_STEP = 1e-3, 0.05
# A point is a gross error if noise leaves as large a residual with this probability.
_GROSS = 1e-6
# Held-out points must improve by this many standard errors of the difference.
_SIGNIFICANT = 2.0
# Fewer points add nothing to a calibration with boards.
_MIN_POINTS = 60
# Prior standard deviations without a covariance: rotation [rad], shift as a fraction of the
# camera's distance from the first.
_TURN, _SHIFT = np.deg2rad(0.5), 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A refined rig, or the given one if the refinement did not improve it.

    Attributes
    ----------
    rig : Rig
    known : RigCovariance           of its parameters
    better : bool                   False: `rig` is the given one
    points, rejected : int          points used, and points rejected: gross errors and those seen by
                                    fewer than two cameras
    before, after : float [px]      rms residual per coordinate of held-out points: with the given
                                    rig, and with one refined without them
    largest_change : str            the parameter that changed most, e.g. "c1.ry by -2.1 of its
                                    standard deviations"; empty if `better` is False
    """

    rig: Rig
    known: RigCovariance
    better: bool
    points: int
    rejected: int
    before: float
    after: float
    largest_change: str


def refined_rig(
    rig: Rig, known: RigCovariance | None, ties: Ties, surface: KnownSurface | None = None
) -> Refined:
    """Refine a rig from points matched between its cameras, if that improves it.

    The refinement is accepted if a rig refined from half of the points (every second group of
    neighbours) significantly reduces the residuals of the other half.

    Parameters
    ----------
    rig : Rig
    known : RigCovariance or None   None: prior standard deviations of half a degree and 1 % of the
                                    distance for the poses relative to the first camera; exact
                                    lenses
    ties : Ties                     of all instants
    surface : KnownSurface or None  None: only the rays are used

    Returns
    -------
    Refined

    Raises
    ------
    CalibrationError                fewer than 60 points; a covariance of another rig
    """
    prior = _default_prior(rig) if known is None else known
    scale = _square_root(prior.covariance)
    usable = np.isfinite(residuals(rig, ties)).all(axis=1)
    ties, count = ties.chosen(usable), len(usable)
    if usable.sum() < _MIN_POINTS:
        raise CalibrationError(
            f"{int(usable.sum())} points of the object are seen by two cameras; {_MIN_POINTS} are"
            " needed to refine a rig: give pictures of more instants, with a *, and see whether the"
            " object is textured and large in the pictures of two cameras"
        )
    label = compact_groups(tie_points(rig, ties), GROUPS)
    half = label % 2 == 0
    trial = _fit(rig, prior, scale, ties.chosen(half), label[half], surface)
    held = ties.chosen(~half)
    before, after, gain = _improvement(rig, trial.rig, held, label[~half])
    if gain < _SIGNIFICANT:
        used = int(usable.sum())
        return Refined(rig, prior, False, used, count - used, before, after, "")
    whole = _fit(rig, prior, scale, ties, label, surface)
    value = calibration_numbers(whole.rig.cameras, prior.names)
    covariance = 0.5 * (whole.covariance + whole.covariance.T)
    return Refined(
        whole.rig, RigCovariance(prior.names, value, covariance, "refinement"), True,
        int(whole.good.sum()), count - int(whole.good.sum()), before, after,
        _largest_change(whole.step, prior),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A refined rig, flags of the points used, step of the parameters, and their covariance."""

    rig: Rig
    good: Bool[np.ndarray, " n"]
    step: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]


def _fit(
    rig: Rig,
    prior: RigCovariance,
    scale: Float[np.ndarray, "p k"],
    ties: Ties,
    label: np.ndarray,
    surface: KnownSurface | None,
) -> _Fit:
    """Gauss-Newton iteration from a rig, in units of the prior's standard deviations."""
    count = scale.shape[1]
    # Unknowns: steps of the rig; rotation, shift and relative size of the object.
    total, inflation, step = np.zeros(count), 1.0, np.full(count, np.inf)
    body = None if surface is None else Body(surface, surface.pose, 0.0)
    for _ in range(_MAX_STEPS):
        here = moved_rig(rig, prior.names, scale @ total)
        residual = residuals(here, ties)
        good, noise = _good(residual, _freedom(ties))
        if np.abs(step).max() > _NEAR_STEP:
            jacobian, _ = jacobians(here, prior, scale, ties)
        weight = good / (inflation * noise**2)
        score = np.einsum("n,nr,nrk->nk", weight, residual, jacobian)
        # Without a surface the last seven unknowns stay zero.
        matrix, right = np.eye(count + 7), np.zeros(count + 7)
        matrix[:count, :count] += np.einsum("n,nrk,nrl->kl", weight, jacobian, jacobian)
        right[:count] = -score.sum(axis=0) - total
        if body is not None:
            more_matrix, more_right = body.equations(here, prior, scale)
            matrix[count:, count:] = 0.0
            matrix, right = matrix + more_matrix, right + more_right
        change = np.linalg.solve(matrix, right)
        step = change[:count]
        total = total + step
        body = None if body is None else body.moved(here, change[count:])
        inflation = max(variance_inflation(score * np.sqrt(inflation), label), 1.0)
        if np.abs(step).max() < _SMALL_STEP:
            break
    covariance = scale @ np.linalg.inv(matrix)[:count, :count] @ scale.T
    return _Fit(moved_rig(rig, prior.names, scale @ total), good, scale @ total, covariance)


def _freedom(ties: Ties) -> PointScalars:
    """Degrees of freedom of each point: observed coordinates minus three."""
    return 2.0 * np.isfinite(ties.pixels).all(axis=2).sum(axis=0) - 3.0


def _good(
    residual: Float[np.ndarray, "n r"], freedom: PointScalars
) -> tuple[Bool[np.ndarray, " n"], float]:
    """Points that are not gross errors, and the ratio of actual to claimed noise, from medians."""
    # Quantiles of chi-squared; importing scipy.stats for them would take most of a second.
    square = (residual**2).sum(axis=1)
    noise = float(np.sqrt(np.median(square / chdtri(freedom, 0.5))))
    noise = max(noise, 1e-9)
    return square < noise**2 * chdtri(freedom, _GROSS), noise


def _improvement(rig: Rig, other: Rig, ties: Ties, label: np.ndarray) -> tuple[float, float, float]:
    """Rms residuals of points with two rigs [px], and the improvement in standard errors.

    Gross errors with the second rig are left out of both. The standard error is from sums over
    groups, as neighbouring points are correlated.
    """
    freedom, seen = _freedom(ties), np.isfinite(ties.pixels).all(axis=2)
    both = [residuals(one, ties) for one in (rig, other)]
    good, _ = _good(both[1], freedom)
    squares = [(residual[good] ** 2).sum(axis=1) for residual in both]
    sums = np.bincount(label[good], squares[0] - squares[1])[np.unique(label[good])]
    error = float(sums.std()) * np.sqrt(len(sums))
    gain = float(sums.sum()) / error if error > 0.0 else 0.0
    typical = float(np.sqrt(np.median(ties.covariance[seen][:, 0, 0])))
    before, after = (
        typical * float(np.sqrt(square.sum() / freedom[good].sum())) for square in squares
    )
    return before, after, gain


def _square_root(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p k"]:
    """Square root of a covariance: independent steps of one standard deviation each, as columns.

    Parameters without variance get zero rows; directions without variance are dropped.
    """
    size = np.sqrt(np.diag(covariance))
    free = size > 0.0
    unit = covariance[np.ix_(free, free)] / np.outer(size[free], size[free])
    value, vector = np.linalg.eigh(unit)
    keep = value > 1e-12 * value[-1]
    root = np.zeros((len(size), int(keep.sum())))
    root[free] = size[free, None] * vector[:, keep] * np.sqrt(value[keep])
    return root


def _default_prior(rig: Rig) -> RigCovariance:
    """Prior of a rig without a covariance: exact lenses, and poses that may have shifted."""
    terms = ("rx", "ry", "rz", "tx", "ty", "tz")
    first = rig.cameras[rig.reference]
    names = [f"{first.name}.fx"]
    sigma = [0.0]
    back = np.linalg.inv(first.T_camera_object)
    for camera in rig.cameras:
        if camera is first:
            continue
        distance = float(np.linalg.norm((camera.T_camera_object @ back)[:3, 3]))
        names += [f"{camera.name}.{term}" for term in terms]
        sigma += [_TURN] * 3 + [_SHIFT * distance] * 3
    value = calibration_numbers(rig.cameras, names)
    return RigCovariance(tuple(names), value, np.diag(np.square(sigma)), rig.source)


def _largest_change(step: Float[np.ndarray, " p"], prior: RigCovariance) -> str:
    """The parameter with the largest change in prior standard deviations, in words."""
    sigma = np.sqrt(np.diag(prior.covariance))
    unit = np.divide(step, sigma, out=np.zeros_like(step), where=sigma > 0.0)
    worst = int(np.abs(unit).argmax())
    return f"{prior.names[worst]} by {unit[worst]:+.1f} of its standard deviations"
