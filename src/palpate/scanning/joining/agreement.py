"""Agreement of the views of an object on the position of its surface."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from palpate.errors import InputError
from palpate.scanning.views.view import View

# Points of a view that are compared with the others.
_SAMPLES = 4000
# Minimum fraction of a view's points with points of others nearby; the distance that counts as
# nearby, as a fraction of the object's size.
_OVERLAP, _NEAR = 0.1, 0.03
# Largest offset of a view from the others, in standard deviations of a point, or as a fraction of
# the size if that is larger.
_OFF, _OFF_SIZE = 4.0, 2e-3


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of a view with the others.

    Attributes
    ----------
    name : str
    points : int                    number of points
    overlap : float [-]             fraction of its points that other views show too
    offset : float [m]              median absolute distance from the others' surface there
    """

    name: str
    points: int
    overlap: float
    offset: float


def agreements(views: Sequence[View]) -> tuple[Agreement, ...]:
    """Check the agreement of views, all in one frame, with each other.

    Parameters
    ----------
    views : sequence of View        in the object's frame

    Returns
    -------
    tuple of Agreement              overlap 0 and offset 0 for a single view

    Raises
    ------
    InputError                      a view overlaps the others too little, or contradicts them
    """
    if len(views) == 1:
        return (Agreement(views[0].name, len(views[0].points), 0.0, 0.0),)
    everything = np.concatenate([view.points for view in views])
    size = float(np.linalg.norm(np.ptp(everything, axis=0)))
    found = tuple(_agreement(views, k, _NEAR * size) for k in range(len(views)))
    for one, view in zip(found, views, strict=True):
        if one.overlap < _OVERLAP:
            raise InputError(
                f"view '{one.name}' shows {100.0 * one.overlap:.0f} % of what others show, too"
                f" little to be joined ({100.0 * _OVERLAP:.0f} % at least): take views between, or"
                " check its pose and unit"
            )
        allowed = max(_OFF * float(np.median(view.sigma)), _OFF_SIZE * size)
        if one.offset > allowed:
            raise InputError(
                f"view '{one.name}' contradicts the others: half of its points are"
                f" {1e3 * one.offset:.2g} mm or more off their surface, {1e3 * allowed:.2g} mm are"
                " in the noise; the object moved between the views, or its pose is wrong: leave it"
                " out, or leave all poses out to have them estimated"
            )
    return found


def _agreement(views: Sequence[View], k: int, near: float) -> Agreement:
    view = views[k]
    step = max(1, len(view.points) // _SAMPLES)
    points, normals = view.points[::step], view.normals[::step]
    others = [other for j, other in enumerate(views) if j != k]
    place = np.concatenate([other.points for other in others])
    facing = np.concatenate([other.normals for other in others])
    gap, index = cKDTree(place).query(points, k=8, distance_upper_bound=near)
    both = np.isfinite(gap)
    index = np.where(both, index, 0)
    both &= np.einsum("nka,na->nk", facing[index], normals) > 0.7
    seen = both.any(axis=1)
    height = np.einsum("nka,nka->nk", points[:, None] - place[index], facing[index])
    height = np.ma.median(np.ma.array(height, mask=~both), axis=1).filled(0.0)
    off = float(np.median(abs(height[seen]))) if seen.any() else 0.0
    return Agreement(view.name, len(view.points), float(seen.mean()), off)
