"""Following the points of a scene into later pictures: one match of all cameras, made robust.

The joint refinement from a start; cameras whose window changed are dropped; points that were lost
are tried again from their neighbours' motion; and a last refinement takes derivatives of the motion
from the neighbours, so that a window sees no bias where the surface bends and little noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.vision.images import SplinePicture
from palpate.vision.joint.refinement import (
    CONVERGED,
    FEW_CAMERAS,
    LEFT,
    NO_TEXTURE,
    NOT_CONVERGED,
    First,
    Limits,
    Points,
    refine_joint,
)
from palpate.vision.joint.scene import Scene, pixel_size
from palpate.vision.joint.settings import JointSettings
from palpate.vision.matching import Scatter, local_field, predicted
from palpate.vision.range_flow import Outcome

_OUTCOMES = {
    CONVERGED: Outcome.VALID,
    FEW_CAMERAS: Outcome.HIDDEN,
    NO_TEXTURE: Outcome.TEXTURE,
    LEFT: Outcome.OUTSIDE,
    NOT_CONVERGED: Outcome.LOST,
}
# Rounds of second tries: the front of found points moves a few windows each.
_RETRIES = 2
# A second try starts from a good guess or is hopeless: twice the steps that a usual match takes.
_PATIENCE = 10
# Unknowns of a window for each component of the motion.
_BASES = {"shift": 1, "affine": 3, "quadratic": 6}
# Neighbours within this many half windows have a say; their windows overlap but are not the same.
AROUND = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Raw result of the joint refinement of n points.

    Attributes
    ----------
    motion : (n, 6, 3) float [m]        see `refine_joint`
    covariance : (n, 3, 3) float [m^2]
    score, left, own_variance : (n, c)
    own : (n, c, 2) float [px]
    rough : (n,) float [-]              covariance of what is left over that of white noise
    use : (n, c) bool                   cameras that took part
    outcome : (n,) int
    """

    motion: Float[np.ndarray, "n 6 3"]
    covariance: Float[np.ndarray, "n 3 3"]
    score: Float[np.ndarray, "n c"]
    left: Float[np.ndarray, "n c"]
    own: Float[np.ndarray, "n c 2"]
    own_variance: Float[np.ndarray, "n c"]
    rough: Float[np.ndarray, " n"]
    use: Bool[np.ndarray, "n c"]
    outcome: Int[np.ndarray, " n"]


def match_scene(
    scene: Scene,
    moved: Sequence[SplinePicture],
    start: Float[np.ndarray, "n 6 3"],
    *,
    settings: JointSettings,
) -> tuple[Match, Float[np.ndarray, " c"]]:
    """Follow all points of a scene into later pictures.

    Parameters
    ----------
    scene : Scene
    moved : sequence of c SplinePicture
    start : (n, 6, 3) float [m]         motion to start from; NaN where there is none
    settings : JointSettings

    Returns
    -------
    match : Match
    noise : (c,) float [grey levels]    standard deviation that a match leaves in each camera
    """
    whole = np.arange(len(scene.point))
    noise = np.ones(len(moved))
    match = _refined(scene, moved, start, scene.seen, whole, noise, settings)
    noise = _noise(match)
    quick = replace(settings, iterations=min(settings.iterations, _PATIENCE))
    match = _without_one_camera(scene, moved, match, start, noise, quick)
    for _ in range(_RETRIES):
        again, restart = _second_tries(scene, match, noise, settings)
        if len(again) == 0:
            break
        tried = _refined(scene, moved, restart, scene.seen[again], again, noise, quick)
        tried = _without_one_camera(scene, moved, tried, restart, noise, quick, rows=again)
        match = replaced(match, tried, again)
    known = _with_derivatives(scene, match, settings)
    rows = np.flatnonzero(np.isfinite(known).all(axis=(1, 2)))
    last = _refined(
        scene, moved, known[rows], match.use[rows], rows, noise, settings, shape=settings.shape
    )
    match = replaced(match, last, rows)
    return match, _noise(match)


def _refined(
    scene: Scene,
    moved: Sequence[SplinePicture],
    start: Float[np.ndarray, "k 6 3"],
    use: Bool[np.ndarray, "k c"],
    rows: Int[np.ndarray, " k"],
    noise: Float[np.ndarray, " c"],
    settings: JointSettings,
    *,
    shape: str = "affine",
) -> Match:
    """Joint refinement of some points of the scene from given motions."""
    pictures = scene.pictures
    motion, covariance, score, left, own, own_variance, rough, state = refine_joint(
        First(
            scene.packed,
            tuple(picture.grey for picture in pictures),
            tuple(picture.along_column for picture in pictures),
            tuple(picture.along_row for picture in pictures),
            scene.surface,
            scene.inner,
        ),
        tuple(picture.coefficients for picture in moved),
        Points(scene.point[rows], scene.tangent[rows], scene.extent[rows]),
        np.ascontiguousarray(use),
        np.ascontiguousarray(start),
        noise,
        Limits(
            settings.subset // 2,
            _BASES[shape],
            settings.tolerance,
            settings.reach,
            settings.iterations,
            settings.least_share,
            settings.shading,
        ),
    )
    # The noise is that of the whole picture; a window with more of it knows its motion less.
    excess = mean_over(left / noise**2, use & np.isfinite(left))
    outcome = np.array([_OUTCOMES[code] for code in range(len(_OUTCOMES))])[state]
    return Match(
        motion,
        covariance * excess[:, None, None],
        score,
        left,
        own,
        own_variance,
        rough,
        use,
        outcome,
    )


