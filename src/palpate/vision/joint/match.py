"""Tracking the points of a scene into later pictures: a robust joint match of all cameras.

The steps are a joint refinement from a start; dropping of cameras whose window has changed; second
attempts at lost points from their neighbours' motion; a final refinement with derivatives of the
motion from the neighbours, which avoids bias where the surface bends and keeps the noise low; and
acceptance or rejection of every point, with the covariance of its displacement.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.vision.matching.local_regression import LocalField, Scatter, local_field, sum_variance
from palpate.vision.matching.outliers import Prediction, median_around, predicted
from palpate.vision.matching.refinement import refine_joint
from palpate.vision.matching.scene import BLOCKS, Limits, Match, Scene
from palpate.vision.matching.window import BASES
from palpate.vision.normalisation import moments
from palpate.vision.projection import pixel_sizes, project_jacobian
from palpate.vision.range_flow import Outcome, RangeFlow
from palpate.vision.spline import SplinePicture, slope_gain, smoothing_gain

# Steps shorter than this end a match that the final one goes on from [px]. Displacements change by
# 0.01 to 0.04 of their standard deviations; a third of the time in windows is saved.
_FIRST = 0.1
# Rounds of second attempts: in each, the front of found points advances by a few windows.
_RETRIES = 2
# A second attempt has a good start or is hopeless: twice the steps of a usual match.
_RETRY_ITERATIONS = 10
# Radius of the neighbourhood in half windows: the windows overlap but do not coincide.
BEND_REACH = 2.0
# A camera, and then the point, is dropped where the rms residual of its match exceeds this many
# times the usual one.
_MAX_EXCESS = 2.0
# Largest standard deviation by noise [px]; a usual match is ten times better. Bias is not included,
# because errors of the rig have nothing to do with the texture.
_MAX_NOISE_PX = 0.1
# Minimum contrast of a window in units of noise; with less, noise makes up a tenth or more of the
# gradients.
_MIN_CONTRAST = 3.0
# Smallest share of a window's squared gradients that is taken to be texture; with less it is
# rejected anyway.
_MIN_RELIABILITY = 0.1
# A point is rejected if the cameras or its neighbours contradict it by more than this many standard
# deviations.
_MAX_DISAGREEMENT = 5.0
# Systematic error of one camera's match that does not show in residuals (interpolation, pixel
# response), part of every covariance; and its minimum beside occlusions and shadows.
_MATCHING_BIAS_PX = 0.002
_BIAS_BESIDE_CHANGE_PX = 0.006


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
    first = limits._replace(tolerance=_FIRST)
    quick = first._replace(iterations=_RETRY_ITERATIONS)
    noise = np.ones(len(moved))
    match = _refined(scene, every, moved, start, scene.seen, noise, first)
    noise = _noise(match)
    match = _without_one_camera(scene, every, moved, match, start, noise, quick)
    fits = _fits(match, noise)
    for _ in range(_RETRIES):
        again, restart = _second_tries(scene, match, fits)
        if len(again) == 0:
            break
        tried = _refined(scene, again, moved, restart, scene.seen[again], noise, quick)
        tried = _without_one_camera(scene, again, moved, tried, restart, noise, quick)
        match = _replaced(match, tried, again)
        before, fits = fits, _fits(match, noise)
        # Neighbours would say the same again.
        if np.array_equal(fits, before):
            break
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
    matches = refine_joint(scene, rows, moved, start, cameras, noise, limits)
    # `noise` is that of the whole picture; a window with a larger residual is less certain.
    return matches._replace(covariance=matches.covariance * _excess(matches, noise)[:, None, None])


def _used_cameras(match: Match) -> Bool[np.ndarray, "n c"]:
    """True for cameras that were used in a match and found the window.

    Parameters
    ----------
    match : Match                   of n points in c cameras

    Returns
    -------
    (n, c) bool
    """
    return match.cameras & np.isfinite(match.residual_variance)


def _mean_over(
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
    return _mean_over(match.residual_variance / noise**2, _used_cameras(match))


def _noise(match: Match) -> Float[np.ndarray, " c"]:
    """Residual standard deviation in each camera, from the median over points [grey levels]."""
    valid = match.outcome == Outcome.VALID
    noise = np.ones(match.residual_variance.shape[1])
    for c in range(len(noise)):
        residuals = match.residual_variance[valid & np.isfinite(match.residual_variance[:, c]), c]
        if len(residuals) > 0:
            # At least the rounding noise of two pictures in whole grey levels.
            noise[c] = np.sqrt(max(float(np.median(residuals)), 1.0 / 6.0))
    return noise


def _changed_cameras(match: Match, noise: Float[np.ndarray, " c"]) -> Bool[np.ndarray, "n c"]:
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
    return (match.outcome == Outcome.VALID) & ~_changed_cameras(match, noise).any(axis=1)


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
        affected = again[all_cameras[again, c]]
        if len(affected) == 0:
            continue
        cameras = all_cameras[affected].copy()
        cameras[:, c] = False
        tried = _refined(scene, rows[affected], moved, start[affected], cameras, noise, limits)
        excess = _excess(tried, noise)
        with np.errstate(invalid="ignore"):
            better = _fits(tried, noise) & (excess < best[affected])
        best[affected[better]] = excess[better]
        match = _replaced(
            match, tried._replace(outcome=np.where(better, 0, Outcome.LOST)), affected
        )
    return match


def _replaced(match: Match, other: Match, rows: Int[np.ndarray, " k"]) -> Match:
    """Replace rows of a match by those that another match found."""
    good = other.outcome == Outcome.VALID
    result = Match(*(array.copy() for array in match))
    for array, new in zip(result, other, strict=True):
        array[rows[good]] = new[good]
    return result


def _second_tries(
    scene: Scene, match: Match, fits: Bool[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 6 3"]]:
    """Points that were lost or fit badly, and starts from their neighbours' motion."""
    may = np.isin(match.outcome, (Outcome.LOST, Outcome.VALID, Outcome.OUTSIDE))
    rows = np.flatnonzero(may & ~fits)
    guess = _predicted_motion(scene, match, fits, rows)
    known = np.isfinite(guess.displacement).all(axis=1)
    size = pixel_sizes(scene.rig.cameras[scene.rig.reference], scene.point[rows])
    with np.errstate(invalid="ignore"):
        distance = np.linalg.norm(match.motion[rows, 0] - guess.displacement, axis=1)
        chosen = known & ~(distance < size)
    rows = rows[chosen]
    restart = np.zeros((len(rows), 6, 3))
    restart[:, 0] = guess.displacement[chosen]
    restart[:, 1:3] = guess.gradient[chosen] * scene.half_window[rows, None, None]
    return rows, restart


