"""Points of a surface from the pictures of one instant, without a mesh and without seeds.

The pictures of the reference camera and of each other camera are rectified only to find where a
window may be; the window itself is matched in the pictures as they are, with the slope that the
start has, and the matches of a pixel in all cameras are triangulated with their covariances.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from palpate.errors import CalibrationError
from palpate.records import Camera, Rig
from palpate.shapes import PointIndices, Points, PointScalars, Triangles, Vertices
from palpate.vision.camera import project, rays
from palpate.vision.dense_start import dense_start
from palpate.vision.even_picture import make_even_picture
from palpate.vision.interpolation import SplinePicture, spline_pictures
from palpate.vision.planar_field import planar_field
from palpate.vision.planar_refinement import PlanarSettings, refine_planar
from palpate.vision.rectification import rectify_pair, remapped
from palpate.vision.sparse_motion import feature_matches
from palpate.vision.tracking import grid_triangles
from palpate.vision.triangulation import triangulate

__all__ = ["StereoPoints", "StereoSettings", "stereo_points", "triangulated_surface"]

# A start farther than this from its epipolar line is a mistake of the search, not of the rig [px].
_OFF_LINE = 3.0
# Cells whose corners differ in depth by more than this many times their width are a jump.
_JUMP = 5.0


@dataclass(frozen=True, slots=True)
class StereoSettings:
    """How points of the surface are found.

    Parameters
    ----------
    subset : int [px]               side of the window, odd; views differ, so more than for motion
    step : int [px]                 spacing of the points in the reference camera
    smoothing : float [px]          Gaussian low-pass of the pictures
    least_score : float             normalised cross-correlation below which a match is none
    disagreement : float            points whose rays miss each other by more than so many times the
                                    median are rejected
    rig_error : float [px]          misses that are the rig's and not the matches', added to them
    """

    subset: int = 31
    step: int = 5
    smoothing: float = 0.8
    least_score: float = 0.8
    disagreement: float = 5.0
    rig_error: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class StereoPoints:
    """Points of the surface that at least two cameras see.

    Attributes
    ----------
    pixel : (n, 2) float [px]       column and row in the reference camera
    point : (n, 3) float [m]        object frame
    covariance : (n, 3, 3) float [m^2]
    score : (n,) float [-]          lowest normalised cross-correlation
    residual : (n,) float [px]      rms by which the rays miss the pixels
    cameras : (n,) int              that agree
    step : int [px]                 spacing of the pixels
    searched : int                  pixels with texture that were looked at; n of them were found
    """

    pixel: Float[np.ndarray, "n 2"]
    point: Points
    covariance: Float[np.ndarray, "n 3 3"]
    score: PointScalars
    residual: PointScalars
    cameras: PointIndices
    step: int
    searched: int


def stereo_points(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    *,
    settings: StereoSettings = StereoSettings(),
) -> StereoPoints:
    """Points of the surface on a grid of the reference camera's pixels.

    Parameters
    ----------
    rig : Rig
    pictures : sequence of c (rows, columns) float [grey levels]    of one instant
    settings : StereoSettings

    Returns
    -------
    StereoPoints

    Raises
    ------
    CalibrationError                no camera shares a view with the reference camera
    """
    pixel = _textured_grid(pictures[rig.reference], settings)
    splines = spline_pictures(pictures, settings.smoothing)
    target = np.full((len(rig.cameras), len(pixel), 2), np.nan)
    covariance = np.full((len(rig.cameras), len(pixel), 2, 2), np.nan)
    score = np.full((len(rig.cameras), len(pixel)), np.nan)
    target[rig.reference] = pixel
    covariance[rig.reference] = settings.rig_error**2 * np.eye(2)
    for c, picture in enumerate(pictures):
        if c == rig.reference:
            continue
        start = _pair_start(
            rig.cameras[rig.reference], rig.cameras[c], pictures[rig.reference], picture, pixel
        )
        match = _matched(splines[rig.reference], splines[c], pixel, start, settings)
        target[c], covariance[c], score[c] = match
    return _judged(rig, pixel, target, covariance, score, settings)


def triangulated_surface(stereo: StereoPoints) -> tuple[Vertices, Triangles]:
    """Stereo points joined to an open surface, along the grid of their pixels.

    Parameters
    ----------
    stereo : StereoPoints

    Returns
    -------
    vertices : (n, 3) float [m]     all points, also those of no triangle
    triangles : (m, 3) int          two for every cell whose corners are all there and on one part
                                    of the object
    """
    triangles = grid_triangles(stereo.pixel, stereo.step)
    corner = stereo.point[triangles]
    side = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)
    usual = np.median(side) if len(side) else 0.0
    return stereo.point, triangles[side.max(axis=1, initial=0.0) < _JUMP * usual]


def _textured_grid(
    picture: Float[np.ndarray, "rows columns"], settings: StereoSettings
) -> Float[np.ndarray, "n 2"]:
    """Pixels of the grid whose window has texture and lies in the picture."""
    rows, columns = picture.shape
    edge = settings.subset // 2 + 1
    row, column = np.meshgrid(
        np.arange(edge, rows - edge, settings.step),
        np.arange(edge, columns - edge, settings.step),
        indexing="ij",
    )
    some = make_even_picture(picture).textured[row, column]
    return np.stack([column[some], row[some]], axis=1).astype(np.float64)


def _pair_start(
    reference: Camera,
    other: Camera,
    first: Float[np.ndarray, "_ _"],
    second: Float[np.ndarray, "_ _"],
    pixel: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n 2"]:
    """Where pixels of the reference picture may be in another camera's; NaN where nowhere."""
    pair = rectify_pair(reference, other, first.shape)
    left, right = (np.nan_to_num(remapped(pair, k, one)) for k, one in ((0, first), (1, second)))
    area = [np.isfinite(remapped(pair, k, one)) for k, one in ((0, first), (1, second))]
    found = feature_matches(
        make_even_picture(left).even, make_even_picture(right).even, area[0], area[1]
    )
    if len(found.point) == 0:
        return np.full(pixel.shape, np.nan)
    shift = np.rint(np.median(found.displacement, axis=0))
    size = left.shape[::-1]
    moved = cv2.warpAffine(right, np.array([[1.0, 0.0, -shift[0]], [0.0, 1.0, -shift[1]]]), size)
    start = dense_start(left, moved, mask=area[0])
    at = _seen_by(reference, pair.cameras[0], pixel)
    flow = _sampled(start.flow, at)
    sure = _sampled(start.trusted.astype(np.float32)[..., None], at)[:, 0] > 0.5
    axis = pair.axis[0]
    off = np.abs(flow[:, 1 - axis] - np.median(flow[sure, 1 - axis]) if sure.any() else flow[:, 0])
    place = np.where((sure & (off < _OFF_LINE))[:, None], at + flow + shift, np.nan)
    return _seen_by(pair.cameras[1], other, place)


