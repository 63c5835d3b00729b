"""Range flow as in the source: stereo, whole-pixel optical flow, and a vote of the cameras.

The baseline that the method `joint` is compared with. The pictures are rectified and matched with
each other at every instant; the pixels of the reference camera whose stereo points lie on the
object's surface are followed from instant to instant by `vote`; a displacement is the difference of
two stereo points. The flow has no sub-pixel step and rounding adds up over the instants, as it does
in the source.

What the source leaves open is settled so: its stereo is that of a commercial library, here
`disparity_map`; a pixel is on the surface where its disparity is that of the mesh to a pixel.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), section 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int

from palpate.errors import InputError
from palpate.progress import Progress, silent
from palpate.records import Camera, Rig
from palpate.shapes import PointIndices, Points, PointScalars, Triangles, Vertices
from palpate.vision.cameras import project, surface_map
from palpate.vision.lang_pai.rectified_head import (
    StereoHead,
    common_shape,
    head_disparity,
    head_points,
    make_head,
    make_instant,
)
from palpate.vision.lang_pai.settings import LangPaiSettings
from palpate.vision.lang_pai.voting import Instant, VoteSettings, vote
from palpate.vision.range_flow import Outcome, RangeFlow

# Standard deviation of normal errors over the median of their sizes.
_FROM_MEDIAN = 1.4826


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What the rectified reference sees of the mesh, at the pixels that are looked at.

    `pixel` (n, 2) column and row, `point` (n, 3) [m], `tangent` (n, 2, 3), and the disparities of
    the mesh there [px].
    """

    pixel: Int[np.ndarray, "n 2"]
    point: Points
    tangent: Float[np.ndarray, "n 2 3"]
    disparity: PointScalars


@dataclass(frozen=True, slots=True, eq=False)
class _Rest:
    """What all flows of a sequence share.

    `pixel` (n, 2) in the reference camera as it took the picture, `point` (n, 3) [m] by stereo
    where tracking began, else of the mesh; `rounding` and `noise` (n, 3, 3) [m^2]: covariances of
    one rounding to whole pixels, and of the disparities of both instants.
    """

    rig: Rig
    head: StereoHead
    pixel: Float[np.ndarray, "n 2"]
    point: Points
    tangent: Float[np.ndarray, "n 2 3"]
    rounding: Float[np.ndarray, "n 3 3"]
    noise: Float[np.ndarray, "n 3 3"]
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """Where the pixels have come to: column and row now, and what is known of the last vote."""

    pixel: Int[np.ndarray, "n 2"]
    score: PointScalars
    apart: PointScalars
    agreed: PointIndices
    outcome: PointIndices


def lang_pai_flow(
    rig: Rig,
    pictures: Sequence[Sequence[Float[np.ndarray, "_ _"]]],
    vertices: Vertices,
    triangles: Triangles,
    *,
    settings: LangPaiSettings = LangPaiSettings(),
    progress: Progress | None = None,
) -> list[RangeFlow]:
    """Range flow of an object from its first instant to each later one.

    Parameters
    ----------
    rig : Rig                       two cameras, or more with two that make an L with the reference
    pictures : sequence over time of tuples of (rows, columns) float [grey levels]  of all cameras,
                                    in the rig's order
    vertices, triangles : (v, 3) float [m], (m, 3) int      the surface at the first instant
    settings : LangPaiSettings
    progress : callable             told what is done (text) and how far it is (0 to 1)

    Returns
    -------
    list of RangeFlow               one a later instant, at the pixels of the rectified reference
                                    that see the mesh. `gradient`, `noise` and `drift` are NaN: the
                                    method knows none. `through_last` is False, although every point
                                    goes through all instants: it never falls back. `bias` is the
                                    rounding to whole pixels, taken to be the same in every step
                                    since the first instant; `covariance` adds the scatter of the
                                    first disparities about the mesh

    Raises
    ------
    InputError                      fewer than two instants, a tuple that is not of the rig's
                                    cameras, pictures of several sizes
    CalibrationError                cameras that cannot be rectified, a mesh not in front of them

    Source
    ------
    Lang and Pai (2001), section 4.
    """
    _check_pictures(rig, pictures)
    say = progress or silent
    head = make_head(rig, common_shape(pictures))
    seen = _seen_mesh(head, vertices, triangles, settings.step)
    limits = _disparity_limits(head, vertices, triangles, settings.travel)
    say("instant 0: stereo", 0.0)
    first = make_instant(head, pictures[0], limits, settings=settings.stereo)
    track = _begun(first, seen, settings)
    rest = _rest(rig, head, first, seen, track)
    before, flows = first, []
    for k in range(1, len(pictures)):
        say(f"instant {k}: stereo and flow", k / len(pictures))
        after = make_instant(head, pictures[k], limits, settings=settings.stereo)
        track = _followed(head, before, after, track, settings)
        flows.append(_range_flow(rest, after, track, k, settings))
        before = after
    return flows