def _predicted_motion(
    scene: Scene, match: Match, valid: Bool[np.ndarray, " n"], rows: Int[np.ndarray, " k"]
) -> Prediction:
    """Motion of some points as predicted by their valid neighbours; see `predicted`.

    Parameters
    ----------
    scene : Scene                   of n points
    match : Match                   of the same points
    valid : (n,) bool               points used for prediction
    rows : (k,) int                 points whose motion is predicted

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
        rows,
        reach=_neighbourhood(scene),
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
    field = local_field(scatter, scatter.point, scene.tangent[good], reach=_neighbourhood(scene))
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
    is_self = field.nearest == np.arange(len(half_window))[:, None]
    weight = is_self - (half_window**2 / 3.0)[:, None] * field.bend
    variance = np.trace(scatter.covariance, axis1=1, axis2=2)
    return sum_variance(scatter, field.nearest, weight) / variance


def _neighbourhood(scene: Scene) -> float:
    """Radius of the neighbourhood of a point [m]; 1 for a scene without points."""
    return BEND_REACH * float(np.median(scene.half_window)) if len(scene.half_window) else 1.0


def accepted_flow(scene: Scene, match: Match, noise: Float[np.ndarray, " c"]) -> RangeFlow:
    """Range flow with every point accepted or rejected for one reason.

    Parameters
    ----------
    scene : Scene
    match : Match
    noise : (c,) float [grey levels]    typical standard deviation of the residual in each camera

    Returns
    -------
    RangeFlow
    """
    used = _used_cameras(match)
    raw_noise = noise / (np.sqrt(2.0) * smoothing_gain(scene.smoothing))
    inflation = _variance_inflation(scene, match)
    inflation *= _gradient_noise_inflation(scene, raw_noise[scene.rig.reference])
    match = match._replace(own_variance=match.own_variance * inflation[:, None])
    by_noise = match.covariance * inflation[:, None, None]
    bias_px = _matching_bias(match, used)
    outcome = _outcome(scene, match, by_noise, noise, bias_px)
    beside = np.where(_beside_change(scene, outcome), _BIAS_BESIDE_CHANGE_PX, 0.0)
    bias = _bias_covariance(scene, match.cameras, np.maximum(bias_px, beside))
    covariance = by_noise + bias
    valid = outcome == Outcome.VALID
    score = np.where(used, match.score, np.inf).min(axis=1)
    return RangeFlow(
        pixel=scene.pixel,
        point=scene.point,
        tangent=scene.tangent,
        displacement=np.where(valid[:, None], match.motion[:, 0], np.nan),
        gradient=np.where(
            valid[:, None, None], match.motion[:, 1:3] / scene.half_window[:, None, None], np.nan
        ),
        covariance=np.where(valid[:, None, None], covariance, np.nan),
        bias=np.where(valid[:, None, None], bias, np.nan),
        score=np.where(np.isfinite(score), score, np.nan),
        reprojection=np.sqrt(_mean_over((match.own_step**2).sum(axis=2), used)),
        cameras=np.where(valid, used.sum(axis=1), 0),
        outcome=outcome.astype(np.int64),
        through_last=np.zeros(len(outcome), dtype=bool),
        drift=np.nan,
        noise=raw_noise,
        subset=scene.subset,
        step=scene.step,
        shape=scene.pictures[scene.rig.reference].grey.shape,
    )


def _matching_bias(match: Match, used: Bool[np.ndarray, "n c"]) -> float:
    """Systematic error of one camera's match [px]: the default, or more if the cameras disagree.

    A slightly wrong rig makes the cameras contradict each other everywhere by more than noise. That
    does not reject points, but is part of every point's error.
    """
    count = used.sum(axis=1, keepdims=True)
    usable = used & (count >= 2) & (match.outcome == Outcome.VALID)[:, None]
    if not usable.any():
        return _MATCHING_BIAS_PX
    # Of the 2 count residual components, the common displacement takes up three.
    fraction = np.broadcast_to(1.0 - 1.5 / np.maximum(count, 2), used.shape)
    square = (match.own_step**2).mean(axis=2)[usable] / fraction[usable]
    # Variance from the median of chi-squared with two degrees of freedom, minus that of the noise.
    extra = np.median(square) / np.log(2.0) - np.median(match.own_variance[usable])
    return float(max(_MATCHING_BIAS_PX, np.sqrt(max(extra, 0.0))))


def _outcome(
    scene: Scene,
    match: Match,
    by_noise: Float[np.ndarray, "n 3 3"],
    noise: Float[np.ndarray, " c"],
    bias_px: float,
) -> Int[np.ndarray, " n"]:
    """Outcome of each point: the first reason for rejection that applies, or VALID."""
    outcome = match.outcome.copy()
    poor = _contrast(scene) < _MIN_CONTRAST * noise[scene.rig.reference] / np.sqrt(2.0)
    outcome[poor & (outcome != Outcome.HIDDEN)] = Outcome.TEXTURE
    changed = _changed_cameras(match, noise).any(axis=1)
    outcome[(outcome == Outcome.VALID) & changed] = Outcome.SCORE
    used = _used_cameras(match)
    limit = _MAX_DISAGREEMENT * np.sqrt(match.own_variance + bias_px**2)
    with np.errstate(invalid="ignore"):
        contradicting = (used & (np.abs(match.own_step).max(axis=2) > limit)).any(axis=1)
        outcome[(outcome == Outcome.VALID) & contradicting] = Outcome.REPROJECTION
        blurred = _lateral(scene, by_noise) > _MAX_NOISE_PX * _pixel_sizes(scene)
        outcome[(outcome == Outcome.VALID) & blurred] = Outcome.TEXTURE
        ok = outcome == Outcome.VALID
        rows = np.flatnonzero(ok)
        around = _predicted_motion(scene, match, ok, rows)
        distance = np.linalg.norm(match.motion[rows, 0] - around.displacement, axis=1)
        sigma = np.sqrt(np.trace(by_noise[rows], axis1=1, axis2=2))
        isolated = distance > _MAX_DISAGREEMENT * np.hypot(around.scatter, sigma)
    outcome[rows[isolated]] = Outcome.NEIGHBOURS
    return outcome


def _beside_change(scene: Scene, outcome: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Points within half a window of one whose window changed or was lost.

    An occlusion or shadow extends into their windows too, but too little to show in the residuals,
    and their second derivatives come from one side only. Around a tool this shifts all points at
    its edge alike, towards it, and so biases Poisson's ratio.
    """
    changed = np.isin(outcome, (Outcome.SCORE, Outcome.LOST))
    if not changed.any():
        return changed
    distance, _ = cKDTree(scene.pixel[changed]).query(scene.pixel)
    return np.asarray(distance <= scene.subset / 2)


