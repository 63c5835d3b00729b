"""Range flow as in the source: stereo, whole-pixel optical flow, and a vote of the cameras.

The baseline for the method `joint`. The pictures of every instant are rectified and matched with
each other. Pixels of the reference camera whose stereo points lie on the object's surface are
tracked from instant to instant by `vote`; a displacement is the difference of two stereo points.
The flow has no sub-pixel step, and rounding errors accumulate over the instants, as in the source.
A vertex takes the weighted mean of the displacements around it, without those that least median of
squares rejects.

Choices where the source is silent: its stereo is a commercial library, here `disparity_map`; a
pixel is on the surface if its disparity agrees with that of the mesh to one pixel.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), section 4;
Rousseeuw and Leroy, Robust Regression and Outlier Detection (1987), for the least median of squares
and its robust scale.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from palpate.arrays import STD_OVER_MEDIAN, with_rows
from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.records import Camera, Rig
from palpate.shapes import Flags, Points, PointScalars, Triangles, Vertices
from palpate.threads import map_in_threads
from palpate.vision.lang_pai.disparity import (
    MIN_CONTRAST,
    WINDOW,
    Instant,
    StereoHead,
    head_disparity,
    head_points,
    make_head,
    make_instant,
)
from palpate.vision.lang_pai.voting import Vote, vote
from palpate.vision.normalisation import moments
from palpate.vision.projection import project
from palpate.vision.range_flow import Outcome, RangeFlow, VertexDisplacement, grid_points, is_valid
from palpate.vision.surface_map import surface_map

# Largest difference from the mesh's disparity for a pixel on its surface [px]: the error of
# matching in whole pixels is smaller.
_MAX_SURFACE_MISS_PX = 1.0
# Motion towards or away from the camera that the range of disparities allows for, as a fraction of
# the mesh's bounding diagonal.
_TRAVEL = 0.5
# Radius of the flow used for a vertex [m]; the source's 1 cm.
_REACH = 0.01
# Unit of d in the weight 1 / (1 + d) [m]: lengths are in cm in the source's tables.
_DISTANCE_UNIT = 0.01
# Standard deviations beyond which a motion is rejected; the source's 3.
_MAX_DEVIATION = 3.0
# Motions around a vertex tried as centres, evenly spread: if half of the motions are outliers, the
# probability that all 100 are is 1e-30.
_TRIALS = 100
# Fewer motions do not determine a covariance in three dimensions.
_MIN_MOTIONS = 4


@dataclass(frozen=True, slots=True, eq=False)
class LangPaiState:
    """State of the method `lang-pai` between instants.

    Attributes
    ----------
    rig : Rig
    head : StereoHead
    limits : (float, float) [px]        minimum and maximum disparity tried
    point : (n, 3) float [m]            at the first instant: from stereo where tracking began,
                                        otherwise on the mesh
    tangent : (n, 2, 3) float
    rounding : (n, 3, 3) float [m^2]    covariance of one rounding to whole pixels
    noise : (n, 3, 3) float [m^2]       covariance due to the disparity errors of both instants
    instant : Instant                   the last one
    track : Vote                        current position of the tracked pixels
    steps : int                         number of instants since the first
    """

    rig: Rig
    head: StereoHead
    limits: tuple[float, float]
    point: Points
    tangent: Float[np.ndarray, "n 2 3"]
    rounding: Float[np.ndarray, "n 3 3"]
    noise: Float[np.ndarray, "n 3 3"]
    instant: Instant
    track: Vote
    steps: int


@dataclass(frozen=True, slots=True)
class LangPaiFlow:
    """The method `lang-pai`, a `FlowMethod`: the paper's, with its parameter values where given.

    In its flow, `gradient`, `noise` and `drift` are NaN, because the method does not measure them.
    `through_last` is False, although every point is tracked through all instants, because there is
    no direct match. `bias` is the rounding to whole pixels, taken as fully correlated over the
    steps since the first instant; `covariance` adds the scatter of the first disparities about the
    mesh.

    Parameters
    ----------
    subset : int [px]               side of the window of the optical flow, odd, at least 3; 7 in
                                    the paper
    search : int [px]               side of the search square at the next instant, odd, at least 3;
                                    13 in the paper, for motions of up to 6 px
    step : int [px]                 spacing of the points in the reference camera, at least 1; the
                                    paper tracks every pixel

    Raises
    ------
    InputError                      `subset` or `search` even or below 3, `step` below 1

    Source
    ------
    Lang and Pai (2001), section 4.
    """

    subset: int = 7
    search: int = 13
    step: int = 1

    def __post_init__(self) -> None:
        for name, value in (("subset", self.subset), ("search", self.search)):
            if value < 3 or value % 2 == 0:
                raise InputError(f"{name} is {value}; must be an odd number of pixels, 3 or more")
        if self.step < 1:
            raise InputError(f"step is {self.step}; must be 1 or more")

    def start(
        self, rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]], surface: TriangleMesh
    ) -> LangPaiState:
        """Stereo matching of the first instant; see `FlowMethod.start`.

        The points are the pixels of the rectified reference that see the mesh.

        Parameters
        ----------
        rig : Rig                       two cameras, or more of which two form an L with the
                                        reference
        pictures : sequence of c (rows, columns) float [grey levels]    of one size
        surface : TriangleMesh

        Returns
        -------
        LangPaiState

        Raises
        ------
        InputError                      wrong number of pictures, or pictures of different sizes
        CalibrationError                cameras that cannot be rectified, or a mesh that is not in
                                        front of them
        """
        _check_pictures(rig, pictures)
        shape = pictures[0].shape
        head = make_head(rig, (shape[0], shape[1]))
        pixel, point, tangent = _seen_mesh(head, surface, self.step)
        expected = head_disparity(head, point)
        limits = _disparity_limits(head, surface)
        first = make_instant(head, pictures, limits)
        track = _begun(first, pixel, expected)
        begun = track.outcome == Outcome.VALID
        disparity = first.disparity[pixel[:, 1], pixel[:, 0]]
        point = point.copy()
        point[begun] = head_points(head, pixel[begun], disparity[begun])
        along_surface, along_ray = _pixel_footprints(
            head.rectified.cameras[0], pixel, tangent, expected, head.parallax
        )
        off = np.abs(disparity - expected)[begun]
        scatter = STD_OVER_MEDIAN * float(np.median(off)) if len(off) else 0.0
        # Rounding errors are uniform over a pixel: variance 1 / 12.
        rounding = np.einsum("nki,nkj->nij", along_surface, along_surface) / 12.0
        noise = 2.0 * scatter**2 * np.einsum("ni,nj->nij", along_ray, along_ray)
        return LangPaiState(rig, head, limits, point, tangent, rounding, noise, first, track, 0)

    def follow(
        self, state: LangPaiState, pictures: Sequence[Float[np.ndarray, "_ _"]]
    ) -> tuple[LangPaiState, RangeFlow]:
        """Stereo matching of the next instant and the vote on each pixel; see `FlowMethod.follow`.

        Pixels once rejected are not tracked again.

        Parameters
        ----------
        state : LangPaiState            of the previous instant
        pictures : sequence of c (rows, columns) float [grey levels]

        Returns
        -------
        state : LangPaiState
        flow : RangeFlow                from the first instant

        Raises
        ------
        InputError                      wrong number of pictures, or pictures of another size
        """
        _check_pictures(state.rig, pictures, state.head.shape)
        after = make_instant(state.head, pictures, state.limits)
        rows = np.flatnonzero(state.track.outcome == Outcome.VALID)
        votes = vote(
            state.instant, after, state.head.views, state.track.pixel[rows],
            subset=self.subset, search=self.search,
        )  # fmt: skip
        names = [field.name for field in fields(Vote)]
        track = Vote(*(with_rows(getattr(state.track, k), rows, getattr(votes, k)) for k in names))
        state = replace(state, instant=after, track=track, steps=state.steps + 1)
        return state, self._flow(state)

    def vertices(self, flow: RangeFlow, rig: Rig, surface: TriangleMesh) -> VertexDisplacement:
        """Displacement of the mesh's vertices by `lang_pai_vertices`.

        Parameters
        ----------
        flow : RangeFlow
        rig : Rig                       not used
        surface : TriangleMesh          of v vertices

        Returns
        -------
        VertexDisplacement              NaN where fewer than four motions agree
        """
        return lang_pai_vertices(flow, surface.vertices, surface.triangles)

    def averaged(
        self, displacement: VertexDisplacement, flow: RangeFlow, rig: Rig, surface: TriangleMesh
    ) -> VertexDisplacement:
        """Return the displacements unchanged: the averaging by the windows is not known here.

        Parameters
        ----------
        displacement : VertexDisplacement
        flow : RangeFlow                not used
        rig : Rig                       not used
        surface : TriangleMesh          not used

        Returns
        -------
        VertexDisplacement              `displacement`
        """
        return displacement

    def _flow(self, state: LangPaiState) -> RangeFlow:
        """Displacement since the first instant."""
        head, track = state.head, state.track
        valid = track.outcome == Outcome.VALID
        displacement = np.full_like(state.point, np.nan)
        column, row = track.pixel[valid].T
        now = head_points(head, track.pixel[valid], state.instant.disparity[row, column])
        displacement[valid] = now - state.point[valid]
        bias = state.steps**2 * state.rounding + np.where(valid, 0.0, np.nan)[:, None, None]
        return RangeFlow(
            pixel=project(state.rig.cameras[state.rig.reference], state.point),
            point=state.point,
            tangent=state.tangent,
            displacement=displacement,
            gradient=np.full(state.tangent.shape, np.nan),
            covariance=bias + state.noise,
            bias=bias,
            score=track.score,
            reprojection=track.distance,
            cameras=track.agreed,
            outcome=track.outcome,
            through_last=np.zeros(len(state.point), dtype=bool),
            drift=np.nan,
            noise=np.full(len(state.rig.cameras), np.nan),
            subset=self.subset,
            step=self.step,
            shape=head.shape,
        )


def _check_pictures(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    shape: tuple[int, int] | None = None,
) -> None:
    """Raise unless there is one picture per camera and all have one size."""
    if len(pictures) != len(rig.cameras):
        raise InputError(
            f"an instant has {len(pictures)} pictures; must be one of each camera:"
            f" {', '.join(camera.name for camera in rig.cameras)}"
        )
    shapes = {picture.shape for picture in pictures} | ({shape} if shape else set())
    if len(shapes) != 1:
        raise InputError(
            f"pictures are of {len(shapes)} sizes (rows x columns):"
            f" {', '.join(f'{a} x {b}' for a, b in sorted(shapes))}; the method lang-pai rectifies"
            " pictures of one size; take the method joint for mixed cameras"
        )


def _disparity_limits(head: StereoHead, surface: TriangleMesh) -> tuple[float, float]:
    """Minimum and maximum disparity of the mesh [px], allowing for motion by `_TRAVEL`."""
    used = surface.vertices[surface.triangles].reshape(-1, 3)
    pose = head.rectified.cameras[0].T_camera_object
    depth = used @ pose[2, :3] + pose[2, 3]
    room = _TRAVEL * float(np.linalg.norm(np.ptp(used, axis=0)))
    # At least half its present distance: any closer, the camera would no longer see all of it.
    nearest = max(float(depth.min()) - room, 0.5 * float(depth.min()))
    return head.parallax / (float(depth.max()) + room), head.parallax / nearest


def _seen_mesh(
    head: StereoHead, surface: TriangleMesh, step: int
) -> tuple[Int[np.ndarray, "n 2"], Points, Float[np.ndarray, "n 2 3"]]:
    """The points to track: pixels of a grid of the rectified reference that see the mesh, the
    points of the mesh there, and its tangents."""
    seen = surface_map(head.rectified.cameras[0], head.canvas, surface.vertices, surface.triangles)
    shown = seen.triangle >= 0
    return grid_points(seen, shown, surface.vertices, surface.triangles, step)


def _begun(first: Instant, pixel: Int[np.ndarray, "n 2"], expected: PointScalars) -> Vote:
    """Initial track: all pixels in place, valid where stereo confirms the disparity of the mesh."""
    column, row = pixel.T
    measured = first.disparity[row, column]
    n = len(measured)
    outcome = np.full(n, int(Outcome.VALID))
    with np.errstate(invalid="ignore"):
        off = ~(np.abs(measured - expected) <= _MAX_SURFACE_MISS_PX)
    outcome[off] = int(Outcome.REPROJECTION)
    unknown = np.isnan(measured)
    flat = _contrast(first.pictures[0])[row, column]
    outcome[unknown] = int(Outcome.HIDDEN)
    outcome[unknown & (flat < MIN_CONTRAST)] = int(Outcome.TEXTURE)
    return Vote(pixel, np.full(n, np.nan), np.full(n, np.nan), np.zeros(n, dtype=np.int64), outcome)


def _contrast(grey: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "rows columns"]:
    """Standard deviation in each pixel's window [grey levels]; NaN where a pixel has no data."""
    known = np.isfinite(grey)
    value = np.where(known, grey, 0.0).astype(np.float64)
    whole = cv2.erode(known.astype(np.uint8), np.ones((WINDOW, WINDOW), dtype=np.uint8)) > 0
    return np.where(whole, np.sqrt(moments(value, WINDOW)[1]), np.nan)


