"""A rig made better by the pictures of a textured object: points that all cameras see.

The rays of all cameras to one point meet, and the points lie on the object's surface. What is left
of both corrects the numbers of the cameras, each as far as it is not known already: the covariance
of the calibration is the prior. Rays alone leave size open, and hardly tell how far the cameras
turn toward each other from how deep the object is; its surface tells that.

Source: Triggs et al., Bundle adjustment: a modern synthesis (2000), with the points eliminated; the
noise and what neighbours share as in `geometry/registration`.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtri

from palpate.calibration.known_object.body import GROUPS, Body, KnownSurface
from palpate.calibration.known_object.ties import Ties, places, residuals, shared_factor, slopes
from palpate.errors import CalibrationError
from palpate.geometry import compact_groups
from palpate.records import Rig, RigCovariance
from palpate.shapes import PointScalars
from palpate.vision import calibration_numbers, moved_rig

_MAX_STEPS = 30
# A step below this many standard deviations of what was known changes nothing; derivatives from
# before a step below the second are still right.
_SMALL_STEP, _NEAR_STEP = 1e-3, 0.05
# A point is a gross error where chance leaves as much once in a million.
_GROSS = 1e-6
# Points that took no part must lie nearer by so many standard errors of the difference.
_SIGNIFICANT = 2.0
# Fewer points say nothing of a rig that a calibration with boards has not said.
_FEWEST = 60
# Without a covariance: how far cameras may have moved since [rad, share of their distance].
_TURN, _SHIFT = np.deg2rad(0.5), 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A rig after its refinement, or as it was where that made nothing better.

    Attributes
    ----------
    rig : Rig
    known : RigCovariance           of its numbers
    better : bool                   False: `rig` is the one that was given
    points, rejected : int          points used, and gross errors among those given
    before, after : float [px]      what is left of points that took no part, rms of a coordinate:
                                    with the rig that was given, with one refined without them
    moved : str                     the number that changed most, "c1.ry by -2.1 standard
                                    deviations"; empty where nothing did
    """

    rig: Rig
    known: RigCovariance
    better: bool
    points: int
    rejected: int
    before: float
    after: float
    moved: str


