"""3-D displacement of windows of a surface, from all cameras at once.

Every camera's window around the projected point is matched with the same camera's later picture,
and all cameras share one motion of the surface: the point's displacement u, its derivatives along
two tangents, and (quadratic) its second-order terms. The normal rotates with the tangents, so any
rigid motion is represented exactly. Each pixel's 3-D point comes from the camera's surface map, so
creases and curvature cause no error. Nothing is rectified; each grey level is interpolated once.

Inverse-compositional Gauss-Newton: gradients come from the first picture, so the normal matrix is
assembled once per point. Gain, offset and shading of every camera are eliminated in closed form.
"""

from collections import namedtuple
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit

from palpate.threads import in_threads
from palpate.vision.cholesky import (
    add_congruence_kernel,
    add_transposed_kernel,
    cholesky_inverse_kernel,
    cholesky_kernel,
    cholesky_solve_kernel,
    product_kernel,
)
from palpate.vision.matching.scene import (
    BLOCKS,
    Limits,
    Match,
    Scene,
)
from palpate.vision.matching.window import (
    deformed_frame_kernel,
    in_picture_kernel,
    load_camera_kernel,
    mapping_kernel,
    pixel_lengths_kernel,
    sample_surface_kernel,
    update_kernel,
    window_advance_kernel,
    window_blocks_kernel,
    window_residual_kernel,
    window_right_kernel,
    window_system_kernel,
)
from palpate.vision.range_flow import Outcome
from palpate.vision.spline import SplinePicture

# Outcomes as plain integers, for the kernels.
_VALID = int(Outcome.VALID)
_HIDDEN = int(Outcome.HIDDEN)
_TEXTURE = int(Outcome.TEXTURE)
_OUTSIDE = int(Outcome.OUTSIDE)
_LOST = int(Outcome.LOST)
# Minimum number of points per thread: each takes about 0.2 ms.
_MIN_POINTS_PER_THREAD = 8
# What all kernels take of the first instant: tuples of `_padded_to_four` arrays, see `Scene`; but
# the packed cameras (c, 25) and the blur variance (c,) [px^2].
_FirstInstant = namedtuple(
    "_FirstInstant", "cameras grey along_column along_row surface interior blur_variance"
)
# Points to track: (n, 3) [m], (n, 2, 3) tangents, (n,) half side of a window on the surface [m].
SurfacePoints = namedtuple("SurfacePoints", "point tangent half_window")
# Work arrays of one thread. Functions that take them are inlined: so many arguments compile slowly.
_Work = namedtuple(
    "_Work",
    "window basis sampled sums normal own mapping jacobian statistics hessian inverse right total q"
    " frame active blocks influence illumination noise_fraction",
)


def refine_joint(
    scene: Scene,
    rows: Int[np.ndarray, " n"],
    moved: Sequence[SplinePicture],
    start: Float[np.ndarray, "n 6 3"],
    cameras: Bool[np.ndarray, "n c"],
    noise: Float[np.ndarray, " c"],
    limits: Limits,
) -> Match:
    """Refine the motion of some points of a scene.

    Parameters
    ----------
    scene : Scene                       the first instant
    rows : (n,) int                     indices of the points to track
    moved : sequence of c SplinePicture     the later instant
    start : (n, 6, 3) float [m]         initial motion, as in `Match`; points with NaN are skipped
    cameras : (n, c) bool               cameras to use for each point
    noise : (c,) float [grey levels]    residual standard deviation, which weights the cameras
    limits : Limits

    Returns
    -------
    Match

    Source
    ------
    Baker and Matthews, Lucas-Kanade 20 years on, International Journal of Computer Vision 56
    (2004), for the inverse-compositional algorithm.
    """
    matches = _nothing_found(cameras)
    in_threads(
        _refine_range, len(rows), _first_instant(scene),
        _padded_to_four([picture.coefficients for picture in moved]), surface_points(scene, rows),
        np.ascontiguousarray(start), np.isfinite(start).all(axis=(1, 2)), noise, limits, matches,
        min_items=_MIN_POINTS_PER_THREAD,
    )  # fmt: skip
    return matches


