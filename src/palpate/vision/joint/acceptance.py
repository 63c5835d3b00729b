"""Which points of a match are believed, and how well their displacement is known."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.vision.cameras import pixel_sizes, project_jacobian
from palpate.vision.images import moments, smoothing_gain
from palpate.vision.joint.match import (
    changed_cameras,
    mean_over,
    neighbourhood,
    predicted_motion,
    used_cameras,
)
from palpate.vision.joint.refinement import BLOCKS, Match
from palpate.vision.joint.scene import Scene
from palpate.vision.matching import median_around
from palpate.vision.range_flow import Outcome, RangeFlow

# A displacement that noise leaves no better known than this is not known; the usual match is ten
# times better [px]. A rig that is a little wrong has nothing to do with the texture.
_MAX_NOISE_PX = 0.1
# A window's contrast in units of the noise; with less, noise is a tenth of the gradients that it is
# matched by, and more.
_MIN_CONTRAST = 3.0
# A point is dropped where the cameras or the neighbours contradict it by more than this many
# standard deviations.
_MAX_DISAGREEMENT = 5.0
# Systematic error of one camera's match that no residual shows (interpolation, response of the
# pixels), part of every covariance; at least so much beside what covers or shadows the surface.
_MATCHING_BIAS_PX = 0.002
_BIAS_BESIDE_CHANGE_PX = 0.006
# Derivatives that a window takes from its neighbours bring their noise along: variance of its
# motion over that of a window whose derivatives are known (benchmarks/flow_sigma.py).
_CARRIED_NOISE = 1.44


def accepted_flow(scene: Scene, match: Match, noise: Float[np.ndarray, " c"]) -> RangeFlow:
    """Range flow with every point accepted or rejected for one reason.

    Parameters
    ----------
    scene : Scene
    match : Match
    noise : (c,) float [grey levels]    standard deviation that a match leaves in each camera

    Returns
    -------
    RangeFlow
    """
    used = used_cameras(match)
    rough = _roughness(scene, match)
    match = match._replace(own_variance=match.own_variance * rough[:, None])
    by_noise = match.covariance * (_CARRIED_NOISE * rough)[:, None, None]
    bias_px = _matching_bias(match, used)
    outcome = _outcome(scene, match, by_noise, noise, bias_px)
    beside = np.where(_beside_change(scene, outcome), _BIAS_BESIDE_CHANGE_PX, 0.0)
    bias = _bias_covariance(scene, match.use, np.maximum(bias_px, beside))
    covariance = by_noise + bias
    valid = outcome == Outcome.VALID
    score = np.where(used, match.score, np.inf).min(axis=1)
    return RangeFlow(
        pixel=scene.pixel,
        point=scene.point,
        tangent=scene.tangent,
        displacement=np.where(valid[:, None], match.motion[:, 0], np.nan),
        gradient=np.where(
            valid[:, None, None], match.motion[:, 1:3] / scene.extent[:, None, None], np.nan
        ),
        covariance=np.where(valid[:, None, None], covariance, np.nan),
        bias=np.where(valid[:, None, None], bias, np.nan),
        score=np.where(np.isfinite(score), score, np.nan),
        reprojection=np.sqrt(mean_over((match.own**2).sum(axis=2), used)),
        cameras=np.where(valid, used.sum(axis=1), 0),
        outcome=outcome.astype(np.int64),
        through_last=np.zeros(len(outcome), dtype=bool),
        drift=np.nan,
        noise=noise / (np.sqrt(2.0) * smoothing_gain(scene.smoothing)),
        subset=scene.subset,
        step=scene.step,
        shape=scene.pictures[scene.rig.reference].grey.shape,
    )


def _matching_bias(match: Match, used: Bool[np.ndarray, "n c"]) -> float:
    """Systematic error of one camera's match [px]: the usual, or more where the cameras show more.

    A rig that is a little wrong makes the cameras contradict each other everywhere, by more than
    noise does. That is no reason to reject a point, and it is part of every point's error.
    """
    count = used.sum(axis=1, keepdims=True)
    some = used & (count >= 2) & (match.outcome == Outcome.VALID)[:, None]
    if not some.any():
        return _MATCHING_BIAS_PX
    # Of two components a camera, three in all are taken up by the common displacement.
    share = np.broadcast_to(1.0 - 1.5 / np.maximum(count, 2), used.shape)
    square = (match.own**2).mean(axis=2)[some] / share[some]
    # Median of a chi square of two, less what noise explains.
    extra = np.median(square) / np.log(2.0) - np.median(match.own_variance[some])
    return float(max(_MATCHING_BIAS_PX, np.sqrt(max(extra, 0.0))))


def _outcome(
    scene: Scene,
    match: Match,
    by_noise: Float[np.ndarray, "n 3 3"],
    noise: Float[np.ndarray, " c"],
    bias_px: float,
) -> Int[np.ndarray, " n"]:
    """What became of each point; the first reason that applies."""
    outcome = match.outcome.copy()
    poor = _contrast(scene) < _MIN_CONTRAST * noise[scene.rig.reference] / np.sqrt(2.0)
    outcome[poor & (outcome != Outcome.HIDDEN)] = Outcome.TEXTURE
    changed = changed_cameras(match, noise).any(axis=1)
    outcome[(outcome == Outcome.VALID) & changed] = Outcome.SCORE
    used = used_cameras(match)
    limit = _MAX_DISAGREEMENT * np.sqrt(match.own_variance + bias_px**2)
    with np.errstate(invalid="ignore"):
        apart = (used & (np.abs(match.own).max(axis=2) > limit)).any(axis=1)
        outcome[(outcome == Outcome.VALID) & apart] = Outcome.REPROJECTION
        blurred = _lateral(scene, by_noise) > _MAX_NOISE_PX * _pixel_sizes(scene)
        outcome[(outcome == Outcome.VALID) & blurred] = Outcome.TEXTURE
        ok = outcome == Outcome.VALID
        around = predicted_motion(scene, match, ok)
        away = np.linalg.norm(match.motion[:, 0] - around.displacement, axis=1)
        sigma = np.sqrt(np.trace(by_noise, axis1=1, axis2=2))
        alone = away > _MAX_DISAGREEMENT * np.hypot(around.scatter, sigma)
    outcome[ok & alone] = Outcome.NEIGHBOURS
    return outcome


def _beside_change(scene: Scene, outcome: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Points within half a window of one whose window changed or was lost.

    What covers a window, or the shadow in it, reaches into theirs, too, by too little to show in
    what their match leaves, and their second derivatives come from one side alone. Beside a tool
    that moves all points of its rim alike, toward it, and Poisson's ratio with them.
    """
    changed = np.isin(outcome, (Outcome.SCORE, Outcome.LOST))
    if not changed.any():
        return changed
    away, _ = cKDTree(scene.pixel[changed]).query(scene.pixel)
    return np.asarray(away <= scene.subset / 2)


