"""3-D displacement of windows of a surface, from all cameras at once.

Every camera's window around the projected point is matched with the same camera's later picture,
and all cameras share one motion of the surface: the point's displacement u, its derivatives along
two tangents, and (quadratic) its second-order terms. The normal follows the tangents, so any rigid
motion is exact. Pixels get their 3-D points from the camera's surface map: creases and curvature
are no error. Nothing is rectified; each grey level is interpolated once.

Inverse-compositional Gauss-Newton: gradients come from the first picture, so the matrix is made
once a point. Gain and offset of every camera are eliminated in closed form.
"""

from collections import namedtuple

import numpy as np
from numba import njit

from palpate.threads import in_threads
from palpate.vision.cameras import project_kernel
from palpate.vision.joint.window import (
    deformed_frame_kernel,
    jacobian_kernel,
    load_camera_kernel,
    mapping_kernel,
    sample_surface_kernel,
)
from palpate.vision.matching import (
    window_blocks_kernel,
    window_hessian_kernel,
    window_right_kernel,
    window_side_sums_kernel,
)
from palpate.vision.small_systems import (
    cholesky_inverse_kernel,
    cholesky_kernel,
    cholesky_solve_kernel,
)

CONVERGED = 0
FEW_CAMERAS = 1
NO_TEXTURE = 2
LEFT = 3
NOT_CONVERGED = 4

# Points that are worth a thread: each takes some 0.2 ms.
_FEWEST = 8
# Blocks along a side of a window whose residuals are taken as independent of each other.
_BLOCKS = 3

# The first instant: packed cameras (c, 25); tuples of c arrays: grey levels, their two derivatives,
# surface point behind each pixel (rows, columns, 3), 1 or 0 where a pixel shows the surface or not.
First = namedtuple("First", "cameras grey along_column along_row surface inner")
# What is followed: (n, 3), (n, 2, 3) tangents, (n,) half side of a window on the surface [m].
Points = namedtuple("Points", "point tangent extent")
# Half side [px], number of polynomials that are free (1, 3 or 6), shortest step and longest way
# from the start [px], most iterations, least share of a window that shows the surface, whether
# the gain may vary linearly over a window.
Limits = namedtuple("Limits", "half bases tolerance reach iterations least_share shading")
# What `refine_joint` returns, less the state.
_Found = namedtuple("_Found", "motion covariance score left own own_variance rough")
# Work arrays of one thread. What takes them is inlined: passing so many arrays is slow to compile.
_Work = namedtuple(
    "_Work",
    "window place sampled sums moments one mapping jacobian ones centre hessian inverse right total"
    " q frame active blocks meat light",
)


def refine_joint(first, moved, points, use, start, noise, limits):
    """Motion of surface points between two instants.

    Parameters
    ----------
    first : First
    moved : tuple of c spline coefficients, later instant
    points : Points
    use : (n, c) bool                   cameras that see the point
    start : (n, 6, 3) float [m]         motion to start from: u, its derivatives along the tangents
                                        times the extent, its second-order terms times its square
    noise : (c,) float [grey levels]    what a match leaves, the weight of a camera
    limits : Limits

    Returns
    -------
    motion (n, 6, 3), covariance (n, 3, 3) [m^2] of u for white noise of size `noise`, score (n, c),
    left (n, c) variance of what is left [grey levels^2], own (n, c, 2) what each camera alone would
    add [px], own_variance (n, c) of that per component [px^2], rough (n,) by how much what is left
    is worse for u than white noise as strong, state (n,)
    """
    count, views = use.shape
    shapes = ((6, 3), (3, 3), (views,), (views,), (views, 2), (views,), ())
    found = _Found(*(np.full((count, *shape), np.nan) for shape in shapes))
    state = np.full(count, NOT_CONVERGED)
    known = np.isfinite(start).all(axis=(1, 2))
    in_threads(
        _refine_range, count, first, moved, points, use, start, known, noise, limits, found, state,
        fewest=_FEWEST,
    )  # fmt: skip
    return *found, state


