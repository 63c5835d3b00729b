"""Tracking the points of a scene into later pictures: a robust joint match of all cameras.

The steps are a joint refinement from a start; dropping of cameras whose window has changed; second
attempts at lost points from their neighbours' motion; and a final refinement with derivatives of
the motion from the neighbours, which avoids bias where the surface bends and keeps the noise low.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.vision.cameras.projection import pixel_sizes
from palpate.vision.images.spline import SplinePicture
from palpate.vision.matching.local_regression import LocalField, local_field
from palpate.vision.matching.outliers import Prediction, predicted
from palpate.vision.matching.scatter import Scatter, sum_variance
from palpate.vision.matching.window_sums import BASES
from palpate.vision.range_flow.flow import Outcome
from palpate.vision.refinement.refinement import refine_joint
from palpate.vision.refinement.scene import Scene
from palpate.vision.refinement.window_match import Limits, Match

# Rounds of second attempts: in each, the front of found points advances by a few windows.
_RETRIES = 2
# A second attempt has a good start or is hopeless: twice the steps of a usual match.
_RETRY_ITERATIONS = 10
# Radius of the neighbourhood in half windows: the windows overlap but do not coincide.
BEND_REACH = 2.0
# A camera, and then the point, is dropped where the rms residual of its match exceeds this many
# times the usual one.
_MAX_EXCESS = 2.0


def match_scene(
    scene: Scene,
    moved: Sequence[SplinePicture],
    start: Float[np.ndarray, "n 6 3"],
    *,
    shape: str,
) -> tuple[Match, Float[np.ndarray, " c"]]:
    """Track all points of a scene into later pictures.

    Parameters
    ----------
    scene : Scene
    moved : sequence of c SplinePicture
    start : (n, 6, 3) float [m]         initial motion; NaN where there is none
    shape : "shift", "affine" or "quadratic"    shape function of the final refinement; the higher
                                        derivatives are taken from the neighbours

    Returns
    -------
    match : Match
    noise : (c,) float [grey levels]    typical standard deviation of the residual in each camera
    """
    every = np.arange(len(scene.point))
    limits = Limits(scene.subset // 2)
    quick = limits._replace(iterations=_RETRY_ITERATIONS)
    noise = np.ones(len(moved))
    match = _refined(scene, every, moved, start, scene.seen, noise, limits)
    noise = _noise(match)
    match = _without_one_camera(scene, every, moved, match, start, noise, quick)
    for _ in range(_RETRIES):
        again, restart = _second_tries(scene, match, noise)
        if len(again) == 0:
            break
        tried = _refined(scene, again, moved, restart, scene.seen[again], noise, quick)
        tried = _without_one_camera(scene, again, moved, tried, restart, noise, quick)
        match = _replaced(match, tried, again)
    known, inflation = _with_derivatives(scene, match)
    rows = np.flatnonzero(np.isfinite(known).all(axis=(1, 2)))
    final = limits._replace(bases=BASES[shape])
    last = _refined(scene, rows, moved, known[rows], match.cameras[rows], noise, final)
    if final.bases < BASES["quadratic"]:
        last = last._replace(covariance=last.covariance * inflation[rows, None, None])
    match = _replaced(match, last, rows)
    return match, _noise(match)


def _refined(
    scene: Scene,
    rows: Int[np.ndarray, " k"],
    moved: Sequence[SplinePicture],
    start: Float[np.ndarray, "k 6 3"],
    cameras: Bool[np.ndarray, "k c"],
    noise: Float[np.ndarray, " c"],
    limits: Limits,
) -> Match:
    """The refinement, with covariances scaled by each match's own residual variance."""
    found = refine_joint(scene, rows, moved, start, cameras, noise, limits)
    # `noise` is that of the whole picture; a window with a larger residual is less certain.
    return found._replace(covariance=found.covariance * _excess(found, noise)[:, None, None])


def used_cameras(match: Match) -> Bool[np.ndarray, "n c"]:
    """True for cameras that were used in a match and found the window.

    Parameters
    ----------
    match : Match                   of n points in c cameras

    Returns
    -------
    (n, c) bool
    """
    return match.cameras & np.isfinite(match.residual_variance)


def mean_over(
    value: Float[np.ndarray, "n c"], used: Bool[np.ndarray, "n c"]
) -> Float[np.ndarray, " n"]:
    """Mean of a quantity over the cameras that were used.

    Parameters
    ----------
    value : (n, c) float            of any unit; NaN where not used
    used : (n, c) bool

    Returns
    -------
    (n,) float                      NaN where no camera is used
    """
    total = np.where(used, value, 0.0).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / used.sum(axis=1)


def _excess(match: Match, noise: Float[np.ndarray, " c"]) -> Float[np.ndarray, " n"]:
    """Ratio of each match's residual variance to that of the noise, averaged over its cameras."""
    return mean_over(match.residual_variance / noise**2, used_cameras(match))


def _noise(match: Match) -> Float[np.ndarray, " c"]:
    """Residual standard deviation in each camera, from the median over points [grey levels]."""
    found = match.outcome == Outcome.VALID
    noise = np.ones(match.residual_variance.shape[1])
    for c in range(len(noise)):
        residuals = match.residual_variance[found & np.isfinite(match.residual_variance[:, c]), c]
        if len(residuals) > 0:
            # At least the rounding noise of two pictures in whole grey levels.
            noise[c] = np.sqrt(max(float(np.median(residuals)), 1.0 / 6.0))
    return noise


