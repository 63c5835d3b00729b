"""The refinement of `refinement.py` for a CUDA device: a block of threads for each point.

The threads of a block share a window's pixels. All sums over them are inner products of planes:
weight, grey level and shading of the first picture, the derivatives of the grey level with respect
to each unknown, and the later picture. What has no pixels is left to one thread, and is the same
code as on the CPU.
"""

import math
from collections import namedtuple

import numpy as np
from numba import cuda

from palpate.vision.cameras import project_kernel
from palpate.vision.refinement.refinement import own_step_kernel, robust_variance_kernel
from palpate.vision.refinement.sampling import camera_polynomial_kernel
from palpate.vision.refinement.window import (
    deformed_frame_kernel,
    fits_kernel,
    in_picture_kernel,
    mapping_kernel,
    pixel_lengths_kernel,
    rest_frame_kernel,
    update_kernel,
)
from palpate.vision.refinement.window_match import BLOCKS, HIDDEN, LOST, OUTSIDE, TEXTURE, VALID
from palpate.vision.refinement.window_share import (
    GREY,
    SHADING,
    SLOPES,
    WEIGHT,
    advance_share_kernel,
    blocks_share_kernel,
    congruence_share_kernel,
    load_share_kernel,
    product_share_kernel,
    residual_share_kernel,
    sample_share_kernel,
    scale_share_kernel,
    shading_share_kernel,
    subtract_share_kernel,
    sum_share_kernel,
    system_share_kernel,
)
from palpate.vision.small_systems import (
    add_transposed_kernel,
    cholesky_inverse_kernel,
    cholesky_kernel,
    cholesky_solve_kernel,
    product_kernel,
)

# A point that needs more steps; none of the outcomes.
_GOING_ON = -1
# What is asked: `SurfacePoints`, their start (n, 6, 3) [m] and whether it is known (n,), and the
# noise of each camera (c,) [grey levels].
Task = namedtuple("Task", "point tangent half_window start known noise")
# Work arrays of every block of threads, c cameras each; planes and places are float32.
#   planes (c, 4 + 2 terms, pixels)     see `window_share.py` [grey levels, grey levels/px]
#   places (c, 3, pixels)               xi, eta, zeta, see `surface_coordinates_kernel`
#   sampled (c, 2, pixels)              later grey level, and the fraction of its noise left
#   statistics (c, 3)                   number of pixels, mean, sum of squared deviations
#   products, partial (4 + 2 terms,), (4 + 2 terms, 32)     sums over the pixels, and parts of them
#   sums (c, 2 terms, 4)                of each unknown's derivative with the first four planes
# The others are as in `refinement.py`.
BlockWork = namedtuple(
    "BlockWork",
    "planes places sampled statistics sums normal own mapping jacobian hessian inverse right total"
    " q frame active blocks influence illumination polynomial products partial outcome",
)


@cuda.jit(cache=True)
def refine_kernel(count, first, moved, task, limits, found, work):
    """`refine_joint`, some points for each block; all arrays are on the device.

    Parameters
    ----------
    count : int                     points, the first ones of `task`
    first : FirstInstant
    moved : tuple of four arrays    spline coefficients of the later pictures
    task : Task
    limits : Limits
    found : Match                   filled
    work : BlockWork                with one more dimension in front, for the blocks
    """
    mine = _of_block(work, cuda.blockIdx.x)
    for i in range(cuda.blockIdx.x, count, cuda.gridDim.x):
        if not task.known[i]:
            continue
        if cuda.threadIdx.x == 0:
            for a in range(6):
                for b in range(3):
                    mine.q[a, b] = task.start[i, a, b]
        outcome = _prepare(first, task, i, found.cameras[i], limits, mine)
        if outcome == VALID:
            outcome = _iterate(first, moved, task, i, limits, mine)
        if outcome == VALID:
            _conclude(i, task.noise, limits, mine, found)
        if cuda.threadIdx.x == 0:
            found.outcome[i] = outcome
        cuda.syncthreads()