def _check_pictures(rig: Rig, pictures: Sequence[Sequence[Float[np.ndarray, "_ _"]]]) -> None:
    if len(pictures) < 2:
        raise InputError(f"there are {len(pictures)} instants; motion needs two or more")
    for k, instant in enumerate(pictures):
        if len(instant) != len(rig.cameras):
            raise InputError(
                f"instant {k} has {len(instant)} pictures; must be one of each camera:"
                f" {', '.join(camera.name for camera in rig.cameras)}"
            )


def _disparity_limits(
    head: StereoHead, vertices: Vertices, triangles: Triangles, travel: float
) -> tuple[float, float]:
    """Least and greatest disparity of the mesh, moved by a share of its size [px]."""
    used = vertices[triangles].reshape(-1, 3)
    pose = head.rectified.cameras[0].T_camera_object
    depth = used @ pose[2, :3] + pose[2, 3]
    room = travel * float(np.linalg.norm(np.ptp(used, axis=0)))
    # Not nearer than half of where it is: a camera that close sees nothing of the rest of it.
    nearest = max(float(depth.min()) - room, 0.5 * float(depth.min()))
    return head.parallax / (float(depth.max()) + room), head.parallax / nearest


def _seen_mesh(head: StereoHead, vertices: Vertices, triangles: Triangles, step: int) -> _Seen:
    """The points that are looked at: pixels of a grid that see the mesh."""
    camera = head.rectified.cameras[0]
    surface = surface_map(camera, head.canvas, vertices, triangles)
    begin = step // 2
    row, column = np.nonzero(surface.triangle[begin::step, begin::step] >= 0)
    row, column = begin + step * row, begin + step * column
    point = surface.point[row, column]
    corner = vertices[triangles[surface.triangle[row, column]]]
    along = corner[:, 1] - corner[:, 0]
    along = along / np.linalg.norm(along, axis=1)[:, None]
    normal = np.cross(along, corner[:, 2] - corner[:, 0])
    normal = normal / np.linalg.norm(normal, axis=1)[:, None]
    tangent = np.stack([along, np.cross(normal, along)], axis=1)
    return _Seen(np.stack([column, row], axis=1), point, tangent, head_disparity(head, point))


def _begun(first: Instant, seen: _Seen, settings: LangPaiSettings) -> _Track:
    """All pixels where they are, valid where stereo finds the surface of the mesh."""
    column, row = seen.pixel.T
    measured = first.disparity[row, column]
    n = len(measured)
    outcome = np.full(n, int(Outcome.VALID))
    with np.errstate(invalid="ignore"):
        outcome[~(np.abs(measured - seen.disparity) <= settings.surface_tolerance)] = int(
            Outcome.REPROJECTION
        )
    unknown = np.isnan(measured)
    flat = _contrast(first.pictures[0], settings.stereo.window)[row, column]
    outcome[unknown] = int(Outcome.HIDDEN)
    outcome[unknown & (flat < settings.stereo.contrast)] = int(Outcome.TEXTURE)
    nothing = np.full(n, np.nan)
    return _Track(seen.pixel, nothing, nothing.copy(), np.zeros(n, dtype=np.int64), outcome)


def _contrast(
    grey: Float[np.ndarray, "rows columns"], window: int
) -> Float[np.ndarray, "rows columns"]:
    """Standard deviation in the window around each pixel [grey levels]; NaN where not all known."""
    known = np.isfinite(grey)
    value = np.where(known, grey, 0.0).astype(np.float64)
    mean = cv2.blur(value, (window, window))
    square = cv2.blur(value**2, (window, window))
    whole = cv2.erode(known.astype(np.uint8), np.ones((window, window), dtype=np.uint8)) > 0
    return np.where(whole, np.sqrt(np.maximum(square - mean**2, 0.0)), np.nan)


