"""Which stereo matches are believed: neighbours and cameras must agree."""

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.records import Rig
from palpate.shapes import Flags
from palpate.vision.cameras import Triangulation, project, triangulate

# Fewer neighbours have no majority when one of them is wrong.
_FEWEST = 3
# Removing what is wrong changes what its neighbours are compared with.
_ROUNDS = 2
_PER_MEDIAN = 1.4826
_AROUND = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))


def contradicts_neighbours(
    cell: Int[np.ndarray, "n 2"],
    pixel: Float[np.ndarray, "n 2"],
    displacement: Float[np.ndarray, "n 2"],
    gradient: Float[np.ndarray, "n 2 2"],
    sigma: Float[np.ndarray, " n"],
    valid: Flags,
    *,
    disagreement: float,
) -> Flags:
    """True for valid matches that their neighbours on the grid do not confirm.

    Every neighbour carries its match along its own gradient to the point; the median of these is
    compared with the point's own, in units of their scatter and of the match's noise. A point with
    fewer than three neighbours is confirmed by nobody.

    Parameters
    ----------
    cell : (n, 2) int               row and column of each point on the grid
    pixel : (n, 2) float [px]
    displacement, gradient : (n, 2) float [px], (n, 2, 2) float     used where valid
    sigma : (n,) float [px]         of the displacement
    valid : (n,) bool
    disagreement : float            how many standard deviations are too many

    Returns
    -------
    (n,) bool

    Source
    ------
    Westerweel and Scarano, Universal outlier detection for PIV data, Experiments in Fluids 39
    (2005), to first order.
    """
    number = np.full(cell.max(axis=0) + 3 if len(cell) else (3, 3), -1)
    number[cell[:, 0] + 1, cell[:, 1] + 1] = np.arange(len(cell))
    near = np.stack([number[cell[:, 0] + 1 + i, cell[:, 1] + 1 + j] for i, j in _AROUND], axis=1)
    away = pixel[:, None] - pixel[near]
    word = displacement[near] + np.einsum("nkab,nkb->nka", gradient[near], away)
    good = valid.copy()
    for _ in range(_ROUNDS):
        there = (near >= 0) & good[near]
        enough = there.sum(axis=1) >= _FEWEST
        said = np.where(there[..., None], word, np.nan)[enough]
        middle = np.nanmedian(said, axis=1)
        scatter = np.nanmedian(np.linalg.norm(said - middle[:, None], axis=2), axis=1)
        gap = np.linalg.norm(displacement[enough] - middle, axis=1)
        confirmed = np.zeros(len(cell), dtype=bool)
        confirmed[enough] = gap <= disagreement * np.hypot(scatter, sigma[enough])
        good = valid & confirmed
    return valid & ~good


def joined_cameras(
    rig: Rig,
    pixels: Float[np.ndarray, "c n 2"],
    covariance: Float[np.ndarray, "c n 2 2"],
    *,
    disagreement: float,
    reprojection: float,
) -> tuple[Triangulation, Bool[np.ndarray, "c n"]]:
    """Triangulate; where a camera contradicts the others, leave it out; where two do, leave both.

    The matches of all cameras are against one reference picture and share its noise: half of their
    variance is given to the reference.

    Parameters
    ----------
    rig : Rig
    pixels : (c, n, 2) float [px]   NaN where a camera does not see the point; the reference's are
                                    whole
    covariance : (c, n, 2, 2) float [px^2]  of the match of each camera; the reference's is not read
    disagreement : float            standard deviations by which a camera may miss the joint point,
                                    beyond what it misses others by
    reprojection : float [px]       by which it may miss it at most

    Returns
    -------
    triangulation : Triangulation   covariance from the matches; residual and cameras as used
    used : (c, n) bool              all False for points where no two cameras agree
    """
    seen = np.isfinite(pixels).all(axis=2)
    used = seen.copy()
    for _ in range(len(pixels) - 1):
        found, miss = _triangulated(rig, pixels, covariance, used)
        over = _over(miss, used, covariance, disagreement, reprojection)
        over[rig.reference] = -np.inf
        wrong = over.max(axis=0) > 1.0
        lost = used.any(axis=0) & ~np.isfinite(found.point).all(axis=1)
        few = used.sum(axis=0) <= 2
        if not (wrong | lost).any():
            break
        worst = over.argmax(axis=0)
        drop = np.flatnonzero(wrong & ~few)
        used[worst[drop], drop] = False
        used[:, (wrong & few) | lost] = False
    found, _ = _triangulated(rig, pixels, covariance, used)
    return found, used


def _triangulated(
    rig: Rig,
    pixels: Float[np.ndarray, "c n 2"],
    covariance: Float[np.ndarray, "c n 2 2"],
    used: Bool[np.ndarray, "c n"],
) -> tuple[Triangulation, Float[np.ndarray, "c n 2"]]:
    """Joint points, and by how much each camera misses them [px]."""
    mine = used.copy()
    mine[rig.reference] = False
    half = np.where(mine[..., None, None], 0.5 * covariance, 0.0)
    shared = half.sum(axis=0) / np.maximum(mine.sum(axis=0), 1)[:, None, None]
    half[rig.reference] = shared
    half = np.where(used[..., None, None], half, np.eye(2))
    found = triangulate(rig, np.where(used[..., None], pixels, np.nan), half)
    seen = np.stack([project(camera, found.point) for camera in rig.cameras])
    return found, np.where(used[..., None], pixels - seen, np.nan)


def _over(
    miss: Float[np.ndarray, "c n 2"],
    used: Bool[np.ndarray, "c n"],
    covariance: Float[np.ndarray, "c n 2 2"],
    disagreement: float,
    reprojection: float,
) -> Float[np.ndarray, "c n"]:
    """How far each camera misses the joint point over what is allowed; -inf where not used."""
    over = np.full(used.shape, -np.inf)
    for c, mine in enumerate(used):
        known = mine & np.isfinite(miss[c]).all(axis=1)
        if not known.any():
            continue
        error = miss[c, known]
        away = np.linalg.norm(error - np.median(error, axis=0), axis=1)
        own = np.trace(covariance[c, known], axis1=1, axis2=2)
        allowed = disagreement * np.sqrt((_PER_MEDIAN * np.median(away)) ** 2 + own)
        whole = np.linalg.norm(error, axis=1) / reprojection
        over[c, known] = np.maximum(away / allowed, whole)
    return over