def _first_instant(scene: Scene) -> _FirstInstant:
    """The arrays of a scene that the kernels take."""
    pictures = scene.pictures
    return _FirstInstant(
        scene.packed,
        _padded_to_four([picture.grey for picture in pictures]),
        _padded_to_four([picture.along_column for picture in pictures]),
        _padded_to_four([picture.along_row for picture in pictures]),
        _padded_to_four(scene.surface),
        _padded_to_four(scene.interior),
        scene.blur_variance,
    )


def _padded_to_four(arrays: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """The arrays of all cameras as a tuple, padded to four with the first one: a kernel is
    recompiled for every length of a tuple, which takes many seconds."""
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


def _nothing_found(cameras: Bool[np.ndarray, "n c"]) -> Match:
    """A match to be filled, all NaN: every point lost."""
    count, views = cameras.shape
    shapes = ((6, 3), (3, 3), (views,), (views,), (views, 2), (views,), ())
    arrays = [np.full((count, *shape), np.nan) for shape in shapes]
    return Match._make([*arrays, np.ascontiguousarray(cameras), np.full(count, _LOST)])


@njit(cache=True, nogil=True, error_model="numpy")
def _refine_range(begin, end, first, moved, points, start, known, noise, limits, matches):
    """`refine_joint` for the points from `begin` to `end`."""
    work = _make_work(len(noise), limits.half, limits.bases)
    outcome = matches.outcome
    for i in range(begin, end):
        if not known[i]:
            continue
        _set_kernel(work.q, start[i])
        outcome[i] = _prepare_kernel(first, points, i, matches.cameras[i], noise, limits, work)
        if outcome[i] == _VALID:
            outcome[i] = _iterate_kernel(first, moved, points, i, start[i], noise, limits, work)
        if outcome[i] == _VALID:
            _conclude_kernel(i, noise, limits, work, matches)


@njit(cache=True, error_model="numpy")
def _set_kernel(to, values):
    """Copy the leading block of a matrix; a slice assignment would take a second to compile."""
    for i in range(len(to)):
        for k in range(to.shape[1]):
            to[i, k] = values[i, k]


@njit(cache=True, error_model="numpy", inline="always")
def _make_work(views, half, bases):
    """Work arrays for one thread."""
    pixels = (2 * half + 1) ** 2
    # A window that only shifts has no tilt that its pixels' heights could follow.
    terms = bases + 1 if bases > 1 else 1
    return _Work(
        window=np.empty((views, 6, pixels), dtype=np.float32),
        basis=np.empty((views, max(bases, 3) + 1, pixels), dtype=np.float32),
        sampled=np.empty((views, pixels), dtype=np.float32),
        sums=np.empty((views, 2 * terms, 4)),
        normal=np.empty((views, 2 * terms, 2 * terms)),
        own=np.empty((2 * bases, 2 * bases)),
        mapping=np.empty((views, 2 * terms, 3 * bases)),
        jacobian=np.empty((2, 3)),
        statistics=np.empty((views, 3)),
        hessian=np.empty((3 * bases, 3 * bases)),
        inverse=np.empty((3 * bases, 3 * bases)),
        right=np.empty((views, 2 * terms)),
        total=np.empty(3 * bases),
        q=np.empty((6, 3)),
        frame=np.empty((3, 3)),
        active=np.empty(views, dtype=np.bool_),
        blocks=np.empty((BLOCKS * BLOCKS, 2 * terms)),
        influence=np.empty(2 * terms),
        illumination=np.empty((views, 4)),
        noise_fraction=np.empty(views),
    )


@njit(cache=True, error_model="numpy", inline="always")
def _prepare_kernel(first, points, i, cameras, noise, limits, work):
    """Load all windows of one point and factorise its Gauss-Newton matrix; an outcome."""
    point, tangent, half_window = points.point[i], points.tangent[i], points.half_window[i]
    seen = 0
    for c in range(len(cameras)):
        work.active[c] = cameras[c] and load_camera_kernel(
            first.cameras[c], first.grey[c], first.along_column[c], first.along_row[c],
            first.surface[c], first.interior[c], point, tangent, half_window, limits.half,
            limits.min_fraction, limits.shading, first.blur_variance[c], work.window[c],
            work.basis[c], work.statistics[c],
        )  # fmt: skip
        seen += work.active[c]
    if seen < 2:
        return _HIDDEN
    hessian = work.hessian
    hessian[:] = 0.0
    for c in range(len(cameras)):
        if not work.active[c]:
            continue
        window_system_kernel(
            work.window[c], work.basis[c, : len(work.influence) // 2], work.statistics[c, 0],
            work.statistics[c, 2], work.sampled[c], work.sums[c], work.normal[c],
        )  # fmt: skip
        mapping_kernel(
            first.cameras[c], point, tangent, limits.bases, work.jacobian, work.mapping[c]
        )
        add_congruence_kernel(work.normal[c], work.mapping[c], 1.0 / noise[c] ** 2, hessian)
    return _VALID if cholesky_kernel(hessian) else _TEXTURE


@njit(cache=True, error_model="numpy", inline="always")
def _iterate_kernel(first, moved, points, i, start, noise, limits, work):
    """Gauss-Newton steps until convergence, leaving the motion in `work.q`; an outcome."""
    point, tangent, half_window = points.point[i], points.tangent[i], points.half_window[i]
    total = work.total
    for _ in range(limits.iterations):
        total[:] = 0.0
        deformed_frame_kernel(work.q, tangent, half_window, work.frame)
        for c in range(len(noise)):
            if not work.active[c]:
                continue
            if _right_kernel(first, moved, points, i, c, work) > 0.0:
                add_transposed_kernel(work.mapping[c], work.right[c], 1.0 / noise[c] ** 2, total)
        cholesky_solve_kernel(work.hessian, total)
        update_kernel(work.q, work.frame, tangent, total, limits.bases)
        step, away = pixel_lengths_kernel(first.cameras, point, work.active, total, work.q, start)
        if not away <= limits.reach:
            return _LOST
        if step < limits.tolerance:
            inside = in_picture_kernel(
                first.cameras, moved, point, work.q, work.active, limits.half
            )
            return _VALID if inside else _OUTSIDE
    return _LOST


@njit(cache=True, error_model="numpy", inline="always")
def _right_kernel(first, moved, points, i, c, work):
    """Right-hand side of one camera at the current motion; returns the gain.

    Filled are the camera's rows of `work.right`, `work.sampled` and `work.illumination`, see
    `window_right_kernel`, and `work.noise_fraction`, what interpolation leaves of the variance.
    """
    work.noise_fraction[c] = sample_surface_kernel(
        first.cameras[c], moved[c], work.basis[c], work.window[c, 3], points.point[i], work.q,
        work.frame, points.half_window[i], work.sampled[c],
    )  # fmt: skip
    return _eliminate_kernel(c, work.statistics[c, 1], work)


@njit(cache=True, error_model="numpy", inline="always")
def _eliminate_kernel(c, mean, work):
    """`window_right_kernel` of one camera, for the sampled picture minus `mean` [grey levels]."""
    return window_right_kernel(
        work.window[c], work.basis[c, : len(work.influence) // 2], work.sampled[c],
        work.statistics[c, 0], mean, work.statistics[c, 2], work.sums[c], work.right[c],
        work.illumination[c],
    )  # fmt: skip


@njit(cache=True, error_model="numpy", inline="always")
def _conclude_kernel(i, noise, limits, work, matches):
    """Store the motion of a point, its covariance, and the residuals in each camera.

    The residuals follow from those before the last step, which is far below their noise.
    """
    bases, views = limits.bases, len(noise)
    score, own_step = matches.score[i], matches.own_step[i]
    residual_variance = matches.residual_variance[i]
    _set_kernel(matches.motion[i], work.q)
    cholesky_inverse_kernel(work.hessian, work.inverse)
    for a in range(3):
        for b in range(3):
            matches.covariance[i, a, b] = work.inverse[a * bases, b * bases]
    seen = 0
    for c in range(views):
        seen += work.active[c]
    excess = robust = white = 0.0
    for c in range(views):
        if not work.active[c]:
            continue
        basis = work.basis[c, : len(work.influence) // 2]
        product_kernel(work.mapping[c], work.total, work.illumination[c, 1], work.influence)
        window_advance_kernel(work.window[c], basis, work.influence, work.sampled[c])
        gain = _eliminate_kernel(c, 0.0, work)
        if not gain > 0.0:
            score[c] = 0.0
            residual_variance[c] = np.inf
            continue
        squares = window_residual_kernel(work.window[c], work.sampled[c], work.illumination[c])
        count, square = work.statistics[c, 0], work.statistics[c, 2]
        score[c] = np.sqrt(square / (square + squares))
        freedom = max(count - 4.0 - 3.0 * bases / seen, 1.0)
        residual_variance[c] = 2.0 / (1.0 + work.noise_fraction[c]) * squares / freedom
        excess += residual_variance[c] / noise[c] ** 2 / seen
        window_blocks_kernel(work.window[c], basis, work.sampled[c], work.blocks)
        robust += _robust_variance_kernel(
            work.mapping[c], work.inverse, 1.0 / noise[c] ** 2, work.blocks, work.influence
        )
        matches.own_variance[i, c] = residual_variance[c] * _own_step_kernel(
            work.normal[c], work.own, work.right[c, : 2 * bases], own_step[c]
        )
    for a in range(3):
        white += work.inverse[a * bases, a * bases]
    # Correct for the 3 bases degrees of freedom that the fit takes from few blocks.
    blocks = seen * BLOCKS * BLOCKS
    correction = blocks / max(blocks - 3.0 * bases, 1.0)
    # Identical pictures leave no residual: treated as white.
    matches.variance_ratio[i] = correction * robust / (white * excess) if excess > 0.0 else 1.0


@njit(cache=True, error_model="numpy")
def _robust_variance_kernel(mapping, inverse, factor, blocks, influence):
    """One camera's part of the variance of the displacement, from its residuals in blocks.

    `mapping` (2 terms, 3 bases), `inverse` (3 bases, 3 bases), `factor` one over the variance of
    the noise, `blocks` (cells, 2 terms); `influence` (2 terms,) is scratch.
    """
    robust = 0.0
    for a in range(3):
        product_kernel(mapping, inverse[a * (len(inverse) // 3)], factor, influence)
        for cell in range(len(blocks)):
            share = 0.0
            for k in range(len(influence)):
                share += blocks[cell, k] * influence[k]
            robust += share * share
    return robust


@njit(cache=True, error_model="numpy")
def _own_step_kernel(normal, scratch, step, further):
    """Write the further step that one camera alone would take into `further`, (2,) [px].

    `normal` (2 terms, 2 terms) and `step` (2 bases,), its right-hand side, are without the heights,
    which come last: in a flat window they determine nothing. `scratch` is (2 bases, 2 bases).
    Returns the variance of each component for residuals of one [px^2]; NaN if it is not determined.
    """
    _set_kernel(scratch, normal)
    if not cholesky_kernel(scratch):
        return np.nan
    cholesky_solve_kernel(scratch, step)
    further[0] = -step[0]
    further[1] = -step[1]
    variance = 0.0
    for a in range(2):
        for k in range(len(step)):
            step[k] = 0.0
        step[a] = 1.0
        cholesky_solve_kernel(scratch, step)
        variance += 0.5 * step[a]
    return variance
