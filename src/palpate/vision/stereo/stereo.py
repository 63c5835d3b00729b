"""Stereo points: surface points seen by two or more cameras, without prior knowledge of the shape.

For every camera except the reference: a dense start, then windows matched to a hundredth of a pixel
in the original pictures. Where a window covers more than one smooth surface, a smaller one is used.
The matches of all cameras are triangulated; those that contradict their neighbours or the other
cameras are rejected and counted.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.arrays import STD_OVER_MEDIAN
from palpate.errors import InputError
from palpate.geometry import (
    Registration,
    TriangleMesh,
    bounding_diagonal,
    refined_surface,
    register,
)
from palpate.records import Rig, camera_centre
from palpate.shapes import PointIndices, Points, PointScalars
from palpate.vision.matching.features import PreparedPictures
from palpate.vision.projection import pixel_sizes, project
from palpate.vision.range_flow import Outcome
from palpate.vision.spline import make_spline_picture
from palpate.vision.stereo.pair_disparity import stereo_start
from palpate.vision.stereo.window_matches import (
    MIN_WINDOW_PX,
    WindowMatches,
    confirmed_matches,
    window_matches,
)
from palpate.vision.triangulation import Triangulation, triangulate

# A camera is dropped if its reprojection error exceeds this many standard deviations.
_MAX_DEVIATIONS = 5.0
# Fewer points do not determine a pose.
MIN_POSE_POINTS = 50
# Points farther than this from the centre of the mesh, in diagonals, belong to table or background.
_REACH = 0.6
# Subdivisions of a mesh edge: the cameras see its smooth surface, not its facets.
_PIECES = 2


@dataclass(frozen=True, slots=True)
class StereoSettings:
    """Settings for finding surface points from one instant's pictures.

    Parameters
    ----------
    subset : int [px]               side of the largest window, odd, at least 9; windows down to
                                    0.43 of it are used where it covers edges of the object
    step : int [px]                 spacing of the points in the reference camera, at least 1
    reprojection : float [px]       largest reprojection error of a match, > 0; the default is half
                                    a speckle: with a larger error the windows of the cameras show
                                    different speckles

    Raises
    ------
    InputError                      the subset is even or below 9, the step below 1, or
                                    `reprojection` not positive
    """

    subset: int = 21
    step: int = 5
    reprojection: float = 2.0

    def __post_init__(self) -> None:
        if self.subset < MIN_WINDOW_PX or self.subset % 2 == 0:
            raise InputError(
                f"subset is {self.subset}; must be an odd number of pixels, {MIN_WINDOW_PX} or more"
            )
        if self.step < 1:
            raise InputError(f"step is {self.step}; must be 1 pixel or more")
        if not self.reprojection > 0.0:
            raise InputError(f"reprojection is {self.reprojection:g}; must be positive")


@dataclass(frozen=True, slots=True, eq=False)
class StereoPoints:
    """Points of the surface at one instant.

    Attributes
    ----------
    pixel : (n, 2) float [px]           column and row of the window's centre in the reference
    point : (n, 3) float [m]            triangulated from all cameras that agree, object frame; off
                                        the ray of the pixel by the noise of the matches
    covariance : (n, 3, 3) float [m^2]  from the residuals of the matches, without the errors of the
                                        calibration, which neighbouring points share
    residual : (n,) float [px]          rms reprojection error over the cameras and coordinates
    cameras : (n,) int                  number of cameras that agree, including the reference
    spacing : (n,) float [m]            size of a grid step there, across the line of sight
    counts : (8,) int                   number of grid points by `Outcome`; the first entry is n
    step : int [px]                     spacing of the grid
    """

    pixel: Float[np.ndarray, "n 2"]
    point: Points
    covariance: Float[np.ndarray, "n 3 3"]
    residual: PointScalars
    cameras: PointIndices
    spacing: PointScalars
    counts: Int[np.ndarray, "8"]
    step: int


@dataclass(frozen=True, slots=True, eq=False)
class StereoMatches:
    """Matches of a grid of points in the reference camera's picture in all other cameras.

    They can be used to assess a rig: they depend on the pictures alone, and the rig's poses only
    determine where to search.

    Attributes
    ----------
    pixel : (n, 2) float [px]           column and row in the reference camera
    pixels : (c, n, 2) float [px]       in every camera; NaN where not found
    covariance : (c, n, 2, 2) float [px^2]  of the match; NaN where not found, and in the reference
    outcome : (n,) int                  VALID where a camera matched the point, else the largest
                                        `Outcome` over the cameras
    untextured : int                    number of grid points without texture, not among the n
    """

    pixel: Float[np.ndarray, "n 2"]
    pixels: Float[np.ndarray, "c n 2"]
    covariance: Float[np.ndarray, "c n 2 2"]
    outcome: PointIndices
    untextured: int


def stereo_matches(
    pictures: PreparedPictures,
    *,
    mask: Bool[np.ndarray, "rows columns"] | None = None,
    settings: StereoSettings = StereoSettings(),
) -> StereoMatches:
    """Match a grid of windows of the reference camera in all others.

    Parameters
    ----------
    pictures : PreparedPictures     of 2 or more cameras
    mask, settings                  as for `stereo_points`

    Returns
    -------
    StereoMatches

    Raises
    ------
    InputError, CalibrationError    as for `stereo_points`
    """
    reference = pictures.rig.reference
    shape = pictures.grey[reference].shape
    wanted = np.ones(shape, dtype=bool) if mask is None else mask
    if wanted.shape != shape:
        raise InputError(f"mask is of {wanted.shape} pixels; the reference picture of {shape}")
    cell, pixel = _grid(wanted & pictures.normalised[reference].textured, settings.step)
    untextured = len(_grid(wanted, settings.step)[0]) - len(pixel)
    splines = [make_spline_picture(grey) for grey in pictures.grey]
    by_camera: dict[int, WindowMatches] = {}
    failures: list[InputError] = []
    for k, spline in enumerate(splines):
        if k == reference:
            continue
        try:
            start = stereo_start(pictures, k, pixel, half=settings.subset // 2)
        except InputError as failure:
            failures.append(failure)
            continue
        matches = window_matches(splines[reference], spline, pixel, start, subset=settings.subset)
        by_camera[k] = confirmed_matches(matches, cell, pixel)
    if not by_camera:
        raise failures[0]
    outcomes = np.stack([matches.outcome for matches in by_camera.values()])
    # Causes are roughly in the order of the steps: the largest is that of the camera that got
    # farthest.
    matched = (outcomes == Outcome.VALID).any(axis=0)
    outcome = np.where(matched, int(Outcome.VALID), outcomes.max(axis=0))
    pixels = np.full((len(splines), len(pixel), 2), np.nan)
    covariance = np.full((*pixels.shape, 2), np.nan)
    pixels[reference] = pixel
    for k, matches in by_camera.items():
        pixels[k] = pixel + matches.displacement
        covariance[k] = matches.covariance
    return StereoMatches(pixel, pixels, covariance, outcome, untextured)


def stereo_points(
    pictures: PreparedPictures,
    *,
    mask: Bool[np.ndarray, "rows columns"] | None = None,
    settings: StereoSettings = StereoSettings(),
) -> StereoPoints:
    """Find the surface points seen by the reference camera and at least one other.

    Parameters
    ----------
    pictures : PreparedPictures     of 2 or more cameras
    mask : (rows, columns) bool or None     pixels of interest in the reference camera; None: all
    settings : StereoSettings

    Returns
    -------
    StereoPoints                    independent of the number of threads

    Raises
    ------
    InputError                      a mask of another size; no camera shares features with the
                                    reference
    CalibrationError                no camera can be rectified with the reference: the centres
                                    coincide, or the cameras look along their baseline
    """
    matches = stereo_matches(pictures, mask=mask, settings=settings)
    return triangulated_matches(pictures.rig, matches, settings=settings)


def triangulate_consistent(
    rig: Rig,
    pixels: Float[np.ndarray, "c n 2"],
    covariance: Float[np.ndarray, "c n 2 2"],
    *,
    reprojection: float,
) -> tuple[Triangulation, Bool[np.ndarray, "c n"]]:
    """Triangulate without cameras that contradict the others; if two disagree, use neither.

    The matches of all cameras are with one reference picture and share its noise, so half of their
    variance is assigned to the reference.

    Parameters
    ----------
    rig : Rig
    pixels : (c, n, 2) float [px]   NaN where a camera does not see the point; the reference's are
                                    whole numbers
    covariance : (c, n, 2, 2) float [px^2]  of the match of each camera; the reference's is ignored
    reprojection : float [px]       largest reprojection error of a camera

    Returns
    -------
    triangulation : Triangulation   from the cameras used; covariance from that of the matches
    used : (c, n) bool              all False for points on which no two cameras agree
    """
    used = np.isfinite(pixels).all(axis=2)
    for _ in range(len(pixels) - 1):
        points, error = _triangulated(rig, pixels, covariance, used)
        excess = _excess(error, used, covariance, reprojection)
        excess[rig.reference] = -np.inf
        wrong = excess.max(axis=0) > 1.0
        lost = used.any(axis=0) & ~np.isfinite(points.point).all(axis=1)
        too_few = used.sum(axis=0) <= 2
        if not (wrong | lost).any():
            break
        drop = np.flatnonzero(wrong & ~too_few)
        used[excess.argmax(axis=0)[drop], drop] = False
        used[:, (wrong & too_few) | lost] = False
    points, _ = _triangulated(rig, pixels, covariance, used)
    return points, used


def _triangulated(
    rig: Rig,
    pixels: Float[np.ndarray, "c n 2"],
    covariance: Float[np.ndarray, "c n 2 2"],
    used: Bool[np.ndarray, "c n"],
) -> tuple[Triangulation, Float[np.ndarray, "c n 2"]]:
    """Triangulated points and the reprojection error of each camera [px]."""
    others = used.copy()
    others[rig.reference] = False
    half = np.where(others[..., None, None], 0.5 * covariance, 0.0)
    half[rig.reference] = half.sum(axis=0) / np.maximum(others.sum(axis=0), 1)[:, None, None]
    half = np.where(used[..., None, None], half, np.eye(2))
    pixels = np.where(used[..., None], pixels, np.nan)
    points = triangulate(rig, pixels, half)
    return points, pixels - np.stack([project(camera, points.point) for camera in rig.cameras])


def _excess(
    error: Float[np.ndarray, "c n 2"],
    used: Bool[np.ndarray, "c n"],
    covariance: Float[np.ndarray, "c n 2 2"],
    reprojection: float,
) -> Float[np.ndarray, "c n"]:
    """Reprojection error of each camera relative to what is allowed; -inf where not used.

    The median error over all points of a camera is due to the rig: only `reprojection` limits it.
    """
    excess = np.full(used.shape, -np.inf)
    for c in range(len(used)):
        known = used[c] & np.isfinite(error[c]).all(axis=1)
        if not known.any():
            continue
        residual = error[c, known]
        distance = np.linalg.norm(residual - np.median(residual, axis=0), axis=1)
        noise = np.trace(covariance[c, known], axis1=1, axis2=2)
        allowed = _MAX_DEVIATIONS * np.sqrt((STD_OVER_MEDIAN * np.median(distance)) ** 2 + noise)
        excess[c, known] = np.maximum(
            distance / allowed, np.linalg.norm(residual, axis=1) / reprojection
        )
    return excess


def _grid(
    wanted: Bool[np.ndarray, "rows columns"], step: int
) -> tuple[Int[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Row and column on the grid, and column and row in the picture, of the wanted points."""
    first = step // 2
    cell = np.argwhere(wanted[first::step, first::step])
    return cell, (first + step * cell[:, ::-1]).astype(np.float64)


