"""Which stereo matches are believed: neighbours and cameras must agree."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.records import Rig
from palpate.vision.cameras import Triangulation, project, triangulate
from palpate.vision.range_flow import Outcome
from palpate.vision.stereo.window_matches import WindowMatches

# A match is rejected where neighbours or cameras contradict it by more standard deviations.
_MAX_DEVIATIONS = 5.0
# Fewer neighbours have no majority when one of them is wrong.
_MIN_NEIGHBOURS = 3
# Removing what is wrong changes what its neighbours are compared with.
_ROUNDS = 2
# Standard deviation of a normal distribution over the median of its absolute values.
_PER_MEDIAN = 1.4826
_AROUND = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))


def confirmed_matches(
    matches: WindowMatches, cell: Int[np.ndarray, "n 2"], pixel: Float[np.ndarray, "n 2"]
) -> WindowMatches:
    """Matches without those that their neighbours on the grid do not confirm.

    Every neighbour carries its match along its own gradient to the point; the median of these is
    compared with the point's own, in units of their scatter and of the match's noise. A point with
    fewer than three neighbours is confirmed by nobody.

    Parameters
    ----------
    matches : WindowMatches         n
    cell : (n, 2) int               row and column of each point on the grid
    pixel : (n, 2) float [px]

    Returns
    -------
    WindowMatches                   outcome NEIGHBOURS and displacement NaN for those

    Source
    ------
    Westerweel and Scarano, Universal outlier detection for PIV data, Experiments in Fluids 39
    (2005), to first order.
    """
    valid = matches.outcome == Outcome.VALID
    sigma = np.sqrt(np.trace(matches.covariance, axis1=1, axis2=2))
    number = np.full(cell.max(axis=0, initial=0) + 3, -1)
    number[cell[:, 0] + 1, cell[:, 1] + 1] = np.arange(len(cell))
    near = np.stack([number[cell[:, 0] + 1 + i, cell[:, 1] + 1 + j] for i, j in _AROUND], axis=1)
    offset = pixel[:, None] - pixel[near]
    carried = np.einsum("nkab,nkb->nka", matches.gradient[near], offset)
    expected = matches.displacement[near] + carried
    good = valid
    for _ in range(_ROUNDS):
        there = (near >= 0) & good[near]
        enough = there.sum(axis=1) >= _MIN_NEIGHBOURS
        votes = np.where(there[..., None], expected, np.nan)[enough]
        median = np.nanmedian(votes, axis=1)
        scatter = np.nanmedian(np.linalg.norm(votes - median[:, None], axis=2), axis=1)
        gap = np.linalg.norm(matches.displacement[enough] - median, axis=1)
        confirmed = np.zeros(len(cell), dtype=bool)
        confirmed[enough] = gap <= _MAX_DEVIATIONS * np.hypot(scatter, sigma[enough])
        good = valid & confirmed
    wrong = valid & ~good
    return replace(
        matches,
        displacement=np.where(wrong[:, None], np.nan, matches.displacement),
        outcome=np.where(wrong, int(Outcome.NEIGHBOURS), matches.outcome),
    )


def joined_cameras(
    rig: Rig,
    pixels: Float[np.ndarray, "c n 2"],
    covariance: Float[np.ndarray, "c n 2 2"],
    *,
    reprojection: float,
) -> tuple[Triangulation, Bool[np.ndarray, "c n"]]:
    """Triangulate without the cameras that contradict the others; of two that disagree use neither.

    The matches of all cameras are against one reference picture and share its noise: half of their
    variance is given to the reference.

    Parameters
    ----------
    rig : Rig
    pixels : (c, n, 2) float [px]   NaN where a camera does not see the point; the reference's are
                                    whole
    covariance : (c, n, 2, 2) float [px^2]  of the match of each camera; the reference's is not read
    reprojection : float [px]       by how much a camera may miss the joint point at most

    Returns
    -------
    triangulation : Triangulation   covariance from the matches; residual and cameras as used
    used : (c, n) bool              all False for points where no two cameras agree
    """
    used = np.isfinite(pixels).all(axis=2)
    for _ in range(len(pixels) - 1):
        found, error = _triangulated(rig, pixels, covariance, used)
        excess = _excess(error, used, covariance, reprojection)
        excess[rig.reference] = -np.inf
        wrong = excess.max(axis=0) > 1.0
        lost = used.any(axis=0) & ~np.isfinite(found.point).all(axis=1)
        few = used.sum(axis=0) <= 2
        if not (wrong | lost).any():
            break
        drop = np.flatnonzero(wrong & ~few)
        used[excess.argmax(axis=0)[drop], drop] = False
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
    others = used.copy()
    others[rig.reference] = False
    half = np.where(others[..., None, None], 0.5 * covariance, 0.0)
    half[rig.reference] = half.sum(axis=0) / np.maximum(others.sum(axis=0), 1)[:, None, None]
    half = np.where(used[..., None, None], half, np.eye(2))
    pixels = np.where(used[..., None], pixels, np.nan)
    found = triangulate(rig, pixels, half)
    return found, pixels - np.stack([project(camera, found.point) for camera in rig.cameras])


def _excess(
    error: Float[np.ndarray, "c n 2"],
    used: Bool[np.ndarray, "c n"],
    covariance: Float[np.ndarray, "c n 2 2"],
    reprojection: float,
) -> Float[np.ndarray, "c n"]:
    """Distance of each camera from the joint point, over what is allowed; -inf where not used.

    What all points of a camera miss by is the rig's error: only `reprojection` limits it.
    """
    excess = np.full(used.shape, -np.inf)
    for c in range(len(used)):
        known = used[c] & np.isfinite(error[c]).all(axis=1)
        if not known.any():
            continue
        miss = error[c, known]
        away = np.linalg.norm(miss - np.median(miss, axis=0), axis=1)
        noise = np.trace(covariance[c, known], axis1=1, axis2=2)
        allowed = _MAX_DEVIATIONS * np.sqrt((_PER_MEDIAN * np.median(away)) ** 2 + noise)
        excess[c, known] = np.maximum(away / allowed, np.linalg.norm(miss, axis=1) / reprojection)
    return excess
