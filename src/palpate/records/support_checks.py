"""Consistency of supports, their motions and the forces on them."""

from collections.abc import Sequence

import numpy as np

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.records.contacts.pressure import RIGID
from palpate.records.probing import Probing
from palpate.records.support import FIXED, FREE, GIVEN, Support
from palpate.shapes import Indices

# Largest fraction of a force perpendicular to a roller's held directions, for its small friction.
_MAX_PERPENDICULAR = 0.05
# A direction counts as held by other supports if the squared sine of its angle to their free
# directions exceeds this, that of half a degree.
_MIN_HELD_SINE_SQUARED = 1e-4


def check_supports(
    mesh: TriangleMesh, supports: Sequence[Support], probings: Sequence[Probing]
) -> None:
    """Refuse supports that touch, and motions or forces that are inconsistent with them.

    Parameters
    ----------
    mesh : TriangleMesh
    supports : sequence of Support
    probings : sequence of Probing

    Raises
    ------
    InputError                      the text names supports by their number from 1, and the probing
    """
    for second in range(len(supports)):
        for first in range(second):
            _check_disjoint(mesh, supports, first, second)
    given = [number for number, support in enumerate(supports, start=1) if support.motion == GIVEN]
    for probing in probings:
        _check_motion(probing, given)
        if probing.contact.profile == RIGID and probing.contact.triangles is not None:
            _check_pulled_support(probing, probing.contact.triangles, supports)


def _check_disjoint(mesh: TriangleMesh, supports: Sequence[Support], i: int, j: int) -> None:
    """Refuse supports that share a triangle, or, unless both are fixed, a vertex."""
    first, second = supports[i], supports[j]
    shared_triangles = np.intersect1d(first.triangles, second.triangles).size
    if shared_triangles:
        raise InputError(
            f"supports {i + 1} and {j + 1} share {shared_triangles} triangles; a triangle belongs"
            " to one of them: correct the selectors"
        )
    corners, others = (np.unique(mesh.triangles[x.triangles]) for x in (first, second))
    shared_vertices = np.intersect1d(corners, others).size
    if shared_vertices and (first.motion != FIXED or second.motion != FIXED):
        raise InputError(
            f"supports {i + 1} and {j + 1} share {shared_vertices} vertices, which cannot"
            " follow both; leave a row of free triangles between them"
        )


def _check_motion(probing: Probing, given: Sequence[int]) -> None:
    """Refuse a support motion that is missing, or that no support expects."""
    place = f"probing '{probing.name}'"
    has_motion = probing.support_motion is not None
    if given and not has_motion and probing.support_displacement is None:
        raise InputError(
            f"{place}: the motion of support {given[0]} is to be given; name the file of its"
            " displacements as support_displacement, or a rigid motion as support_motion"
        )
    if not given and (has_motion or probing.support_displacement is not None):
        raise InputError(
            f'{place}: gives a motion of the support, but no support has motion = "given"; say so'
            " in [support], or leave it out"
        )
    if has_motion and len(given) > 1:
        raise InputError(
            f"{place}: support_motion is one motion, but that of {len(given)} supports is to be"
            " given; give support_displacement, with points on each of them"
        )


def _check_pulled_support(
    probing: Probing, triangles: Indices, supports: Sequence[Support]
) -> None:
    """Refuse a force on a support that is not free to move, or without another support to react."""
    place = f"probing '{probing.name}'"
    pulled = [
        number
        for number, support in enumerate(supports, start=1)
        if np.array_equal(support.triangles, triangles)
    ]
    if not pulled or len(supports) < 2:
        raise InputError(
            f"{place}: its force acts on a support, but no other support is there to react against"
            " it; select the other grip in a [[support]] of its own"
        )
    if supports[pulled[0] - 1].motion != FREE:
        raise InputError(
            f"{place}: its force acts on support {pulled[0]}, whose motion is"
            f" '{supports[pulled[0] - 1].motion}'; a support that is pulled moves as the force"
            ' makes it: say motion = "free", and give its measured points in the displacement file'
        )
    _check_pull_direction(probing, supports, pulled[0])
    if probing.tip_displacement is not None:
        raise InputError(
            f"{place}: tip_displacement is of a tool's contact point, but the force acts on a"
            " support; give the displacement of the grip in the displacement file"
        )


def _check_pull_direction(probing: Probing, supports: Sequence[Support], number: int) -> None:
    """Refuse a force outside the pulled support's held directions, or in a direction along which no
    other support reacts."""
    place = f"probing '{probing.name}': its force acts on support {number}"
    holding = supports[number - 1].holding
    perpendicular = float(np.linalg.norm(probing.force - holding @ probing.force))
    if perpendicular > _MAX_PERPENDICULAR * float(np.linalg.norm(probing.force)):
        raise InputError(
            f"{place}, a roller, and {perpendicular:.3g} N of it are across its directions, along"
            " which it slides: give the part along them, or hold those directions too (directions"
            " in [[support]])"
        )
    others = sum(support.holding for k, support in enumerate(supports, start=1) if k != number)
    value, vector = np.linalg.eigh(holding @ others @ holding + np.eye(3) - holding)
    if value[0] < _MIN_HELD_SINE_SQUARED:
        axis = ", ".join(f"{x:.3g}" for x in np.round(vector[:, 0], 3) + 0.0)
        raise InputError(
            f"{place}, and along ({axis}) no other support holds the object, which would follow:"
            " hold that direction elsewhere, or make support"
            f" {number} a roller that does not hold it (directions in [[support]])"
        )