def triangulated_matches(
    rig: Rig, matches: StereoMatches, *, settings: StereoSettings = StereoSettings()
) -> StereoPoints:
    """Triangulate the matches of all cameras.

    Parameters
    ----------
    rig : Rig
    matches : StereoMatches         of its cameras
    settings : StereoSettings       with which they were made

    Returns
    -------
    StereoPoints
    """
    outcome = matches.outcome.copy()
    rows = np.flatnonzero(outcome == Outcome.VALID)
    outcome[rows] = Outcome.REPROJECTION
    joint, used = triangulate_consistent(
        rig, matches.pixels[:, rows], matches.covariance[:, rows],
        reprojection=settings.reprojection,
    )  # fmt: skip
    good = used.any(axis=0)
    outcome[rows[good]] = Outcome.VALID
    counts = np.bincount(outcome, minlength=len(Outcome))
    counts[Outcome.TEXTURE] += matches.untextured
    return StereoPoints(
        pixel=matches.pixel[rows[good]],
        point=joint.point[good],
        covariance=joint.covariance[good],
        residual=joint.residual[good],
        cameras=joint.cameras[good],
        spacing=settings.step * pixel_sizes(rig.cameras[rig.reference], joint.point[good]),
        counts=counts,
        step=settings.step,
    )


