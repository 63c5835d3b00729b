"""Acceptance or rejection of matched points, and the covariance of their displacements."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.vision.cameras.projection import pixel_sizes, project_jacobian
from palpate.vision.images.normalisation import moments
from palpate.vision.images.spline import slope_gain, smoothing_gain
from palpate.vision.joint.match import (
    changed_cameras,
    mean_over,
    neighbourhood,
    predicted_motion,
    used_cameras,
)
from palpate.vision.matching.outliers import median_around
from palpate.vision.range_flow.flow import Outcome, RangeFlow
from palpate.vision.refinement.scene import Scene
from palpate.vision.refinement.window_match import BLOCKS, Match

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
    used = used_cameras(match)
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
        reprojection=np.sqrt(mean_over((match.own_step**2).sum(axis=2), used)),
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
    some = used & (count >= 2) & (match.outcome == Outcome.VALID)[:, None]
    if not some.any():
        return _MATCHING_BIAS_PX
    # Of the 2 count residual components, the common displacement takes up three.
    fraction = np.broadcast_to(1.0 - 1.5 / np.maximum(count, 2), used.shape)
    square = (match.own_step**2).mean(axis=2)[some] / fraction[some]
    # Variance from the median of chi-squared with two degrees of freedom, minus that of the noise.
    extra = np.median(square) / np.log(2.0) - np.median(match.own_variance[some])
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
    changed = changed_cameras(match, noise).any(axis=1)
    outcome[(outcome == Outcome.VALID) & changed] = Outcome.SCORE
    used = used_cameras(match)
    limit = _MAX_DISAGREEMENT * np.sqrt(match.own_variance + bias_px**2)
    with np.errstate(invalid="ignore"):
        contradicting = (used & (np.abs(match.own_step).max(axis=2) > limit)).any(axis=1)
        outcome[(outcome == Outcome.VALID) & contradicting] = Outcome.REPROJECTION
        blurred = _lateral(scene, by_noise) > _MAX_NOISE_PX * _pixel_sizes(scene)
        outcome[(outcome == Outcome.VALID) & blurred] = Outcome.TEXTURE
        ok = outcome == Outcome.VALID
        around = predicted_motion(scene, match, ok)
        distance = np.linalg.norm(match.motion[:, 0] - around.displacement, axis=1)
        sigma = np.sqrt(np.trace(by_noise, axis1=1, axis2=2))
        isolated = distance > _MAX_DISAGREEMENT * np.hypot(around.scatter, sigma)
    outcome[ok & isolated] = Outcome.NEIGHBOURS
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
    found = match.outcome == Outcome.VALID
    # The estimate from a single window is noisy: it rests on about 27 blocks.
    inflation = median_around(scene.point, match.variance_ratio, found, reach=neighbourhood(scene))
    return np.asarray(np.maximum(inflation, 1.0) / _fraction_in_blocks(scene))


def _gradient_noise_inflation(scene: Scene, noise: float) -> Float[np.ndarray, " n"]:
    """Inflation of the variance because the first picture's gradients carry noise, at least 1.

    Noise adds to the squared gradients g^2 of the normal matrix, but the residuals depend on the
    displacement through the true gradients only: for the share p = (g^2 - noise) / g^2 of these the
    variance is 1 / p^2 times the one that the normal matrix says.

    Source: Fuller, Measurement Error Models (1987), section 1.2, with p the reliability ratio.
    """
    picture = scene.pictures[scene.rig.reference]
    square = picture.along_column**2 + picture.along_row**2
    column, row = scene.pixel.astype(np.int64).T
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
    grey = scene.pictures[scene.rig.reference].grey.astype(np.float64)
    column, row = scene.pixel.astype(np.int64).T
    return np.sqrt(moments(grey, scene.subset)[1])[row, column]


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