def _pixel_sizes(scene: Scene) -> Float[np.ndarray, " n"]:
    """Side of the reference camera's pixels at each point [m]."""
    return pixel_sizes(scene.rig.cameras[scene.rig.reference], scene.point)


def _variance_inflation(scene: Scene, match: Match) -> Float[np.ndarray, " n"]:
    """Inflation of the variance by correlated residuals, relative to white noise.

    Median of `Match.variance_ratio` over the neighbourhood, at least 1, divided by
    `_fraction_in_blocks`.
    """
    valid = match.outcome == Outcome.VALID
    # The estimate from a single window is noisy: it rests on about 27 blocks.
    inflation = median_around(scene.point, match.variance_ratio, valid, reach=_neighbourhood(scene))
    return np.asarray(np.maximum(inflation, 1.0) / _fraction_in_blocks(scene))


def _gradient_noise_inflation(scene: Scene, noise: float) -> Float[np.ndarray, " n"]:
    """Inflation of the variance because the first picture's gradients carry noise, at least 1.

    Noise adds to the squared gradients g^2 of the normal matrix, but the residuals depend on the
    displacement through the true gradients only: for the share p = (g^2 - noise) / g^2 of these the
    variance is 1 / p^2 times the one that the normal matrix says.

    Source: Fuller, Measurement Error Models (1987), section 1.2, with p the reliability ratio.
    """
    picture = scene.pictures[scene.rig.reference]
    (row, column), shown = _around(scene)
    square = picture.along_column[shown] ** 2 + picture.along_row[shown] ** 2
    mean = moments(square, scene.subset)[0][row, column].astype(np.float64)
    true = mean - 2.0 * (slope_gain(scene.smoothing) * noise) ** 2
    return (mean / np.maximum(true, _MIN_RELIABILITY * mean)) ** 2


