"""Range flow by matching the windows of all cameras jointly: the method `joint`.

Every later instant is matched with the first one, so that errors do not accumulate; the search
starts from the last motion found. Where the picture has become too different from the first one,
the motion via the previous instant is used instead: a surface that has moved far, or whose
illumination has changed, still resembles its last picture. Errors of such motions accumulate, so
the drift is measured on the points around, which are matched both ways.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from palpate.arrays import with_rows
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, refined_surface
from palpate.machine import check_memory_for, usable_memory
from palpate.records import Rig
from palpate.shapes import Flags, Points, Triangles, Vertices
from palpate.threads import map_in_threads
from palpate.vision.joint.match import BEND_REACH, accepted_flow, match_scene
from palpate.vision.joint.sharpness import blur_difference, equally_sharp
from palpate.vision.joint.vertices import vertex_displacement, with_average
from palpate.vision.matching.dense_flow import dense_start
from palpate.vision.matching.local_regression import Scatter, local_field
from palpate.vision.matching.scene import Limits, Scene, advanced_scene, make_scene, scene_rows
from palpate.vision.matching.window import BASES
from palpate.vision.projection import project
from palpate.vision.range_flow import RangeFlow, VertexDisplacement, grid_triangles, is_valid
from palpate.vision.spline import SplinePicture, spline_pictures
from palpate.vision.triangulation import triangulate

# Median displacement gradient (Frobenius norm) above which pictures are matched unsmoothed: the
# low-pass is fixed to the pixels and does not rotate or stretch with the surface.
_MAX_SMOOTHED_GRADIENT = 0.03
# The dense start is accurate to about half a pixel; where the cameras contradict each other by more
# than four times that, it is wrong.
_START_ERROR_PX = 0.5
_MAX_START_RESIDUAL_PX = 2.0
# No dense search where all but a few windows, of so many that are looked at, moved by less since
# the last instant: a match finds them within a few pixels, and those few have second attempts.
_NEAR_PX, _FEW, _LOOKED_AT = 1.0, 0.01, 400
# Smoothing radius, in half windows, of the field that interpolates starts over gaps.
_START_REACH = 3.0

# Memory for what a point's windows average [bytes]: measured with 11 000 and 44 000 points of three
# cameras; it hardly depends on the size of the windows.
_BYTES_PER_POINT = 8e4


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """State of the method `joint` between instants.

    Attributes
    ----------
    scene : Scene                       the first instant
    grey : tuple of c (rows, columns) float [grey levels]   pictures of the last instant
    motion : (n, 6, 3) float [m]        from the first instant to the last, as in `Match`; the start
                                        where rejected, NaN where unknown
    flow : RangeFlow or None            range flow from the first instant to the last; None at the
                                        first instant
    blur : (c,) float [px^2]            blur variance of the last pictures minus that of the first
    """

    scene: Scene
    grey: tuple[Float[np.ndarray, "_ _"], ...]
    motion: Float[np.ndarray, "n 6 3"]
    flow: RangeFlow | None
    blur: Float[np.ndarray, " c"]


@dataclass(frozen=True, slots=True)
class JointFlow:
    """The method `joint`, a `FlowMethod`: all cameras matched at once, to a hundredth of a pixel.

    Parameters
    ----------
    subset : int [px]               side of the window, odd, at least 5; a larger one has less noise
                                    and resolves less detail
    step : int [px]                 spacing of the points in the reference camera, at least 1
    shape : "shift", "affine" or "quadratic"    shape function of a window; higher derivatives, up
                                    to the second, are taken from its neighbours, to reduce the bias
                                    where the surface stretches, rotates or bends
    smoothing : float [px]          standard deviation of the Gaussian low-pass of every picture,
                                    against the bias from aliased structure; 0: none

    Raises
    ------
    InputError                      the subset is even or below 5, or the step is below 1
    """

    subset: int = 21
    step: int = 5
    shape: Literal["shift", "affine", "quadratic"] = "affine"
    smoothing: float = 1.0

    def __post_init__(self) -> None:
        if self.subset < 5 or self.subset % 2 == 0:
            raise InputError(f"subset is {self.subset}; must be an odd number of pixels, 5 or more")
        if self.step < 1:
            raise InputError(f"step is {self.step}; must be 1 pixel or more")

    def start(
        self, rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]], surface: TriangleMesh
    ) -> JointState:
        """Process the first instant; see `FlowMethod.start`.

        The points lie on the smooth surface through the mesh's vertices that the estimate uses too,
        not on the facets.

        Parameters
        ----------
        rig : Rig
        pictures : sequence of c (rows, columns) float [grey levels]    in the rig's order
        surface : TriangleMesh

        Returns
        -------
        JointState

        Raises
        ------
        InputError, CalibrationError    as in `surface_map`
        """
        return self.start_on(rig, pictures, *refined_surface(surface))

    def start_on(
        self,
        rig: Rig,
        pictures: Sequence[Float[np.ndarray, "_ _"]],
        vertices: Vertices,
        triangles: Triangles,
    ) -> JointState:
        """Process the first instant with a surface used as given, open or closed.

        Parameters
        ----------
        rig : Rig
        pictures : sequence of c (rows, columns) float [grey levels]    in the rig's order
        vertices, triangles : (v, 3) float [m], (m, 3) int

        Returns
        -------
        JointState

        Raises
        ------
        InputError, CalibrationError    as in `surface_map`; more points than the memory holds
        """
        scene = make_scene(
            rig, pictures, vertices, triangles, subset=self.subset, step=self.step,
            smoothing=self.smoothing,
        )  # fmt: skip
        needed = _BYTES_PER_POINT * len(scene.point)
        step = int(np.ceil(self.step * np.sqrt(needed / usable_memory())))
        check_memory_for(
            f"{len(scene.point)} points, {self.step} px apart,", needed,
            f"use a step of {step} px or more (--step)",
        )  # fmt: skip
        still = np.zeros((len(scene.point), 6, 3))
        return JointState(scene, scene.grey, still, None, np.zeros(len(scene.grey)))

    def follow(
        self, state: JointState, pictures: Sequence[Float[np.ndarray, "_ _"]]
    ) -> tuple[JointState, RangeFlow]:
        """Match the first instant with the next one; see `FlowMethod.follow`.

        Parameters
        ----------
        state : JointState              of the previous instant
        pictures : sequence of c (rows, columns) float [grey levels]

        Returns
        -------
        state : JointState
        flow : RangeFlow                from the first instant

        Raises
        ------
        InputError, CalibrationError    as in `surface_map`
        """
        scene, now = state.scene, tuple(pictures)
        start = _flow_start(state, now)
        unsmoothed = _unsmoothed_where_turned(scene, start)
        later = spline_pictures(now, unsmoothed.smoothing)
        blur = blur_difference(unsmoothed, now, later, start)
        flow, matched = self._flow(*equally_sharp(unsmoothed, now, later, blur), start)
        motion = np.where(is_valid(flow)[:, None, None], matched, start)
        after = JointState(scene, now, motion, flow, blur)
        if state.flow is None or not len(missing := _followable(scene, state.flow, flow)):
            return after, flow
        if unsmoothed is not scene:
            later = spline_pictures(now, scene.smoothing)
        return self._through_last(state, state.flow, later, start, after, flow, missing)

    def vertices(self, flow: RangeFlow, rig: Rig, surface: TriangleMesh) -> VertexDisplacement:
        """Displacement of the mesh's vertices by robust local quadratics.

        Parameters
        ----------
        flow : RangeFlow
        rig : Rig
        surface : TriangleMesh          of v vertices

        Returns
        -------
        VertexDisplacement              NaN where `vertex_displacement` finds too few points
        """
        camera = rig.cameras[rig.reference]
        return vertex_displacement(flow, camera, surface.vertices, surface.triangles)

    def averaged(
        self, displacement: VertexDisplacement, flow: RangeFlow, rig: Rig, surface: TriangleMesh
    ) -> VertexDisplacement:
        """Add the averaging of the surface's displacement by the windows (`surface_average`).

        Parameters
        ----------
        displacement : VertexDisplacement      from `vertices`
        flow : RangeFlow
        rig : Rig
        surface : TriangleMesh          of v vertices

        Returns
        -------
        VertexDisplacement              unchanged for the shape function "shift"
        """
        order = BASES[self.shape] // 3
        return displacement if order == 0 else with_average(displacement, flow, rig, surface, order)

    def _flow(
        self, scene: Scene, later: Sequence[SplinePicture], start: Float[np.ndarray, "n 6 3"]
    ) -> tuple[RangeFlow, Float[np.ndarray, "n 6 3"]]:
        """Range flow from a scene to later pictures as sharp as its own, and the motion of every
        window."""
        match, noise = match_scene(scene, later, start, shape=self.shape)
        return accepted_flow(scene, match, noise), match.motion

    def _through_last(
        self,
        state: JointState,
        last: RangeFlow,
        later: tuple[SplinePicture, ...],
        start: Float[np.ndarray, "n 6 3"],
        after: JointState,
        direct: RangeFlow,
        missing: Int[np.ndarray, " m"],
    ) -> tuple[JointState, RangeFlow]:
        """Complete the direct flow and motion of some points by those via the last instant. Points
        nearby are matched that way, too: for the field among neighbours, and for the drift."""
        scene, followed = state.scene, is_valid(last)
        away = cKDTree(scene.point[missing]).query(scene.point)[0]
        away /= float(np.median(scene.half_window))
        rows = np.flatnonzero(followed & (away <= BEND_REACH))
        earlier = np.zeros_like(after.motion)
        earlier[:, 0] = last.displacement
        earlier[:, 1:3] = last.gradient * scene.half_window[:, None, None]
        # The surface under their windows, and some more.
        shown = followed & (away <= 2.0 * BEND_REACH)
        there = scene_rows(advanced_scene(scene, state.grey, earlier, shown), rows)
        ahead = np.zeros((len(rows), 6, 3))
        ahead[:, 0] = start[rows, 0] - earlier[rows, 0]
        alike = equally_sharp(there, after.grey, later, after.blur - state.blur)
        further, beyond = self._flow(*alike, ahead)
        half_window = scene.half_window[rows]
        whole = composed_motion(
            earlier[rows], beyond, scene.tangent[rows], there.tangent, half_window
        )
        flow, motion = _completed(direct, after.motion, last, further, whole, half_window, rows)
        return replace(after, motion=motion, flow=flow), flow


def _followable(scene: Scene, last: RangeFlow, direct: RangeFlow) -> Int[np.ndarray, " m"]:
    """Points that were followed to the last instant and are missing now, where the surface of such
    points fills a window: the rest is beside a tool that goes on to cover it."""
    followed = is_valid(last)
    missing = np.flatnonzero(followed & ~is_valid(direct))
    pixel = scene.pixel[followed]
    middle = pixel[grid_triangles(pixel, scene.step)].mean(axis=1)
    half = scene.subset // 2
    cells = max(half // scene.step, 1)
    shown = cKDTree(middle).query_ball_point(
        scene.pixel[missing], cells * scene.step, p=np.inf, return_length=True
    )
    return missing[shown >= Limits(half).min_fraction * 2 * (2 * cells) ** 2]


def _flow_start(
    state: JointState, now: tuple[Float[np.ndarray, "_ _"], ...]
) -> Float[np.ndarray, "n 6 3"]:
    """Initial motion of every point from the first instant to now, accurate to about a pixel.

    It is the motion to the last instant where the pictures have hardly moved since; else composed
    of that and a dense search from its pictures to the present ones, smoothed. NaN where nothing is
    known near a point.
    """
    scene = state.scene
    if len(scene.point) == 0:
        return state.motion
    was = scene.point + state.motion[:, 0]
    known = np.isfinite(was).all(axis=1)
    point = np.where(known[:, None], was, scene.point)
    old = np.stack([project(camera, point) for camera in scene.rig.cameras])
    if state.flow is not None:
        last = is_valid(state.flow)
        marks = [old[c][scene.seen[:, c] & last] for c in range(len(old))]
        marks = [mark[:: max(len(mark) // _LOOKED_AT, 1)] for mark in marks]
        if all(map_in_threads(_hardly_moved, state.grey, now, marks)):
            return _smooth_start(scene, state.motion[:, 0], state.flow.covariance, last)
    target = np.full(old.shape, np.nan)
    searches = map_in_threads(dense_start, map(np.asarray, state.grey), map(np.asarray, now))
    for c, search in enumerate(searches):
        step, trusted = search.at(old[c])
        sure = scene.seen[:, c] & known & trusted
        target[c, sure] = old[c, sure] + step[sure]
    points = triangulate(scene.rig, target, _START_ERROR_PX)
    good = (points.cameras >= 2) & (points.residual < _MAX_START_RESIDUAL_PX)
    return _smooth_start(scene, points.point - scene.point, points.covariance, good)


def _hardly_moved(
    before: Float[np.ndarray, "_ _"], now: Float[np.ndarray, "_ _"], pixel: Float[np.ndarray, "k 2"]
) -> bool:
    """Whether a match that starts where some windows of a picture were would find them all."""
    if len(pixel) == 0:
        return False
    scale = 255.0 / max(float(before.max()), float(now.max()), 1.0)
    first, second = (cv2.convertScaleAbs(picture, alpha=scale) for picture in (before, now))
    start = pixel.astype(np.float32)
    after, tracked, _ = cv2.calcOpticalFlowPyrLK(first, second, start, start.copy(), maxLevel=2)
    far = np.linalg.norm(after - start, axis=1) > _NEAR_PX
    return bool((far | (tracked.ravel() == 0)).mean() < _FEW)


def _smooth_start(
    scene: Scene, displacement: Points, covariance: Float[np.ndarray, "n 3 3"], good: Flags
) -> Float[np.ndarray, "n 6 3"]:
    """The start and its gradient, from local linear fits to the known displacements nearby."""
    result = np.full((len(displacement), 6, 3), np.nan)
    if not good.any():
        return result
    reach = _START_REACH * float(np.median(scene.half_window))
    noise = covariance[good]
    scatter = Scatter(
        scene.point[good], scene.pixel[good], displacement[good], noise, 0.0 * noise, 1
    )
    field = local_field(scatter, scene.point, scene.tangent, reach=reach, order=1)
    result[:, 0] = field.displacement
    result[:, 1:3] = field.gradient * scene.half_window[:, None, None]
    result[np.isfinite(field.displacement).all(axis=1), 3:] = 0.0
    return result


def _unsmoothed_where_turned(scene: Scene, start: Float[np.ndarray, "n 6 3"]) -> Scene:
    """The scene, with unsmoothed pictures if the surface rotates or stretches strongly."""
    gradient = np.linalg.norm(start[:, 1:3] / scene.half_window[:, None, None], axis=(1, 2))
    gradient = gradient[np.isfinite(gradient)]
    if len(gradient) == 0 or np.median(gradient) <= _MAX_SMOOTHED_GRADIENT:
        return scene
    blur_variance = scene.blur_variance - scene.smoothing**2
    return replace(
        scene, pictures=spline_pictures(scene.grey, 0.0), smoothing=0.0, blur_variance=blur_variance
    )


def _completed(
    direct: RangeFlow,
    motion: Float[np.ndarray, "n 6 3"],
    last: RangeFlow,
    further: RangeFlow,
    whole: Float[np.ndarray, "k 6 3"],
    half_window: Float[np.ndarray, " k"],
    rows: Int[np.ndarray, " k"],
) -> tuple[RangeFlow, Float[np.ndarray, "n 6 3"]]:
    """The direct flow and motion, replaced by those via the last instant where they are missing.

    `whole` is that motion for the points `rows`, composed of `last` and of the flow `further` from
    there.
    """
    measured, directly = is_valid(further), is_valid(direct)[rows]
    both, take = measured & directly, measured & ~directly
    drift = np.nan
    if both.any():
        difference = whole[both, 0] - direct.displacement[rows[both]]
        drift = float(np.sqrt((difference**2).sum(axis=1).mean()))
    values = {
        "displacement": whole[:, 0],
        "gradient": whole[:, 1:3] / half_window[:, None, None],
        "covariance": last.covariance[rows] + further.covariance,
        "bias": last.bias[rows] + further.bias,
        "score": further.score,
        "reprojection": further.reprojection,
        "cameras": further.cameras,
        "outcome": further.outcome,
        "through_last": measured,
    }
    arrays: dict[str, Any] = {
        name: with_rows(getattr(direct, name), rows[take], value[take])
        for name, value in values.items()
    }
    return replace(direct, **arrays, drift=drift), with_rows(motion, rows[take], whole[take])


def composed_motion(
    before: Float[np.ndarray, "k 6 3"],
    after: Float[np.ndarray, "k 6 3"],
    first: Float[np.ndarray, "k 2 3"],
    second: Float[np.ndarray, "k 2 3"],
    half_window: Float[np.ndarray, " k"],
) -> Float[np.ndarray, "k 6 3"]:
    """Composition of two motions, including first derivatives.

    Parameters
    ----------
    before, after : (k, 6, 3) float [m]     as in `Match`
    first, second : (k, 2, 3) float         tangents along which their derivatives are taken
    half_window : (k,) float [m]            half side of a window on the surface

    Returns
    -------
    (k, 6, 3) float [m]                     second-order terms are zero
    """
    images = first + before[:, 1:3] / half_window[:, None, None]
    # Each image is a combination of the second tangents; its small normal part is neglected.
    coefficients = np.einsum("kai,kbi->kab", images, second)
    result = np.zeros_like(before)
    result[:, 0] = before[:, 0] + after[:, 0]
    result[:, 1:3] = before[:, 1:3] + np.einsum("kab,kbi->kai", coefficients, after[:, 1:3])
    return result
