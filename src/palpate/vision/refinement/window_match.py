"""What a refinement takes and gives."""

from collections import namedtuple
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.vision.range_flow.flow import Outcome
from palpate.vision.refinement.scene import Scene

# Outcomes as plain integers, for the kernels.
VALID = int(Outcome.VALID)
HIDDEN = int(Outcome.HIDDEN)
TEXTURE = int(Outcome.TEXTURE)
OUTSIDE = int(Outcome.OUTSIDE)
LOST = int(Outcome.LOST)
# Blocks along a side of a window whose residuals are treated as mutually independent.
BLOCKS = 3
# What all kernels take of the first instant: tuples of `padded_to_four` arrays, see `Scene`; but
# the packed cameras (c, 25) and the blur variance (c,) [px^2].
FirstInstant = namedtuple(
    "FirstInstant", "cameras grey along_column along_row surface interior blur_variance"
)
# Points to track: (n, 3) [m], (n, 2, 3) tangents, (n,) half side of a window on the surface [m].
SurfacePoints = namedtuple("SurfacePoints", "point tangent half_window")


class Limits(NamedTuple):
    """Settings of the match of a window.

    Attributes
    ----------
    half : int [px]                 half the side of a window, rounded down
    bases : 1, 3 or 6               terms of the shape function that are free: shift, affine,
                                    quadratic
    iterations : int                largest number of iterations
    shading : bool                  whether the gain may vary linearly over a window: a moving
                                    object rotates in the light, tools cast soft shadows
    tolerance : float [px]          the iteration ends when a step is shorter; far below the noise
    reach : float [px]              a window that moves farther than this from its start is lost
    min_fraction : float            fraction of the window that must show the surface at rest
    """

    half: int
    bases: int = 3
    iterations: int = 25
    shading: bool = True
    tolerance: float = 1e-3
    reach: float = 6.0
    min_fraction: float = 0.6


class Match(NamedTuple):
    """Motion of n points from the pictures of c cameras; NaN where not found.

    Attributes
    ----------
    motion : (n, 6, 3) float [m]        u, its derivatives along the tangents times the half window,
                                        its second-order terms times the square of that
    covariance : (n, 3, 3) float [m^2]  of u for white noise of the given standard deviations
    score : (n, c) float                normalised cross-correlation
    residual_variance : (n, c) float [grey levels^2] residual variance
    own_step : (n, c, 2) float [px]     further step that each camera alone would take
    own_variance : (n, c) float [px^2]  variance of `own_step` per component
    variance_ratio : (n,) float [-]     ratio of the variance of u from the residuals in blocks
                                        (sandwich estimate) to that from white residuals
    cameras : (n, c) bool               cameras to use, as given
    outcome : (n,) int                  VALID, HIDDEN, TEXTURE, OUTSIDE or LOST
    """

    motion: Float[np.ndarray, "n 6 3"]
    covariance: Float[np.ndarray, "n 3 3"]
    score: Float[np.ndarray, "n c"]
    residual_variance: Float[np.ndarray, "n c"]
    own_step: Float[np.ndarray, "n c 2"]
    own_variance: Float[np.ndarray, "n c"]
    variance_ratio: Float[np.ndarray, " n"]
    cameras: Bool[np.ndarray, "n c"]
    outcome: Int[np.ndarray, " n"]


def first_instant(scene: Scene) -> FirstInstant:
    """The arrays of a scene that the kernels take.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    FirstInstant
    """
    pictures = scene.pictures
    return FirstInstant(
        scene.packed,
        padded_to_four([picture.grey for picture in pictures]),
        padded_to_four([picture.along_column for picture in pictures]),
        padded_to_four([picture.along_row for picture in pictures]),
        padded_to_four(scene.surface),
        padded_to_four(scene.interior),
        scene.blur_variance,
    )


def padded_to_four(arrays: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """The arrays of all cameras as a tuple, padded to four with the first one.

    A kernel is recompiled for every length of a tuple, which takes many seconds.

    Parameters
    ----------
    arrays : sequence of c arrays

    Returns
    -------
    tuple of four arrays            more where there are more cameras
    """
    return (*arrays, *[arrays[0]] * (4 - len(arrays)))


def surface_points(scene: Scene, rows: Int[np.ndarray, " n"]) -> SurfacePoints:
    """Some points of a scene, as the kernels take them.

    Parameters
    ----------
    scene : Scene
    rows : (n,) int

    Returns
    -------
    SurfacePoints
    """
    return SurfacePoints(scene.point[rows], scene.tangent[rows], scene.half_window[rows])


def nothing_found(cameras: Bool[np.ndarray, "n c"]) -> Match:
    """A match to be filled: every point lost.

    Parameters
    ----------
    cameras : (n, c) bool           cameras to use

    Returns
    -------
    Match                           NaN
    """
    count, views = cameras.shape
    shapes = ((6, 3), (3, 3), (views,), (views,), (views, 2), (views,), ())
    arrays = [np.full((count, *shape), np.nan) for shape in shapes]
    return Match._make([*arrays, np.ascontiguousarray(cameras), np.full(count, LOST)])