def _seen_by(
    source: Camera, target: Camera, pixel: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Pixels of a camera as another camera at the same place sees them; NaN stays NaN."""
    result = np.full(pixel.shape, np.nan)
    known = np.isfinite(pixel).all(axis=1)
    if known.any():
        eye, direction = rays(source, pixel[known])
        result[known] = project(target, eye + direction)
    return result


def _sampled(
    field: Float[np.ndarray, "rows columns k"], pixel: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n k"]:
    """Bilinear values of a field; zero outside."""
    place = np.nan_to_num(pixel, nan=-1e4).astype(np.float32)[None]
    planes = [
        cv2.remap(np.ascontiguousarray(field[..., k]), place, None, cv2.INTER_LINEAR)[0]
        for k in range(field.shape[2])
    ]
    return np.stack(planes, axis=1).astype(np.float64)


def _matched(
    reference: SplinePicture,
    other: SplinePicture,
    pixel: Float[np.ndarray, "n 2"],
    start: Float[np.ndarray, "n 2"],
    settings: StereoSettings,
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"], PointScalars]:
    """Place, its covariance and score in another camera, by windows with their own slope."""
    away = start - pixel
    good = np.isfinite(away).all(axis=1)
    value, gradient = planar_field(pixel, away, good, settings.subset)
    planar = PlanarSettings(subset=settings.subset, shape="quadratic", reach=6.0)
    match = refine_planar(reference, other, pixel, value, start_gradient=gradient, settings=planar)
    fine = match.converged & (match.score > settings.least_score)
    place = np.where(fine[:, None], pixel + match.displacement, np.nan)
    spread = match.covariance + settings.rig_error**2 * np.eye(2)
    return place, np.where(fine[:, None, None], spread, np.nan), match.score


def _judged(
    rig: Rig,
    pixel: Float[np.ndarray, "n 2"],
    target: Float[np.ndarray, "c n 2"],
    covariance: Float[np.ndarray, "c n 2 2"],
    score: Float[np.ndarray, "c n"],
    settings: StereoSettings,
) -> StereoPoints:
    """Triangulate, and keep the points whose rays meet as well as the others' do."""
    found = triangulate(rig, target, covariance)
    known = np.isfinite(found.point).all(axis=1)
    if not known.any():
        raise CalibrationError(
            f"{rig.source}: not one of {len(pixel)} windows of camera"
            f" '{rig.cameras[rig.reference].name}' is found in another camera's picture where the"
            " rig expects it; are the pictures of the cameras swapped, or is the rig another one?"
        )
    usual = float(np.median(found.residual[known]))
    good = known & (found.residual < settings.disagreement * max(usual, settings.rig_error))
    lowest = np.nanmin(np.where(np.isfinite(score), score, np.inf), axis=0)
    return StereoPoints(
        pixel=pixel[good],
        point=found.point[good],
        covariance=found.covariance[good],
        score=lowest[good],
        residual=found.residual[good],
        cameras=found.cameras[good],
        step=settings.step,
        searched=len(pixel),
    )