@njit(cache=True, nogil=True, error_model="numpy")
def _refine_range(
    begin, end, first, moved, points, use, start, known, noise, limits, found, state
):  # fmt: skip
    """`refine_joint` of the points from `begin` to `end`."""
    work = _make_work(use.shape[1], limits.half, limits.bases)
    for i in range(begin, end):
        if not known[i]:
            continue
        _set_kernel(work.q, start[i])
        state[i] = _prepare_kernel(first, points, i, use[i], noise, limits, work)
        if state[i] == CONVERGED:
            state[i] = _iterate_kernel(first, moved, points, i, start[i], noise, limits, work)
        if state[i] == CONVERGED:
            _conclude_kernel(first, moved, points, i, noise, limits, work, found)


@njit(cache=True, error_model="numpy")
def _set_kernel(to, values):
    """Copy a matrix; a slice assignment would take a second to compile."""
    for i in range(len(to)):
        for k in range(to.shape[1]):
            to[i, k] = values[i, k]


@njit(cache=True, error_model="numpy", inline="always")
def _make_work(views, half, bases):
    """Work arrays for one thread."""
    side = 2 * half + 1
    return _Work(
        window=np.empty((views, 6, side, side), dtype=np.float32),
        place=np.empty((views, 3, side, side), dtype=np.float32),
        sampled=np.empty((side, side), dtype=np.float32),
        sums=np.empty((views, 8, 6)),
        moments=np.empty((5, 5)),
        one=np.empty((views, 2 * bases, 2 * bases)),
        mapping=np.empty((views, 2 * bases, 3 * bases)),
        jacobian=np.empty((2, 3)),
        ones=np.empty((views, 3)),
        centre=np.empty((views, 2), dtype=np.int64),
        hessian=np.empty((3 * bases, 3 * bases)),
        inverse=np.empty((3 * bases, 3 * bases)),
        right=np.empty(2 * bases),
        total=np.empty(3 * bases),
        q=np.empty((6, 3)),
        frame=np.empty((3, 3)),
        active=np.empty(views, dtype=np.bool_),
        blocks=np.empty((_BLOCKS * _BLOCKS, 2 * bases)),
        meat=np.empty((3 * bases, 3 * bases)),
        light=np.empty(5),
    )


@njit(cache=True, error_model="numpy", inline="always")
def _prepare_kernel(first, points, i, use, noise, limits, work):
    """Windows of all cameras and the factorised Gauss-Newton matrix of one point."""
    point, tangent, extent = points.point[i], points.tangent[i], points.extent[i]
    seen = 0
    for c in range(len(use)):
        work.active[c] = use[c] and load_camera_kernel(
            first.cameras[c], first.grey[c], first.along_column[c], first.along_row[c],
            first.surface[c], first.inner[c], point, tangent, extent, limits.half,
            limits.least_share, limits.shading, work.window[c], work.place[c], work.centre[c],
            work.ones[c],
        )  # fmt: skip
        seen += work.active[c]
    if seen < 2:
        return FEW_CAMERAS
    work.hessian[:] = 0.0
    for c in range(len(use)):
        if not work.active[c]:
            continue
        window_side_sums_kernel(work.window[c], limits.half, work.sums[c], work.moments)
        window_hessian_kernel(
            work.window[c], limits.half, limits.bases, work.ones[c, 0], work.ones[c, 2],
            work.sums[c], work.moments, work.one[c],
        )  # fmt: skip
        jacobian_kernel(first.cameras[c], point, work.jacobian)
        mapping_kernel(
            first.cameras[c], point, tangent, extent, limits.half, limits.bases, work.centre[c],
            work.jacobian, work.mapping[c],
        )  # fmt: skip
        _add_square_kernel(work.hessian, work.mapping[c], work.one[c], 1.0 / noise[c] ** 2)
    return CONVERGED if cholesky_kernel(work.hessian) else NO_TEXTURE