def _pixel_sizes(scene: Scene) -> Float[np.ndarray, " n"]:
    """Side of the reference camera's pixel at each point [m]."""
    return pixel_sizes(scene.rig.cameras[scene.rig.reference], scene.point)


def _roughness(scene: Scene, match: Match) -> Float[np.ndarray, " n"]:
    """Variance of a motion from what the match leaves over that from white noise, at least 1."""
    found = match.outcome == Outcome.VALID
    # One window's estimate of its roughness is itself rough: 27 blocks.
    rough = median_around(scene.point, match.rough, found, reach=neighbourhood(scene))
    return np.asarray(np.maximum(rough, 1.0) / _share_in_blocks(scene))


def _share_in_blocks(scene: Scene) -> float:
    """How much of smoothed noise's roughness the blocks of a window catch (`window_blocks_kernel`).

    The low-pass makes neighbouring pixels' noise alike, with the correlation exp(-(d / 2 s)^2); of
    the pairs that are alike some lie on both sides of a block's edge.
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
    """Standard deviation across the reference camera's axis, the worse direction of two [m]."""
    turn = scene.rig.cameras[scene.rig.reference].T_camera_object[:2, :3]
    across = np.einsum("ai,nij,bj->nab", turn, covariance, turn)
    return np.sqrt(np.maximum(across[:, 0, 0], across[:, 1, 1]))


def _bias_covariance(
    scene: Scene, use: Bool[np.ndarray, "n c"], bias: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3 3"]:
    """Covariance of the displacement if every camera's match were off by `bias` pixels.

    Half of the errors differ from camera to camera; the other half are the same in all of them, for
    cameras that look the same way see the same fraction of a pixel, and move the point sideways.
    """
    slope = np.stack([project_jacobian(c, scene.point)[1] for c in scene.rig.cameras])
    information = np.einsum("nc,cnai,cnaj->nij", use.astype(np.float64), slope, slope)
    few = use.sum(axis=1) < 2
    information[few] = np.eye(3)
    pose = scene.rig.cameras[scene.rig.reference].T_camera_object
    ray = scene.point + pose[:3, :3].T @ pose[:3, 3]
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    sideways = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    common = _pixel_sizes(scene)[:, None, None] ** 2 * sideways
    covariance = bias[:, None, None] ** 2 * (np.linalg.inv(information) + common)
    covariance[few] = np.nan
    return covariance
