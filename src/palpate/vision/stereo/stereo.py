"""Points of the surface that two or more cameras see, without knowing where the surface is.

For every camera but the reference: a dense start, then windows matched to a hundredth of a pixel in
the pictures as they were taken. Where a window shows more than one smooth surface, smaller ones are
tried. What the cameras say is joined by triangulation; what contradicts its neighbours or the other
cameras is rejected and counted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.errors import InputError
from palpate.records import Rig
from palpate.shapes import PointIndices, Points, PointScalars, Triangles, Vertices
from palpate.vision.images import find_features, make_even_picture, make_spline_picture
from palpate.vision.range_flow import Outcome, grid_triangles
from palpate.vision.stereo.acceptance import contradicts_neighbours, joined_cameras
from palpate.vision.stereo.pair_disparity import make_view, stereo_start
from palpate.vision.stereo.window_matches import SMALLEST_WINDOW, WindowMatches, window_matches

# Length over width of what is seen at 80 degrees: flatter, it shows no texture to be matched.
_STEEPEST = 5.8


@dataclass(frozen=True, slots=True)
class StereoSettings:
    """How surface points are found from one instant's pictures.

    Parameters
    ----------
    subset : int [px]               side of the largest window, odd; windows down to 4/10 of it are
                                    taken where it shows edges of the object
    step : int [px]                 spacing of the points in the reference camera
    shape : "quadratic" or "affine" how the match may vary within a window; affine ones see a curved
                                    surface too near or too far
    excess : float                  a match is rejected where what it leaves is more than so many
                                    times what good ones leave
    disagreement : float            a match is rejected where neighbours or cameras contradict it by
                                    more than so many standard deviations
    reprojection : float [px]       and where a camera misses the joint point by more than this:
                                    half a speckle. A rig that fits worse shows different speckles
                                    in the windows of its cameras

    Raises
    ------
    InputError                      an even or tiny subset, a step below one pixel, limits that are
                                    not positive
    """

    subset: int = 21
    step: int = 5
    shape: Literal["affine", "quadratic"] = "quadratic"
    excess: float = 2.0
    disagreement: float = 5.0
    reprojection: float = 2.0

    def __post_init__(self) -> None:
        if self.subset < SMALLEST_WINDOW or self.subset % 2 == 0:
            raise InputError(
                f"subset is {self.subset}; must be an odd number of pixels, {SMALLEST_WINDOW} or"
                " more"
            )
        if self.step < 1:
            raise InputError(f"step is {self.step}; must be 1 pixel or more")
        for name in ("excess", "disagreement", "reprojection"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} is {getattr(self, name):g}; must be positive")


@dataclass(frozen=True, slots=True, eq=False)
class StereoPoints:
    """Points of the surface at one instant.

    Attributes
    ----------
    pixel : (n, 2) float [px]           column and row in the reference camera: middle of the window
    point : (n, 3) float [m]            that the windows of all cameras show, object frame; beside
                                        the ray of the pixel by as much as noise moved the windows
    covariance : (n, 3, 3) float [m^2]  from what the matches leave; the calibration's errors, alike
                                        for points side by side, are not in it
    score : (n,) float [-]              lowest normalised cross-correlation over the cameras used
    residual : (n,) float [px]          rms distance between the point and the matches, over the
                                        cameras and both coordinates
    cameras : (n,) int                  how many agree, the reference included
    window : (n,) int [px]              side of the smallest window used
    spacing : (n,) float [m]            width of a step of the grid there, across the line of sight
    counts : (8,) int                   points of the grid by `Outcome`; the first is n
    step : int [px]                     spacing of the grid
    shape : (rows, columns)             of the reference camera's picture
    """

    pixel: Float[np.ndarray, "n 2"]
    point: Points
    covariance: Float[np.ndarray, "n 3 3"]
    score: PointScalars
    residual: PointScalars
    cameras: PointIndices
    window: PointIndices
    spacing: PointScalars
    counts: Int[np.ndarray, "8"]
    step: int
    shape: tuple[int, int]


def stereo_points(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    *,
    mask: Bool[np.ndarray, "rows columns"] | None = None,
    depth_range: tuple[float, float] | None = None,
    settings: StereoSettings = StereoSettings(),
) -> StereoPoints:
    """Find the points of the surface that the reference camera and another one see.

    Parameters
    ----------
    rig : Rig                       c cameras, 2 or more
    pictures : sequence of c (rows, columns) float [grey levels]    of one instant
    mask : (rows, columns) bool or None     pixels of the reference camera that matter; all of them
                                    unless told
    depth_range : (near, far) [m] or None   where the object is, along the reference camera's axis;
                                    found from features of the pictures unless told
    settings : StereoSettings

    Returns
    -------
    StereoPoints                    does not depend on the number of threads

    Raises
    ------
    InputError                      another number of pictures, a mask of another size, a depth
                                    range that is none; no camera shares features with the reference
    CalibrationError                no camera can be paired with the reference: at one place, or
                                    looking along the line between
    """
    _check(rig, pictures, mask, depth_range)
    even = [make_even_picture(picture) for picture in pictures]
    views = [
        make_view(camera, picture, find_features(picture))
        for camera, picture in zip(rig.cameras, even, strict=True)
    ]
    splines = [make_spline_picture(picture) for picture in pictures]
    reference = rig.reference
    asked = np.ones(pictures[reference].shape, dtype=bool) if mask is None else mask
    cell, pixel = _grid(asked & even[reference].textured, settings.step)
    blank = len(_grid(asked, settings.step)[0]) - len(pixel)
    found: dict[int, WindowMatches] = {}
    failures: list[InputError] = []
    for k, view in enumerate(views):
        if k == reference:
            continue
        try:
            start = stereo_start(
                views[reference], view, pixel, half=settings.subset // 2, depth_range=depth_range
            )
        except InputError as failure:
            failures.append(failure)
            continue
        matches = window_matches(
            splines[reference],
            splines[k],
            pixel,
            start,
            subset=settings.subset,
            shape=settings.shape,
            excess=settings.excess,
        )
        found[k] = _confirmed(matches, cell, pixel, settings.disagreement)
    if not found:
        raise failures[0]
    return _joined(rig, found, pixel, blank, settings, pictures[reference].shape)


def triangulated_surface(stereo: StereoPoints) -> tuple[Vertices, Triangles]:
    """Stereo points joined to an open surface that faces the reference camera.

    Parameters
    ----------
    stereo : StereoPoints           n points

    Returns
    -------
    vertices : (n, 3) float [m]     all points, also those of no triangle
    triangles : (m, 3) int          two for every cell of the grid whose corners are all there and
                                    none of whose sides is a jump, steeper than 80 degrees
    """
    triangles = grid_triangles(stereo.pixel, stereo.step)
    corner = stereo.point[triangles]
    side = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)
    # One of the sides is the diagonal of the cell.
    flat = stereo.spacing[triangles] * np.sqrt(2.0)
    whole = (side <= _STEEPEST * flat).all(axis=1)
    # Both halves of a cell, or none.
    both = whole.reshape(2, -1).all(axis=0)
    return stereo.point, triangles.reshape(2, -1, 3)[:, both].reshape(-1, 3)


def _check(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    mask: Bool[np.ndarray, "rows columns"] | None,
    depth_range: tuple[float, float] | None,
) -> None:
    if len(pictures) != len(rig.cameras):
        raise InputError(f"{len(pictures)} pictures for {len(rig.cameras)} cameras; give one each")
    shape = pictures[rig.reference].shape
    if mask is not None and mask.shape != shape:
        raise InputError(f"mask is of {mask.shape} pixels; the reference picture of {shape}")
    if depth_range is not None and not 0.0 < depth_range[0] < depth_range[1]:
        raise InputError(
            f"depth_range is {depth_range}; must be two distances from the reference camera in"
            " metres, near and far"
        )


def _grid(
    wanted: Bool[np.ndarray, "rows columns"], step: int
) -> tuple[Int[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Row and column on the grid, and column and row in the picture, of the points that matter."""
    first = step // 2
    cell = np.argwhere(wanted[first::step, first::step])
    return cell, (first + step * cell[:, ::-1]).astype(np.float64)