@njit(cache=True, error_model="numpy", inline="always")
def _iterate_kernel(first, moved, points, i, start, noise, limits, work):
    """Gauss-Newton steps until they are short; the motion is left in `work.q`."""
    point, tangent, extent = points.point[i], points.tangent[i], points.extent[i]
    for _ in range(limits.iterations):
        work.total[:] = 0.0
        deformed_frame_kernel(work.q, tangent, extent, work.frame)
        for c in range(len(noise)):
            if not work.active[c]:
                continue
            gain, _share = _right_kernel(first, moved, points, i, c, limits, work)
            if gain > 0.0:
                _add_product_kernel(work.total, work.mapping[c], work.right, 1.0 / noise[c] ** 2)
        cholesky_solve_kernel(work.hessian, work.total)
        _update_kernel(work.q, work.frame, tangent, work.total, limits.bases)
        step, away = _pixel_lengths_kernel(
            first.cameras, point, work.active, work.total, work.q, start
        )
        if not away <= limits.reach:
            return NOT_CONVERGED
        if step < limits.tolerance:
            inside = _in_picture_kernel(
                first.cameras, moved, point, work.q, work.active, limits.half
            )
            return CONVERGED if inside else LEFT
    return NOT_CONVERGED


@njit(cache=True, error_model="numpy", inline="always")
def _right_kernel(first, moved, points, i, c, limits, work):
    """Right-hand side of one camera at the present motion, in `work.right`.

    Returns the gain and the share of noise left by interpolation; `work.light` holds the rest.
    """
    share = sample_surface_kernel(
        first.cameras[c], moved[c], work.place[c], work.window[c, 3], points.point[i], work.q,
        work.frame, points.extent[i], limits.half, work.sampled,
    )  # fmt: skip
    gain = window_right_kernel(
        work.window[c], work.sampled, limits.half, limits.bases, work.ones[c, 0],
        work.ones[c, 1], work.ones[c, 2], work.sums[c], work.right, work.light,
    )  # fmt: skip
    return gain, share


@njit(cache=True, error_model="numpy", inline="always")
def _conclude_kernel(first, moved, points, i, noise, limits, work, found):
    """Motion, its covariance, and what the match leaves in each camera."""
    bases, views = limits.bases, len(noise)
    score, left, own = found.score[i], found.left[i], found.own[i]
    _set_kernel(found.motion[i], work.q)
    cholesky_inverse_kernel(work.hessian, work.inverse)
    for a in range(3):
        for b in range(3):
            found.covariance[i, a, b] = work.inverse[a * bases, b * bases]
    deformed_frame_kernel(work.q, points.tangent[i], points.extent[i], work.frame)
    work.meat[:] = 0.0
    seen = 0
    for c in range(views):
        seen += work.active[c]
    excess = 0.0
    for c in range(views):
        if not work.active[c]:
            continue
        gain, share = _right_kernel(first, moved, points, i, c, limits, work)
        squares = work.light[4]
        if not gain > 0.0:
            score[c] = 0.0
            left[c] = np.inf
            continue
        inside, square = work.ones[c, 0], work.ones[c, 2]
        score[c] = np.sqrt(square / (square + squares))
        free = max(inside - 4.0 - 3.0 * bases / seen, 1.0)
        left[c] = 2.0 / (1.0 + share) * squares / free
        excess += left[c] / noise[c] ** 2 / seen
        window_blocks_kernel(
            work.window[c],
            work.sampled,
            limits.half,
            bases,
            work.ones[c, 1],
            work.light,
            work.blocks,
        )
        _add_blocks_kernel(work.meat, work.mapping[c], work.blocks, 1.0 / noise[c] ** 2)
        if cholesky_kernel(work.one[c]):
            cholesky_solve_kernel(work.one[c], work.right)
            own[c, 0] = -work.right[0]
            own[c, 1] = -work.right[bases]
            found.own_variance[i, c] = left[c] * _mean_variance_kernel(work.one[c], work.right)
    # Residuals of few blocks, bent toward zero by the fit of 3 bases unknowns.
    blocks = seen * _BLOCKS * _BLOCKS
    correction = blocks / max(blocks - 3.0 * bases, 1.0)
    robust = 0.0
    white = 0.0
    for a in range(3):
        row = work.inverse[a * bases]
        white += row[a * bases]
        for k in range(3 * bases):
            for m in range(3 * bases):
                robust += row[k] * work.meat[k, m] * row[m]
    found.rough[i] = correction * robust / (white * excess)