def _pixel_footprints(
    camera: Camera,
    pixel: Int[np.ndarray, "n 2"],
    tangent: Float[np.ndarray, "n 2 3"],
    disparity: PointScalars,
    parallax: float,
) -> tuple[Float[np.ndarray, "n 2 3"], Points]:
    """Derivatives of a pixel's surface point [m/px]: along the surface with respect to column and
    row, (n, 2, 3), and along its ray with respect to disparity, (n, 3).
    """
    turn = camera.T_camera_object[:3, :3]
    back = np.linalg.inv(camera.matrix)
    ray = np.column_stack([pixel, np.ones(len(pixel))]) @ back.T @ turn
    depth = parallax / disparity
    normal = np.cross(tangent[:, 0], tangent[:, 1])
    facing = np.einsum("ni,ni->n", normal, ray)
    # Limited to a hundredth of a radian: the footprint of a facet seen edge-on is unbounded.
    facing = np.where(np.abs(facing) < 0.01, np.copysign(0.01, facing), facing)
    across = back[:, :2].T @ turn
    nearer = normal @ across.T / facing[:, None]
    along_surface = depth[:, None, None] * (across - nearer[..., None] * ray[:, None])
    return along_surface, -(depth**2 / parallax)[:, None] * ray


def lang_pai_vertices(
    flow: RangeFlow, vertices: Vertices, triangles: Triangles
) -> VertexDisplacement:
    """Mean of the flow around each vertex, weighted by 1 / (1 + d), after rejection of outliers.

    Of the motions around a vertex, the one with the smallest median distance to the others is
    found. Motions farther from it than three robust standard deviations, derived from that median,
    are rejected.

    Parameters
    ----------
    flow : RangeFlow                of any method
    vertices, triangles : (v, 3) float [m], (m, 3) int

    Returns
    -------
    VertexDisplacement              NaN at vertices of no triangle, or with fewer than 4 motions
                                    left. The covariance is that of the mean, from the scatter of
                                    the remaining motions; motions with overlapping windows count as
                                    one, and their shared rounding error is not averaged down

    Source
    ------
    Lang and Pai (2001), section 4; the unit of d is not given there.
    """
    valid = is_valid(flow)
    displacement = np.full(vertices.shape, np.nan)
    covariance = np.full((*vertices.shape, 3), np.nan)
    count = np.zeros(len(vertices), dtype=np.int64)
    if valid.any():
        point, motion, bias = flow.point[valid], flow.displacement[valid], flow.bias[valid]
        tree = cKDTree(point)
        overlap = max(1.0, (flow.subset / flow.step) ** 2)

        def estimate(v: int) -> None:
            near = np.array(tree.query_ball_point(vertices[v], _REACH, return_sorted=True), int)
            if len(near) < _MIN_MOTIONS:
                return
            near = near[_agreeing(motion[near])]
            count[v] = len(near)
            if len(near) >= _MIN_MOTIONS:
                distance = np.linalg.norm(point[near] - vertices[v], axis=1)
                weight = 1.0 / (1.0 + distance / _DISTANCE_UNIT)
                displacement[v], covariance[v] = _weighted_mean(
                    motion[near], bias[near], weight / weight.sum(), overlap
                )

        for _ in map_in_threads(estimate, np.unique(triangles).tolist()):
            pass
    return VertexDisplacement(displacement, covariance, count)