@cuda.jit(device=True)
def _of_block(work, block):
    """The work arrays of one block."""
    return BlockWork(
        work.planes[block], work.places[block], work.sampled[block], work.statistics[block],
        work.sums[block], work.normal[block], work.own[block], work.mapping[block],
        work.jacobian[block], work.hessian[block], work.inverse[block], work.right[block],
        work.total[block], work.q[block], work.frame[block], work.active[block],
        work.blocks[block], work.influence[block], work.illumination[block],
        work.polynomial[block], work.products[block], work.partial[block], work.outcome[block],
    )  # fmt: skip


@cuda.jit(device=True)
def _inner_products(plane, planes, begin, end, work):
    """Inner products of a plane with those from `begin` to `end`, in `work.products`.

    All threads wait for them.
    """
    thread, threads = cuda.threadIdx.x, cuda.blockDim.x
    product_share_kernel(thread, threads, plane, planes, begin, end, work.partial)
    cuda.syncthreads()
    sum_share_kernel(thread, threads, work.partial, end - begin, work.products)
    cuda.syncthreads()


@cuda.jit(device=True)
def _prepare(first, task, i, cameras, limits, work):
    """Load all windows of one point and factorise its Gauss-Newton matrix; an outcome."""
    thread, threads = cuda.threadIdx.x, cuda.blockDim.x
    seen = 0
    for c in range(len(cameras)):
        active = cameras[c] and _load_camera(first, task, i, c, limits, work)
        if thread == 0:
            work.active[c] = active
        seen += active
    cuda.syncthreads()
    if seen < 2:
        return HIDDEN
    for k in range(thread, len(work.total) ** 2, threads):
        work.hessian[k // len(work.total), k % len(work.total)] = 0.0
    for c in range(len(cameras)):
        if work.active[c]:
            _window_system(c, work)
            if thread == 0:
                mapping_kernel(
                    first.cameras[c], task.point[i], task.tangent[i], limits.bases,
                    work.jacobian, work.mapping[c],
                )  # fmt: skip
            cuda.syncthreads()
            factor = 1.0 / task.noise[c] ** 2
            congruence_share_kernel(
                thread, threads, work.normal[c], work.mapping[c], factor, work.hessian
            )
            cuda.syncthreads()
    if thread == 0:
        work.outcome[0] = VALID if cholesky_kernel(work.hessian) else TEXTURE
    cuda.syncthreads()
    return work.outcome[0]


@cuda.jit(device=True)
def _load_camera(first, task, i, c, limits, work):
    """`load_camera_kernel`, with the derivatives as planes; False if too few pixels are seen."""
    thread, threads = cuda.threadIdx.x, cuda.blockDim.x
    point, half = task.point[i], limits.half
    planes, products = work.planes[c], work.products
    x, y = project_kernel(first.cameras[c], point[0], point[1], point[2])
    if not fits_kernel(x, y, first.grey[c].shape, half):
        return False
    load_share_kernel(
        thread, threads, first, c, (round(y) - half, round(x) - half), point,
        rest_frame_kernel(task.tangent[i]), 1.0 / task.half_window[i], planes, work.places[c],
    )  # fmt: skip
    cuda.syncthreads()
    _inner_products(planes[WEIGHT], planes, WEIGHT, GREY + 1, work)
    count, mean = products[0], products[1] / max(products[0], 1.0)
    if count < limits.min_fraction * (2 * half + 1) ** 2:
        return False
    subtract_share_kernel(thread, threads, planes[GREY], planes[WEIGHT], mean)
    cuda.syncthreads()
    _inner_products(planes[GREY], planes, GREY, GREY + 1, work)
    square = products[0]
    if not square > 0.0:
        return False
    if limits.shading:
        _load_shading(count, mean, square, first.blur_variance[c], planes, work)
    if thread == 0:
        statistics = work.statistics[c]
        statistics[0], statistics[1], statistics[2] = count, mean, square
    return True


@cuda.jit(device=True)
def _load_shading(count, mean, square, blur_variance, planes, work):
    """Planes of shading along columns and rows, orthogonal to those before and to each other."""
    thread, threads = cuda.threadIdx.x, cuda.blockDim.x
    shading_share_kernel(thread, threads, mean, blur_variance, planes)
    cuda.syncthreads()
    for n in range(SHADING, SLOPES):
        for before in range(n):
            square_before = count if before == WEIGHT else square if before == GREY else 1.0
            _inner_products(planes[n], planes, before, before + 1, work)
            subtract_share_kernel(
                thread, threads, planes[n], planes[before], work.products[0] / square_before
            )
            cuda.syncthreads()
        _inner_products(planes[n], planes, n, n + 1, work)
        length = math.sqrt(work.products[0])
        scale_share_kernel(thread, threads, planes[n], 1.0 / length if length > 0.0 else 0.0)
        cuda.syncthreads()


@cuda.jit(device=True)
def _window_system(c, work):
    """`window_system_kernel` of one camera."""
    thread, threads = cuda.threadIdx.x, cuda.blockDim.x
    planes, sums, products = work.planes[c], work.sums[c], work.products
    for i in range(len(sums)):
        _inner_products(planes[SLOPES + i], planes, 0, SLOPES + i + 1, work)
        system_share_kernel(thread, threads, i, products, work.statistics[c], sums, work.normal[c])
        if thread == 0:
            for k in range(SLOPES):
                sums[i, k] = products[k]
        cuda.syncthreads()


@cuda.jit(device=True)
def _iterate(first, moved, task, i, limits, work):
    """Gauss-Newton steps until convergence, leaving the motion in `work.q`; an outcome."""
    point, tangent, half_window = task.point[i], task.tangent[i], task.half_window[i]
    thread, threads = cuda.threadIdx.x, cuda.blockDim.x
    alone = thread == 0
    for _ in range(limits.iterations):
        if alone:
            for n in range(len(work.total)):
                work.total[n] = 0.0
            deformed_frame_kernel(work.q, tangent, half_window, work.frame)
        for c in range(len(task.noise)):
            if work.active[c]:
                if alone:
                    camera_polynomial_kernel(
                        first.cameras[c], point, work.q, work.frame, half_window, work.polynomial
                    )
                cuda.syncthreads()
                sample_share_kernel(
                    thread, threads, first.cameras[c], moved[c], work.polynomial, work.places[c],
                    work.planes[c, WEIGHT], work.statistics[c, 1], work.sampled[c],
                )  # fmt: skip
                cuda.syncthreads()
                factor = 1.0 / task.noise[c] ** 2
                if _eliminate(c, work) > 0.0 and alone:
                    add_transposed_kernel(work.mapping[c], work.right[c], factor, work.total)
        if alone:
            cholesky_solve_kernel(work.hessian, work.total)
            update_kernel(work.q, work.frame, tangent, work.total, limits.bases)
            step, away = pixel_lengths_kernel(
                first.cameras, point, work.active, work.total, work.q, task.start[i]
            )
            work.outcome[0] = _GOING_ON
            if not away <= limits.reach:
                work.outcome[0] = LOST
            elif step < limits.tolerance:
                inside = in_picture_kernel(
                    first.cameras, moved, point, work.q, work.active, limits.half
                )
                work.outcome[0] = VALID if inside else OUTSIDE
        cuda.syncthreads()
        if work.outcome[0] != _GOING_ON:
            return work.outcome[0]
    return LOST


@cuda.jit(device=True)
def _eliminate(c, work):
    """`window_right_kernel` of one camera, for what was sampled; its gain."""
    products, sums = work.products, work.sums[c]
    _inner_products(work.sampled[c, 0], work.planes[c], 0, len(work.planes[c]), work)
    offset = products[WEIGHT] / work.statistics[c, 0]
    gain = products[GREY] / work.statistics[c, 2]
    first, second = products[SHADING], products[SHADING + 1]
    if cuda.threadIdx.x == 0:
        illumination = work.illumination[c]
        illumination[0], illumination[1], illumination[2], illumination[3] = (
            offset, gain, first, second,
        )  # fmt: skip
        for n in range(work.right.shape[1]):
            explained = sums[n, 0] * offset + sums[n, 1] * gain
            explained += sums[n, 2] * first + sums[n, 3] * second
            work.right[c, n] = (products[SLOPES + n] - explained) / gain
    cuda.syncthreads()
    return gain


@cuda.jit(device=True)
def _conclude(i, noise, limits, work, found):
    """Store the motion of a point, its covariance, and the residuals in each camera."""
    thread, threads, bases = cuda.threadIdx.x, cuda.blockDim.x, limits.bases
    alone = thread == 0
    if alone:
        cholesky_inverse_kernel(work.hessian, work.inverse)
        for a in range(3):
            for b in range(3):
                found.covariance[i, a, b] = work.inverse[a * bases, b * bases]
            for k in range(6):
                found.motion[i, k, a] = work.q[k, a]
    cuda.syncthreads()
    seen = 0
    for c in range(len(noise)):
        seen += work.active[c]
    excess = robust = white = 0.0
    for c in range(len(noise)):
        if not work.active[c]:
            continue
        squares = _residual(c, work)
        if not squares >= 0.0:
            if alone:
                found.score[i, c], found.residual_variance[i, c] = 0.0, np.inf
            continue
        _inner_products(work.sampled[c, 1], work.planes[c], WEIGHT, WEIGHT + 1, work)
        count, square = work.statistics[c, 0], work.statistics[c, 2]
        noise_fraction = work.products[0] / count
        freedom = max(count - 4.0 - 3.0 * bases / seen, 1.0)
        variance = 2.0 / (1.0 + noise_fraction) * squares / freedom
        excess += variance / noise[c] ** 2 / seen
        blocks_share_kernel(thread, threads, work.sampled[c, 0], work.planes[c], work.blocks)
        cuda.syncthreads()
        if alone:
            found.score[i, c] = math.sqrt(square / (square + squares))
            found.residual_variance[i, c] = variance
            robust += robust_variance_kernel(
                work.mapping[c], work.inverse, 1.0 / noise[c] ** 2, work.blocks, work.influence
            )
            found.own_variance[i, c] = variance * own_step_kernel(
                work.normal[c], work.own, work.right[c, : 2 * bases], found.own_step[i, c]
            )
    if alone:
        for a in range(3):
            white += work.inverse[a * bases, a * bases]
        # As in `refinement.py`: few blocks, and identical pictures.
        blocks = seen * BLOCKS * BLOCKS
        correction = blocks / max(blocks - 3.0 * bases, 1.0)
        ratio = correction * robust / (white * excess) if excess > 0.0 else 1.0
        found.variance_ratio[i] = ratio


@cuda.jit(device=True)
def _residual(c, work):
    """Residuals of one camera after the last step, in `work.sampled`; their sum of squares.

    NaN where the pictures are not positively correlated.
    """
    thread, threads = cuda.threadIdx.x, cuda.blockDim.x
    planes, difference = work.planes[c], work.sampled[c, 0]
    if thread == 0:
        gain = work.illumination[c, 1]
        product_kernel(work.mapping[c], work.total, gain, work.influence)
    cuda.syncthreads()
    advance_share_kernel(thread, threads, work.influence, planes, difference)
    cuda.syncthreads()
    if not _eliminate(c, work) > 0.0:
        return np.nan
    residual_share_kernel(thread, threads, planes, work.illumination[c], difference)
    cuda.syncthreads()
    # The inner product of the residuals with themselves.
    _inner_products(difference, work.sampled[c], 0, 1, work)
    return work.products[0]