@njit(cache=True, error_model="numpy")
def _mean_variance_kernel(factor, scratch):
    """Mean of the two diagonal entries of an inverse that belong to the shift."""
    variance = 0.0
    bases = len(scratch) // 2
    for a in (0, bases):
        scratch[:] = 0.0
        scratch[a] = 1.0
        cholesky_solve_kernel(factor, scratch)
        variance += 0.5 * scratch[a]
    return variance


@njit(cache=True, error_model="numpy")
def _add_blocks_kernel(total, mapping, blocks, weight):
    """total += sum over blocks of s s^T, s = weight * mapping^T block."""
    size = mapping.shape[1]
    s = np.empty(size)
    for n in range(len(blocks)):
        for j in range(size):
            value = 0.0
            for k in range(blocks.shape[1]):
                value += mapping[k, j] * blocks[n, k]
            s[j] = weight * value
        for j in range(size):
            for k in range(size):
                total[j, k] += s[j] * s[k]


@njit(cache=True, error_model="numpy")
def _add_square_kernel(total, mapping, one, weight):
    """total += weight * mapping^T one mapping."""
    product = np.zeros((len(one), mapping.shape[1]))
    for i in range(len(one)):
        for k in range(len(one)):
            value = one[i, k] * weight
            for j in range(mapping.shape[1]):
                product[i, j] += value * mapping[k, j]
    for i in range(mapping.shape[1]):
        for k in range(len(one)):
            value = mapping[k, i]
            for j in range(mapping.shape[1]):
                total[i, j] += value * product[k, j]


@njit(cache=True, error_model="numpy")
def _add_product_kernel(total, mapping, right, weight):
    """total += weight * mapping^T right."""
    for i in range(mapping.shape[1]):
        value = 0.0
        for k in range(len(right)):
            value += mapping[k, i] * right[k]
        total[i] += weight * value


@njit(cache=True, error_model="numpy")
def _update_kernel(q, frame, tangent, step, bases):
    """Compose the motion with the inverse of the step: u - F step, F the surface's deformation."""
    t, s = tangent[0], tangent[1]
    normal = (
        t[1] * s[2] - t[2] * s[1],
        t[2] * s[0] - t[0] * s[2],
        t[0] * s[1] - t[1] * s[0],
    )
    for k in range(bases):
        d0, d1, d2 = step[k], step[bases + k], step[2 * bases + k]
        along = d0 * t[0] + d1 * t[1] + d2 * t[2]
        across = d0 * s[0] + d1 * s[1] + d2 * s[2]
        out = d0 * normal[0] + d1 * normal[1] + d2 * normal[2]
        for a in range(3):
            q[k, a] -= along * frame[0, a] + across * frame[1, a] + out * frame[2, a]


@njit(cache=True, error_model="numpy")
def _pixel_lengths_kernel(cameras, point, active, step, q, start):
    """Longest picture of the last step, and of the way from the start, over the cameras [px]."""
    bases = len(step) // 3
    longest = 0.0
    farthest = 0.0
    for c in range(len(active)):
        if not active[c]:
            continue
        x, y = project_kernel(
            cameras[c], point[0] + q[0, 0], point[1] + q[0, 1], point[2] + q[0, 2]
        )
        x1, y1 = project_kernel(
            cameras[c],
            point[0] + q[0, 0] + step[0],
            point[1] + q[0, 1] + step[bases],
            point[2] + q[0, 2] + step[2 * bases],
        )
        x0, y0 = project_kernel(
            cameras[c], point[0] + start[0, 0], point[1] + start[0, 1], point[2] + start[0, 2]
        )
        longest = max(longest, np.hypot(x1 - x, y1 - y))
        farthest = max(farthest, np.hypot(x0 - x, y0 - y))
    return longest, farthest


@njit(cache=True, error_model="numpy")
def _in_picture_kernel(cameras, moved, point, q, active, half):
    """True where the moved windows lie within the later pictures of all cameras in use."""
    for c in range(len(active)):
        if active[c]:
            x, y = project_kernel(
                cameras[c], point[0] + q[0, 0], point[1] + q[0, 1], point[2] + q[0, 2]
            )
            rows, columns = moved[c].shape
            if not (half <= x < columns - 8 - half and half <= y < rows - 8 - half):
                return False
    return True