def _agreeing(motion: Points) -> Flags:
    """True for motions within three standard deviations of the one with the least median distance.

    For an even number of motions the upper median is used, as in Rousseeuw and Leroy (h = n / 2 +
    1).
    """
    n = len(motion)
    tried = min(n, _TRIALS)
    trial = np.arange(tried) * n // tried
    square = cdist(motion[trial], motion, "sqeuclidean")
    median = np.partition(square, n // 2, axis=1)[:, n // 2]
    best = int(median.argmin())
    # With a small-sample correction.
    deviation = STD_OVER_MEDIAN * (1.0 + 5.0 / (n - 1)) * np.sqrt(median[best])
    return square[best] <= (_MAX_DEVIATION * deviation) ** 2


def _weighted_mean(
    motion: Points, bias: Float[np.ndarray, "n 3 3"], weight: PointScalars, overlap: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Weighted mean of motions, the weights adding up to 1, and its covariance."""
    mean = weight @ motion
    deviations = motion - mean
    sum_of_squares = float((weight**2).sum())
    # Fraction of the scatter that remains in the mean; all of it where all windows overlap.
    fraction = min(1.0, overlap * sum_of_squares) / (1.0 - sum_of_squares)
    scatter = fraction * (weight[:, None] * deviations).T @ deviations
    return mean, scatter + np.einsum("n,nij->ij", weight, bias)