def refined_rig(
    rig: Rig, known: RigCovariance | None, ties: Ties, surface: KnownSurface | None = None
) -> Refined:
    """Correct a rig by points that its cameras see, if that makes it better.

    Better is a rig that brings the rays of points nearer to each other that took no part in its
    refinement, every second group of neighbours, by more than chance would.

    Parameters
    ----------
    rig : Rig
    known : RigCovariance or None   None: cameras may have turned by half a degree and moved by 1 %
                                    of their distance from the first, their lenses not
    ties : Ties                     of all instants
    surface : KnownSurface or None  None: rays alone

    Returns
    -------
    Refined

    Raises
    ------
    CalibrationError                fewer than 60 points; a covariance of another rig
    """
    prior = _vague(rig) if known is None else known
    scale = _roots(prior.covariance)
    usable = np.isfinite(residuals(rig, ties)).all(axis=1)
    ties, count = ties.chosen(usable), len(usable)
    if usable.sum() < _FEWEST:
        raise CalibrationError(
            f"{int(usable.sum())} points of the object are seen by two cameras; {_FEWEST} are"
            " needed to refine a rig: give pictures of more instants, with a *, and see whether the"
            " object is textured and large in the pictures of two cameras"
        )
    label = compact_groups(places(rig, ties), GROUPS)
    half = label % 2 == 0
    trial = _fit(rig, prior, scale, ties.chosen(half), label[half], surface)
    held = ties.chosen(~half)
    before, after, gain = _left(rig, trial.rig, held, label[~half])
    if gain < _SIGNIFICANT:
        return Refined(rig, prior, False, int(usable.sum()), 0, before, after, "")
    whole = _fit(rig, prior, scale, ties, label, surface)
    value = calibration_numbers(whole.rig.cameras, prior.names)
    covariance = 0.5 * (whole.covariance + whole.covariance.T)
    return Refined(
        whole.rig, RigCovariance(prior.names, value, covariance, "refinement"), True,
        int(whole.good.sum()), count - int(whole.good.sum()), before, after,
        _moved_most(whole.step, prior),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A refined rig, the points that had a say, the step of its numbers and their covariance."""

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
    """Gauss-Newton's steps from a rig, in standard deviations of the prior."""
    count = scale.shape[1]
    # Steps of the rig; a turn and a shift of the object, and the size of its mesh.
    total, shared, step = np.zeros(count), 1.0, np.full(count, np.inf)
    body = None if surface is None else Body(surface, surface.pose, 0.0)
    for _ in range(_MAX_STEPS):
        here = moved_rig(rig, prior.names, scale @ total)
        residual = residuals(here, ties)
        good, noise = _good(residual, _freedom(ties))
        if np.abs(step).max() > _NEAR_STEP:
            slope, _ = slopes(here, prior, scale, ties)
        weight = good / (shared * noise**2)
        score = np.einsum("n,nr,nrk->nk", weight, residual, slope)
        # Without a surface the object stays where it is.
        matrix, right = np.eye(count + 7), np.zeros(count + 7)
        matrix[:count, :count] += np.einsum("n,nrk,nrl->kl", weight, slope, slope)
        right[:count] = -score.sum(axis=0) - total
        if body is not None:
            more, pull = body.equations(here, prior, scale)
            matrix[count:, count:] = 0.0
            matrix, right = matrix + more, right + pull
        change = np.linalg.solve(matrix, right)
        step = change[:count]
        total = total + step
        body = None if body is None else body.moved(here, change[count:])
        shared = max(shared_factor(score * np.sqrt(shared), label), 1.0)
        if np.abs(step).max() < _SMALL_STEP:
            break
    covariance = scale @ np.linalg.inv(matrix)[:count, :count] @ scale.T
    return _Fit(moved_rig(rig, prior.names, scale @ total), good, scale @ total, covariance)


def _freedom(ties: Ties) -> PointScalars:
    """Coordinates seen less those of the point itself."""
    return 2.0 * np.isfinite(ties.pixels).all(axis=2).sum(axis=0) - 3.0


def _good(
    residual: Float[np.ndarray, "n r"], freedom: PointScalars
) -> tuple[Bool[np.ndarray, " n"], float]:
    """Points that are no gross errors, and the noise over the one claimed, both from medians."""
    # Quantiles of chi-squared; scipy.stats has them too, and takes most of a second to import.
    square = (residual**2).sum(axis=1)
    noise = float(np.sqrt(np.median(square / chdtri(freedom, 0.5))))
    noise = max(noise, 1e-9)
    return square < noise**2 * chdtri(freedom, _GROSS), noise


def _left(rig: Rig, other: Rig, ties: Ties, label: np.ndarray) -> tuple[float, float, float]:
    """Rms distances of the rays of points with two rigs [px]; and the gain in standard errors.

    Gross errors of the second are left out of both; groups of neighbours vary together.
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


def _roots(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p k"]:
    """Independent steps of a standard deviation each, those of none left out."""
    size = np.sqrt(np.diag(covariance))
    free = size > 0.0
    unit = covariance[np.ix_(free, free)] / np.outer(size[free], size[free])
    value, vector = np.linalg.eigh(unit)
    keep = value > 1e-12 * value[-1]
    roots = np.zeros((len(size), int(keep.sum())))
    roots[free] = size[free, None] * vector[:, keep] * np.sqrt(value[keep])
    return roots


def _vague(rig: Rig) -> RigCovariance:
    """What is believed of a rig whose covariance nobody has: lenses are right, poses nearly."""
    terms = ("rx", "ry", "rz", "tx", "ty", "tz")
    first = rig.cameras[rig.reference]
    names = [f"{first.name}.fx"]
    sigma = [0.0]
    back = np.linalg.inv(first.T_camera_object)
    for camera in rig.cameras:
        if camera is first:
            continue
        away = float(np.linalg.norm((camera.T_camera_object @ back)[:3, 3]))
        names += [f"{camera.name}.{term}" for term in terms]
        sigma += [_TURN] * 3 + [_SHIFT * away] * 3
    value = calibration_numbers(rig.cameras, names)
    return RigCovariance(tuple(names), value, np.diag(np.square(sigma)), rig.source)


def _moved_most(step: Float[np.ndarray, " p"], prior: RigCovariance) -> str:
    """The number whose change surprises most, in words."""
    sigma = np.sqrt(np.diag(prior.covariance))
    unit = np.divide(step, sigma, out=np.zeros_like(step), where=sigma > 0.0)
    worst = int(np.abs(unit).argmax())
    return f"{prior.names[worst]} by {unit[worst]:+.1f} of its standard deviations"
