"""Whether a rig fits the pictures that it is given with: epipolar geometry from sparse features."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from jaxtyping import Float

from palpate.errors import CalibrationError
from palpate.records import Rig
from palpate.vision.even_picture import make_even_picture
from palpate.vision.rectification import rectify_pair, remapped
from palpate.vision.sparse_motion import feature_matches

__all__ = ["RigCheck", "check_rig", "epipolar_residual"]

# Features are found to about half a pixel; a calibration that is off by more than this cannot be
# repaired by any pose of the object [px].
_LIMIT = 2.0
# Fewer matches that agree with each other may be chance.
_FEWEST = 12
# More cameras than this have too many orders to try.
_MOST_TO_SWAP = 4


@dataclass(frozen=True, slots=True)
class RigCheck:
    """How well the cameras' pictures agree with the rig.

    Attributes
    ----------
    residual : tuple of float [px]      median distance from the epipolar line of each camera but
                                        the reference, in the rig's order; NaN where too few match
    matches : tuple of int              features that these rest on
    notes : tuple of str                what could not be checked
    """

    residual: tuple[float, ...]
    matches: tuple[int, ...]
    notes: tuple[str, ...]


def check_rig(rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]]) -> RigCheck:
    """Compare the pictures of one instant with the epipolar geometry of the rig.

    Parameters
    ----------
    rig : Rig
    pictures : sequence of c (rows, columns) float [grey levels]    in the rig's order

    Returns
    -------
    RigCheck

    Raises
    ------
    CalibrationError                features lie off their epipolar lines by more than two pixels;
                                    the text says whether swapped pictures explain it
    """
    others = [c for c in range(len(rig.cameras)) if c != rig.reference]
    found = [epipolar_residual(rig, pictures, c) for c in others]
    residual = tuple(one[0] for one in found)
    matches = tuple(one[1] for one in found)
    notes = tuple(
        f"the pictures of cameras '{rig.cameras[rig.reference].name}' and '{rig.cameras[c].name}'"
        f" have only {count} features in common; the rig could not be checked with them"
        for c, count in zip(others, matches, strict=True)
        if count < _FEWEST
    )
    worst = max((value for value in residual if np.isfinite(value)), default=0.0)
    if worst > _LIMIT:
        raise CalibrationError(_explanation(rig, pictures, worst))
    return RigCheck(residual, matches, notes)


def epipolar_residual(
    rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]], other: int
) -> tuple[float, int]:
    """Median distance of features from their epipolar lines, reference to another camera.

    Parameters
    ----------
    rig : Rig
    pictures : sequence of c (rows, columns) float [grey levels]
    other : int                     index of the other camera

    Returns
    -------
    residual : float [px]           in the rectified pictures; NaN where fewer than 12 match
    matches : int
    """
    reference = rig.cameras[rig.reference]
    first, second = pictures[rig.reference], pictures[other]
    if first.shape != second.shape:
        return float("nan"), 0
    try:
        pair = rectify_pair(reference, rig.cameras[other], first.shape)
    except CalibrationError:
        # One camera stands in the other's view: epipolar lines are no lines in these pictures.
        return float("nan"), 0
    left, right = remapped(pair, 0, first), remapped(pair, 1, second)
    areas = [np.isfinite(one) for one in (left, right)]
    if not (areas[0].any() and areas[1].any()):
        return float("nan"), 0
    even = [make_even_picture(np.nan_to_num(one)).even for one in (left, right)]
    found = feature_matches(even[0], even[1], areas[0], areas[1])
    if len(found.point) < _FEWEST:
        return float("nan"), len(found.point)
    across = found.displacement[:, 1 - pair.axis[0]]
    return float(np.median(np.abs(across))), len(found.point)


def _explanation(rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]], worst: float) -> str:
    """Why the rig does not fit, as far as another order of the pictures tells."""
    found = f"{rig.source}: features lie {worst:.1f} px off their epipolar lines"
    order = _better_order(rig, pictures)
    if order is None:
        return (
            f"{found}, and no other order of the pictures makes it better; is this the calibration"
            " of these pictures, was a camera moved since, are the pictures cropped or scaled?"
        )
    names = [camera.name for camera in rig.cameras]
    moved = [
        f"'{names[k]}' shows what '{names[order[k]]}' should"
        for k in range(len(names))
        if order[k] != k
    ]
    return (
        f"{found}; the pictures look swapped: {', '.join(moved)}. Rename the files or the cameras"
    )


def _better_order(rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]]) -> tuple[int, ...] | None:
    """Camera that each picture belongs to, where another order than the given one fits."""
    count = len(rig.cameras)
    if count > _MOST_TO_SWAP:
        return None
    best: tuple[float, tuple[int, ...]] | None = None
    for order in permutations(range(count)):
        if order == tuple(range(count)):
            continue
        given = [pictures[order.index(c)] for c in range(count)]
        worst = _worst(rig, given)
        if worst <= _LIMIT and (best is None or worst < best[0]):
            best = (worst, order)
    return None if best is None else best[1]


def _worst(rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]]) -> float:
    """Largest epipolar residual, infinite where a pair has nothing in common."""
    values = []
    for c in range(len(rig.cameras)):
        if c != rig.reference:
            residual, _ = epipolar_residual(rig, pictures, c)
            values.append(residual if np.isfinite(residual) else np.inf)
    return max(values)