def changed_cameras(match: Match, noise: Float[np.ndarray, " c"]) -> Bool[np.ndarray, "n c"]:
    """Cameras whose window looks different under load: covered, shadowed, a highlight.

    Parameters
    ----------
    match : Match                   of n points in c cameras
    noise : (c,) float [grey levels]    typical standard deviation of the residual

    Returns
    -------
    (n, c) bool                     True where the rms residual exceeds twice the noise
    """
    with np.errstate(invalid="ignore"):
        return match.cameras & (match.residual_variance > (_MAX_EXCESS * noise) ** 2)


def _fits(match: Match, noise: Float[np.ndarray, " c"]) -> Bool[np.ndarray, " n"]:
    """Points that were found and whose windows are unchanged in all cameras."""
    return (match.outcome == Outcome.VALID) & ~changed_cameras(match, noise).any(axis=1)


def _without_one_camera(
    scene: Scene,
    rows: Int[np.ndarray, " n"],
    moved: Sequence[SplinePicture],
    match: Match,
    start: Float[np.ndarray, "n 6 3"],
    noise: Float[np.ndarray, " c"],
    limits: Limits,
) -> Match:
    """Rematch points that do not fit, leaving out each camera in turn if two or more remain.

    A camera whose view is covered biases the common motion until no camera fits, so its residual
    alone does not identify it; the others fit once it is left out.
    """
    all_cameras = match.cameras
    again = np.flatnonzero(~_fits(match, noise) & (all_cameras.sum(axis=1) >= 3))
    best = np.full(len(all_cameras), np.inf)
    for c in range(all_cameras.shape[1]):
        some = again[all_cameras[again, c]]
        if len(some) == 0:
            continue
        cameras = all_cameras[some].copy()
        cameras[:, c] = False
        tried = _refined(scene, rows[some], moved, start[some], cameras, noise, limits)
        excess = _excess(tried, noise)
        with np.errstate(invalid="ignore"):
            better = _fits(tried, noise) & (excess < best[some])
        best[some[better]] = excess[better]
        match = _replaced(match, tried._replace(outcome=np.where(better, 0, Outcome.LOST)), some)
    return match


def _replaced(match: Match, other: Match, rows: Int[np.ndarray, " k"]) -> Match:
    """Replace rows of a match by those that another match found."""
    good = other.outcome == Outcome.VALID
    result = Match(*(array.copy() for array in match))
    for array, new in zip(result, other, strict=True):
        array[rows[good]] = new[good]
    return result


def _second_tries(
    scene: Scene, match: Match, noise: Float[np.ndarray, " c"]
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 6 3"]]:
    """Points that were lost or fit badly, and starts from their neighbours' motion."""
    fits = _fits(match, noise)
    guess = predicted_motion(scene, match, fits)
    may = np.isin(match.outcome, (Outcome.LOST, Outcome.VALID, Outcome.OUTSIDE))
    known = np.isfinite(guess.displacement).all(axis=1)
    size = pixel_sizes(scene.rig.cameras[scene.rig.reference], scene.point)
    with np.errstate(invalid="ignore"):
        distance = np.linalg.norm(match.motion[:, 0] - guess.displacement, axis=1)
        far = ~(distance < size)
    rows = np.flatnonzero(may & ~fits & known & far)
    restart = np.zeros((len(rows), 6, 3))
    restart[:, 0] = guess.displacement[rows]
    restart[:, 1:3] = guess.gradient[rows] * scene.half_window[rows, None, None]
    return rows, restart


def predicted_motion(scene: Scene, match: Match, valid: Bool[np.ndarray, " n"]) -> Prediction:
    """Motion of each point as predicted by its valid neighbours; see `predicted`.

    Parameters
    ----------
    scene : Scene                   of n points
    match : Match                   of the same points
    valid : (n,) bool               points used for prediction

    Returns
    -------
    Prediction                      NaN where fewer than three neighbours are valid
    """
    gradient = match.motion[:, 1:3] / scene.half_window[:, None, None]
    return predicted(
        scene.point,
        scene.tangent,
        match.motion[:, 0],
        gradient,
        valid,
        reach=neighbourhood(scene),
    )


def _with_derivatives(
    scene: Scene, match: Match
) -> tuple[Float[np.ndarray, "n 6 3"], Float[np.ndarray, " n"]]:
    """The motion found, with derivatives from a local field, and the `_inflation` by their noise;
    NaN where undetermined."""
    good = match.outcome == Outcome.VALID
    motion, inflation = np.full(match.motion.shape, np.nan), np.full(len(good), np.nan)
    if not good.any():
        return motion, inflation
    scatter = Scatter(
        scene.point[good],
        scene.pixel[good],
        match.motion[good, 0],
        match.covariance[good],
        np.zeros((int(good.sum()), 3, 3)),
        scene.subset,
    )
    field = local_field(scatter, scatter.point, scene.tangent[good], reach=neighbourhood(scene))
    size = scene.half_window[good]
    motion[good, 0] = scatter.displacement
    motion[good, 1:3] = field.gradient * size[:, None, None]
    motion[good, 3:] = field.curvature * size[:, None, None] ** 2
    inflation[good] = _inflation(scatter, field, size)
    return motion, inflation


def _inflation(
    scatter: Scatter, field: LocalField, half_window: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Variance of the displacements of windows whose second derivatives are the neighbours', over
    that with known ones.

    A second derivative moves a window's mean by half its second moment, half_window^2 / 3. First
    derivatives do not: the mean of their coordinates is zero.
    """
    own = field.nearest == np.arange(len(half_window))[:, None]
    weight = own - (half_window**2 / 3.0)[:, None] * field.bend
    variance = np.trace(scatter.covariance, axis1=1, axis2=2)
    return sum_variance(scatter, field.nearest, weight) / variance


def neighbourhood(scene: Scene) -> float:
    """Radius of the neighbourhood of a point [m]; 1 for a scene without points."""
    return BEND_REACH * float(np.median(scene.half_window)) if len(scene.half_window) else 1.0