def smooth_surface(mesh: TriangleMesh) -> TriangleMesh:
    """The smooth surface through a mesh's vertices, finely triangulated, as the cameras see it.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    TriangleMesh
    """
    return TriangleMesh(*refined_surface(mesh, pieces=_PIECES))


def near_object(
    points: Points, mesh: TriangleMesh, pose: Float[np.ndarray, "4 4"] | None = None
) -> Bool[np.ndarray, " n"]:
    """Points that may belong to the object at a given pose.

    Parameters
    ----------
    points : (n, 3) float [m]       the rig's object frame
    mesh : TriangleMesh
    pose : (4, 4) float [m] or None x_mesh = pose x_points; None: the frames coincide

    Returns
    -------
    (n,) bool
    """
    position = points if pose is None else points @ pose[:3, :3].T + pose[:3, 3]
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    distance = np.linalg.norm(position - middle, axis=1)
    return np.asarray(distance < _REACH * bounding_diagonal(mesh))


def register_object(
    rig: Rig,
    stereo: StereoPoints,
    smooth: TriangleMesh,
    *,
    start: Float[np.ndarray, "4 4"] | None = None,
) -> Registration | None:
    """Register the points near an object to its surface.

    Parameters
    ----------
    rig : Rig                       that measured the points
    stereo : StereoPoints
    smooth : TriangleMesh           from `smooth_surface`
    start : (4, 4) float [m] or None    x_mesh = start x_points; None: the frames coincide

    Returns
    -------
    Registration or None            None where fewer than `MIN_POSE_POINTS` lie near the object
    """
    near = near_object(stereo.point, smooth, start)
    if near.sum() < MIN_POSE_POINTS:
        return None
    return register(
        stereo.point[near], stereo.covariance[near], smooth, start=start,
        viewpoint=camera_centre(rig.cameras[rig.reference]),
    )  # fmt: skip


def object_frame(rig: Rig, registration: Registration) -> Rig:
    """Transform the rig to the frame of the mesh that its points were registered to.

    Parameters
    ----------
    rig : Rig
    registration : Registration     of its points

    Returns
    -------
    Rig
    """
    # x_camera = T_camera_object x_object; the points were measured in the rig's own object frame.
    back = np.linalg.inv(registration.T_mesh_points)
    cameras = tuple(
        replace(camera, T_camera_object=camera.T_camera_object @ back) for camera in rig.cameras
    )
    return replace(rig, cameras=cameras)