def _fraction_in_blocks(scene: Scene) -> float:
    """Fraction of the low-passed noise's covariance within blocks (`window_blocks_kernel`), 0 to 1.

    The low-pass correlates the noise of pixels at distance d by exp(-(d / 2 s)^2); pairs on either
    side of a block's edge are missed.
    """
    if scene.smoothing <= 0.0:
        return 1.0
    side = scene.subset / BLOCKS
    lag = np.arange(-int(side), int(side) + 1)
    alike = np.exp(-((lag / (2.0 * scene.smoothing)) ** 2))
    return float(((1.0 - np.abs(lag) / side) * alike).sum() / alike.sum()) ** 2


def _contrast(scene: Scene) -> Float[np.ndarray, " n"]:
    """Standard deviation of the reference camera's window around each point [grey levels]."""
    (row, column), shown = _around(scene)
    grey = scene.pictures[scene.rig.reference].grey[shown].astype(np.float64)
    return np.sqrt(moments(grey, scene.subset)[1])[row, column]


def _around(scene: Scene) -> tuple[Int[np.ndarray, "2 n"], tuple[slice, slice]]:
    """Rows and columns of the points within the part of the reference camera's picture that their
    windows cover, and that part."""
    place, shape = scene.pixel.astype(np.int64).T[::-1], scene.grey[scene.rig.reference].shape
    if place.size == 0:
        return place, (slice(None), slice(None))
    low = np.maximum(place.min(axis=1) - scene.subset, 0)
    row, column = zip(low, np.minimum(place.max(axis=1) + scene.subset + 1, shape), strict=True)
    return place - low[:, None], (slice(*row), slice(*column))


def _lateral(scene: Scene, covariance: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, " n"]:
    """Standard deviation across the reference camera's axis, the larger of two directions [m]."""
    turn = scene.rig.cameras[scene.rig.reference].T_camera_object[:2, :3]
    across = np.einsum("ai,nij,bj->nab", turn, covariance, turn)
    return np.sqrt(np.maximum(across[:, 0, 0], across[:, 1, 1]))


def _bias_covariance(
    scene: Scene, cameras: Bool[np.ndarray, "n c"], bias: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3 3"]:
    """Covariance of the displacement for a matching bias of `bias` pixels in every camera.

    It is the sum of two equal parts: one independent between the cameras, and one common to all,
    which shifts the point sideways; cameras with similar views see similar sub-pixel positions.
    """
    jacobian = np.stack([project_jacobian(c, scene.point)[1] for c in scene.rig.cameras])
    information = np.einsum("nc,cnai,cnaj->nij", cameras.astype(np.float64), jacobian, jacobian)
    too_few = cameras.sum(axis=1) < 2
    information[too_few] = np.eye(3)
    pose = scene.rig.cameras[scene.rig.reference].T_camera_object
    ray = scene.point + pose[:3, :3].T @ pose[:3, 3]
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    sideways = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    common = _pixel_sizes(scene)[:, None, None] ** 2 * sideways
    covariance = bias[:, None, None] ** 2 * (np.linalg.inv(information) + common)
    covariance[too_few] = np.nan
    return covariance