def _followed(
    head: StereoHead, before: Instant, after: Instant, track: _Track, settings: LangPaiSettings
) -> _Track:
    """The pixels at the next instant; those that were rejected stay where they were."""
    rows = np.flatnonzero(track.outcome == Outcome.VALID)
    found = vote(
        before,
        after,
        head.views,
        track.pixel[rows],
        settings=VoteSettings(settings.subset, settings.search, settings.least_score),
    )
    result = {}
    for name in ("pixel", "score", "apart", "agreed", "outcome"):
        result[name] = getattr(track, name).copy()
        result[name][rows] = getattr(found, name)
    return _Track(**result)


def _rest(rig: Rig, head: StereoHead, first: Instant, seen: _Seen, track: _Track) -> _Rest:
    """Points and covariances at the first instant."""
    begun = track.outcome == Outcome.VALID
    disparity = first.disparity[seen.pixel[:, 1], seen.pixel[:, 0]]
    point = seen.point.copy()
    point[begun] = head_points(head, seen.pixel[begun], disparity[begun])
    slide, away = _pixel_footprints(head.rectified.cameras[0], seen, head.parallax)
    off = np.abs(disparity - seen.disparity)[begun]
    scatter = _FROM_MEDIAN * float(np.median(off)) if len(off) else 0.0
    return _Rest(
        rig=rig,
        head=head,
        pixel=project(rig.cameras[rig.reference], point),
        point=point,
        tangent=seen.tangent,
        # Errors of rounding are spread evenly over a pixel.
        rounding=np.einsum("nki,nkj->nij", slide, slide) / 12.0,
        noise=2.0 * scatter**2 * np.einsum("ni,nj->nij", away, away),
        shape=head.shape,
    )


def _range_flow(
    rest: _Rest, last: Instant, track: _Track, steps: int, settings: LangPaiSettings
) -> RangeFlow:
    """Displacement since the first instant, `steps` instants ago."""
    valid = track.outcome == Outcome.VALID
    displacement = np.full_like(rest.point, np.nan)
    column, row = track.pixel[valid].T
    now = head_points(rest.head, track.pixel[valid], last.disparity[row, column])
    displacement[valid] = now - rest.point[valid]
    bias = steps**2 * rest.rounding + np.where(valid, 0.0, np.nan)[:, None, None]
    return RangeFlow(
        pixel=rest.pixel,
        point=rest.point,
        tangent=rest.tangent,
        displacement=displacement,
        gradient=np.full(rest.tangent.shape, np.nan),
        covariance=bias + rest.noise,
        bias=bias,
        score=track.score,
        reprojection=track.apart,
        cameras=track.agreed,
        outcome=track.outcome,
        through_last=np.zeros(len(rest.point), dtype=bool),
        drift=np.nan,
        noise=np.full(len(rest.rig.cameras), np.nan),
        subset=settings.subset,
        step=settings.step,
        shape=rest.shape,
    )


def _pixel_footprints(
    camera: Camera, seen: _Seen, parallax: float
) -> tuple[Float[np.ndarray, "n 2 3"], Points]:
    """How the surface point of a pixel moves along the surface with its column and its row [m/px],
    and along its ray with the disparity [m/px].
    """
    turn = camera.T_camera_object[:3, :3]
    back = np.linalg.inv(camera.matrix)
    pixel = np.column_stack([seen.pixel, np.ones(len(seen.pixel))])
    ray = pixel @ back.T @ turn
    depth = parallax / seen.disparity
    normal = np.cross(seen.tangent[:, 0], seen.tangent[:, 1])
    facing = np.einsum("ni,ni->n", normal, ray)
    # A facet seen edge on has no footprint; one at a hundredth of a radian is as good as that.
    facing = np.where(np.abs(facing) < 0.01, np.copysign(0.01, facing), facing)
    across = back[:, :2].T @ turn
    nearer = normal @ across.T / facing[:, None]
    slide = depth[:, None, None] * (across - nearer[..., None] * ray[:, None])
    return slide, -(depth**2 / parallax)[:, None] * ray