def _confirmed(
    matches: WindowMatches,
    cell: Int[np.ndarray, "n 2"],
    pixel: Float[np.ndarray, "n 2"],
    disagreement: float,
) -> WindowMatches:
    """Matches without those that their neighbours contradict."""
    wrong = contradicts_neighbours(
        cell,
        pixel,
        matches.displacement,
        matches.gradient,
        np.sqrt(np.trace(matches.covariance, axis1=1, axis2=2)),
        matches.outcome == Outcome.VALID,
        disagreement=disagreement,
    )
    outcome = np.where(wrong, int(Outcome.NEIGHBOURS), matches.outcome)
    displacement = np.where(wrong[:, None], np.nan, matches.displacement)
    return replace(matches, displacement=displacement, outcome=outcome)


def _joined(
    rig: Rig,
    found: dict[int, WindowMatches],
    pixel: Float[np.ndarray, "n 2"],
    blank: int,
    settings: StereoSettings,
    shape: tuple[int, int],
) -> StereoPoints:
    """One point from the matches of all cameras."""
    others = list(found)
    # The reason of the camera that came farthest: the outcomes are in the order of the steps.
    outcome = np.max([found[k].outcome for k in others], axis=0)
    matched = np.flatnonzero(
        np.any([np.isfinite(found[k].displacement[:, 0]) for k in others], axis=0)
    )
    outcome[matched] = Outcome.REPROJECTION
    pixels = np.full((len(rig.cameras), len(matched), 2), np.nan)
    covariance = np.full((*pixels.shape, 2), np.nan)
    pixels[rig.reference] = pixel[matched]
    for k in others:
        pixels[k] = pixel[matched] + found[k].displacement[matched]
        covariance[k] = found[k].covariance[matched]
    joint, used = joined_cameras(
        rig,
        pixels,
        covariance,
        disagreement=settings.disagreement,
        reprojection=settings.reprojection,
    )
    good = used.any(axis=0)
    rows, mine = matched[good], used[others][:, good]
    outcome[rows] = Outcome.VALID
    counts = np.bincount(outcome, minlength=len(Outcome))
    counts[Outcome.TEXTURE] += blank
    score = np.where(mine, np.stack([found[k].score[rows] for k in others]), np.inf)
    window = np.where(mine, np.stack([found[k].window[rows] for k in others]), settings.subset)
    camera = rig.cameras[rig.reference]
    pose = camera.T_camera_object
    depth = joint.point[good] @ pose[2, :3] + pose[2, 3]
    return StereoPoints(
        pixel=pixel[rows],
        point=joint.point[good],
        covariance=joint.covariance[good],
        score=score.min(axis=0, initial=np.inf),
        residual=joint.residual[good],
        cameras=joint.cameras[good],
        window=window.min(axis=0, initial=settings.subset),
        spacing=settings.step * depth / camera.matrix[0, 0],
        counts=counts,
        step=settings.step,
        shape=shape,
    )
