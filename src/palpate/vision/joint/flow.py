"""Range flow by matching the windows of all cameras jointly: the method `joint`.

Every later instant is matched with the first one, so nothing accumulates; the motion found last is
where the search starts. Where the first picture has become too different, the way through the
instant before is taken instead.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from palpate.vision.images import spline_pictures
from palpate.vision.joint.acceptance import judged
from palpate.vision.joint.match import match_scene
from palpate.vision.joint.scene import Scene, scene_rows
from palpate.vision.joint.settings import JointSettings
from palpate.vision.joint.start import flow_start
from palpate.vision.joint.tracking import advanced_scene, composed_motion
from palpate.vision.range_flow import RangeFlow, is_valid

# Of the points that need no way through the instant before, one in so many takes it all the same:
# they measure the drift.
_DRIFT_SAMPLE = 8


def joint_flow(
    scene: Scene,
    later: Iterable[Sequence[Float[np.ndarray, "_ _"]]],
    *,
    settings: JointSettings = JointSettings(),
) -> Iterator[RangeFlow]:
    """Range flow from the first instant to each later one, as the pictures come.

    Parameters
    ----------
    scene : Scene                       the first instant
    later : iterable of pictures        of all cameras [grey levels], in time
    settings : JointSettings

    Yields
    ------
    RangeFlow                           for each later instant, against the first
    """
    before = scene.grey
    motion = np.zeros((len(scene.point), 6, 3))
    last: RangeFlow | None = None
    for pictures in later:
        now = tuple(pictures)
        start = flow_start(scene, motion, before, now)
        first, used = _smoothed_as_fits(scene, start, settings)
        match, noise = match_scene(
            first, spline_pictures(now, used.smoothing), start, settings=used
        )
        flow = judged(first, match, noise, used)
        motion = np.where(is_valid(flow)[:, None, None], match.motion, start)
        if last is not None:
            flow, motion = _through_last(scene, flow, motion, last, before, now, start, settings)
        yield flow
        before, last = now, flow


def _smoothed_as_fits(
    scene: Scene, start: Float[np.ndarray, "n 6 3"], settings: JointSettings
) -> tuple[Scene, JointSettings]:
    """The scene with its pictures unsmoothed where the surface turns or stretches much."""
    gradient = np.linalg.norm(start[:, 1:3] / scene.extent[:, None, None], axis=(1, 2))
    gradient = gradient[np.isfinite(gradient)]
    if len(gradient) == 0 or np.median(gradient) <= settings.turning:
        return scene, settings
    return replace(scene, pictures=spline_pictures(scene.grey, 0.0)), replace(
        settings, smoothing=0.0
    )


def _through_last(
    scene: Scene,
    direct: RangeFlow,
    motion: Float[np.ndarray, "n 6 3"],
    last: RangeFlow,
    before: tuple[Float[np.ndarray, "_ _"], ...],
    now: tuple[Float[np.ndarray, "_ _"], ...],
    start: Float[np.ndarray, "n 6 3"],
    settings: JointSettings,
) -> tuple[RangeFlow, Float[np.ndarray, "n 6 3"]]:
    """The direct flow, with the way through the last instant where that is better known.

    Parameters
    ----------
    scene : Scene
    direct, last : RangeFlow            from the first instant to now, and to the last instant
    motion, start : (n, 6, 3) float [m] found directly, and where the search began
    before, now : tuples of c (rows, columns) float     pictures of the last instant, and of now

    Returns
    -------
    flow : RangeFlow
    motion : (n, 6, 3) float [m]
    """
    was, found_now = is_valid(last), is_valid(direct)
    sample = np.zeros(len(was), dtype=bool)
    sample[::_DRIFT_SAMPLE] = True
    rows = np.flatnonzero(was & (~found_now | sample))
    if not (was & ~found_now).any():
        return direct, motion
    earlier = _motion_of(last, scene)
    there = advanced_scene(scene, before, earlier, was, settings=settings)
    part = scene_rows(there, rows)
    ahead = np.zeros((len(rows), 6, 3))
    ahead[:, 0] = start[rows, 0] - earlier[rows, 0]
    moved = spline_pictures(now, settings.smoothing)
    match, noise = match_scene(part, moved, ahead, settings=settings)
    found = judged(part, match, noise, settings)
    return _merged(scene, direct, motion, last, found, match.motion, there, rows)


def _merged(
    scene: Scene,
    direct: RangeFlow,
    motion: Float[np.ndarray, "n 6 3"],
    last: RangeFlow,
    found: RangeFlow,
    step: Float[np.ndarray, "k 6 3"],
    there: Scene,
    rows: Int[np.ndarray, " k"],
) -> tuple[RangeFlow, Float[np.ndarray, "n 6 3"]]:
    """Take the sum of two motions where the direct one is missing; measure the drift."""
    whole = composed_motion(
        _motion_of(last, scene)[rows], step, scene.tangent[rows], there.tangent[rows],
        scene.extent[rows],
    )  # fmt: skip
    covariance = last.covariance[rows] + found.covariance
    good = is_valid(found)
    both = good & is_valid(direct)[rows]
    drift = np.nan
    if both.any():
        apart = whole[both, 0] - direct.displacement[rows[both]]
        drift = float(np.sqrt((apart**2).sum(axis=1).mean()))
    new = rows[good & ~is_valid(direct)[rows]]
    take = good & ~is_valid(direct)[rows]
    changed = {
        "displacement": (whole[:, 0], direct.displacement),
        "gradient": (whole[:, 1:3] / scene.extent[rows, None, None], direct.gradient),
        "covariance": (covariance, direct.covariance),
        "bias": (last.bias[rows] + found.bias, direct.bias),
        "score": (found.score, direct.score),
        "reprojection": (found.reprojection, direct.reprojection),
        "cameras": (found.cameras, direct.cameras),
        "outcome": (found.outcome, direct.outcome),
    }
    arrays: dict[str, Any] = {}
    for name, (value, old) in changed.items():
        arrays[name] = old.copy()
        arrays[name][new] = value[take]
    motion = motion.copy()
    motion[new] = whole[take]
    through = direct.through_last.copy()
    through[new] = True
    return replace(direct, **arrays, through_last=through, drift=drift), motion


def _motion_of(flow: RangeFlow, scene: Scene) -> Float[np.ndarray, "n 6 3"]:
    """Displacement and gradient of a range flow the way the refinement takes them."""
    motion = np.zeros((len(flow.point), 6, 3))
    motion[:, 0] = flow.displacement
    motion[:, 1:3] = flow.gradient * scene.extent[:, None, None]
    return motion