def mean_over(
    value: Float[np.ndarray, "n c"], used: Bool[np.ndarray, "n c"]
) -> Float[np.ndarray, " n"]:
    """Mean over the cameras used, NaN where there are none."""
    total = np.where(used, value, 0.0).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / used.sum(axis=1)


def _noise(match: Match) -> Float[np.ndarray, " c"]:
    """What a match leaves in each camera, the median over the points [grey levels]."""
    found = match.outcome == Outcome.VALID
    noise = np.ones(match.left.shape[1])
    for c in range(len(noise)):
        left = match.left[found & np.isfinite(match.left[:, c]), c]
        if len(left) > 0:
            # A picture without noise, or rounded to it, still has its rounding.
            noise[c] = np.sqrt(max(float(np.median(left)), 1.0 / 6.0))
    return noise


def bad_cameras(
    match: Match, noise: Float[np.ndarray, " c"], excess: float
) -> Bool[np.ndarray, "n c"]:
    """Cameras whose window looks different when loaded: covered, shadowed, a highlight."""
    with np.errstate(invalid="ignore"):
        return match.use & (match.left > (excess * noise) ** 2)


def _without_one_camera(
    scene: Scene,
    moved: Sequence[SplinePicture],
    match: Match,
    start: Float[np.ndarray, "n 6 3"],
    noise: Float[np.ndarray, " c"],
    settings: JointSettings,
    *,
    rows: Int[np.ndarray, " n"] | None = None,
) -> Match:
    """Try the points that do not fit without each of their cameras in turn, where two are left.

    A camera whose view is covered drags the common motion along until no camera fits, so it cannot
    be told by what it leaves; the others fit when it is the one that is left out.
    """
    own_use = match.use
    again = np.flatnonzero(~_fits(match, noise, settings) & (own_use.sum(axis=1) >= 3))
    best = np.full(len(own_use), np.inf)
    for c in range(own_use.shape[1]):
        some = again[own_use[again, c]]
        if len(some) == 0:
            continue
        use = own_use[some].copy()
        use[:, c] = False
        whole = some if rows is None else rows[some]
        tried = _refined(scene, moved, start[some], use, whole, noise, settings)
        excess = mean_over(tried.left / noise**2, use & np.isfinite(tried.left))
        with np.errstate(invalid="ignore"):
            better = _fits(tried, noise, settings) & (excess < best[some])
        best[some[better]] = excess[better]
        tried.outcome[~better] = Outcome.LOST
        match = replaced(match, tried, some)
    return match


def replaced(match: Match, other: Match, rows: Int[np.ndarray, " k"]) -> Match:
    """A match whose rows are replaced where the other one found something."""
    good = other.outcome == Outcome.VALID
    arrays = {}
    for name in (
        "motion",
        "covariance",
        "score",
        "left",
        "own",
        "own_variance",
        "rough",
        "use",
        "outcome",
    ):
        value = getattr(match, name).copy()
        value[rows[good]] = getattr(other, name)[good]
        arrays[name] = value
    return Match(**arrays)


def _fits(
    match: Match, noise: Float[np.ndarray, " c"], settings: JointSettings
) -> Bool[np.ndarray, " n"]:
    """Points that were found and whose cameras all show the same surface as at first."""
    bad = bad_cameras(match, noise, settings.excess).any(axis=1)
    return (match.outcome == Outcome.VALID) & ~bad


def _second_tries(
    scene: Scene, match: Match, noise: Float[np.ndarray, " c"], settings: JointSettings
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 6 3"]]:
    """Points that were lost or fit badly, with their neighbours' motion to start from."""
    fits = _fits(match, noise, settings)
    reach = neighbourhood(scene)
    guess = predicted(
        scene.point,
        scene.tangent,
        match.motion[:, 0],
        match.motion[:, 1:3] / scene.extent[:, None, None],
        fits,
        reach=reach,
    )
    may = np.isin(match.outcome, (Outcome.LOST, Outcome.VALID, Outcome.OUTSIDE))
    known = np.isfinite(guess.displacement).all(axis=1)
    with np.errstate(invalid="ignore"):
        away = np.linalg.norm(match.motion[:, 0] - guess.displacement, axis=1)
        far = ~(away < pixel_size(scene))
    rows = np.flatnonzero(may & ~fits & known & far)
    restart = np.zeros((len(rows), 6, 3))
    restart[:, 0] = guess.displacement[rows]
    restart[:, 1:3] = guess.gradient[rows] * scene.extent[rows, None, None]
    return rows, restart


def _with_derivatives(
    scene: Scene, match: Match, settings: JointSettings
) -> Float[np.ndarray, "n 6 3"]:
    """The motion found, with derivatives from the motion around each point; NaN without those."""
    good = match.outcome == Outcome.VALID
    motion = np.full(match.motion.shape, np.nan)
    if not good.any():
        return motion
    field = local_field(
        Scatter(
            scene.point[good],
            scene.pixel[good],
            match.motion[good, 0],
            match.covariance[good],
            np.zeros((int(good.sum()), 3, 3)),
            settings.subset,
        ),
        scene.point,
        scene.tangent,
        reach=neighbourhood(scene),
    )
    size = scene.extent[good, None, None]
    motion[good, 0] = match.motion[good, 0]
    motion[good, 1:3] = field.gradient[good] * size
    motion[good, 3:] = field.curvature[good] * size**2
    return motion


def neighbourhood(scene: Scene) -> float:
    """Radius within which points have a say about each other [m]."""
    return AROUND * float(np.median(scene.extent)) if len(scene.extent) else 1.0
