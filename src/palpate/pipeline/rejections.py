"""Which vertices could not be tracked in the pictures, and whether their number is usual."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.geometry import unit_normals
from palpate.records import Probing, Rig, Session, camera_centre, observed_rows, read_rig
from palpate.shapes import Flags, Points

# Distance within which the tool and its shadow hide the surface, in contact radii. On the virtual
# bench half of the vertices within it are lost.
TOOL_RADII = 6.0
# Cosine between the surface normal and the line of sight: beyond 60 degrees a window is twice as
# long on the surface as in the picture. On the bench nearly all vertices lost elsewhere are so
# inclined to all cameras but one.
OBLIQUE = 0.5
# Fraction of the vertices in full view that may be lost before the pictures are to blame; 0 to 3 %
# on the bench.
_USUAL = 0.1


@dataclass(frozen=True, slots=True)
class Rejections:
    """Counts of one probing's observed vertices, and of the lost ones by location.

    Attributes
    ----------
    name : str                      of the probing
    seen : int                      vertices that were observed, measured or not
    near_tool : int                 lost within six contact radii of the contact
    oblique : int                   lost elsewhere, where fewer than two cameras look at the surface
                                    within 60 degrees of its normal
    in_view : int                   lost in full view
    """

    name: str
    seen: int
    near_tool: int
    oblique: int
    in_view: int

    @property
    def lost(self) -> int:
        """Number of all vertices that were not measured."""
        return self.near_tool + self.oblique + self.in_view


def rejections(session: Session) -> tuple[Rejections, ...]:
    """Count the vertices that could not be tracked in the pictures, by location.

    Parameters
    ----------
    session : Session               with displacements from its pictures

    Returns
    -------
    tuple of Rejections             one for every probing with pictures; none without a rig

    Raises
    ------
    RecordError, CalibrationError   the rig cannot be read, or contradicts itself
    """
    if session.rig is None:
        return ()
    rig, normals = read_rig(session.rig), unit_normals(session.mesh)
    return tuple(
        _rejections(probing, rig, normals[probing.displacement.surface.triangle])
        for probing in session.probings
        if probing.images and probing.displacement is not None
    )


def rejection_note(counts: Sequence[Rejections]) -> str:
    """Note on the number and location of lost vertices, and whether that is usual.

    Parameters
    ----------
    counts : sequence of Rejections     at least one

    Returns
    -------
    str
    """
    seen, lost = (sum(getattr(each, name) for each in counts) for name in ("seen", "lost"))
    tool, oblique, view = (
        sum(getattr(each, name) for each in counts) for name in ("near_tool", "oblique", "in_view")
    )
    text = (
        f"{lost} of {seen} vertices that a camera saw were not measured"
        f" ({100 * lost / max(seen, 1):.0f} %): {tool} within {TOOL_RADII:g} contact radii of the"
        f" tool, which covers them, {oblique} where fewer than two cameras look at the surface"
        f" within 60 degrees of its normal, and {view} in full view."
    )
    if view <= _USUAL * max(seen - tool - oblique, 1):
        return text + " That is as usual: what cannot be followed is left out, not guessed."
    return text + (
        " So many in full view are unusual: `palpate flow` draws which and says why; most often"
        " the speckle is too coarse, too fine or too faint, or a picture is out of focus."
    )


def _rejections(probing: Probing, rig: Rig, normals: Points) -> Rejections:
    field = probing.displacement
    if field is None:
        return Rejections(probing.name, 0, 0, 0, 0)
    lost = ~observed_rows(field)
    # A contact without a radius hides nothing.
    reach = TOOL_RADII * (probing.contact.radius or 0.0)
    near = np.linalg.norm(field.points - probing.contact.point, axis=1) < reach
    inclined = ~near & ~_faced(field.points, normals, rig)
    counts = [int((lost & where).sum()) for where in (near, inclined, ~near & ~inclined)]
    return Rejections(probing.name, len(lost), *counts)


def _faced(points: Points, normals: Points, rig: Rig) -> Flags:
    """Whether at least two cameras see each point within 60 degrees of its normal."""
    cosines: list[Float[np.ndarray, " n"]] = []
    for camera in rig.cameras:
        sight = camera_centre(camera) - points
        sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
        cosines.append(np.einsum("nk,nk->n", normals, sight))
    return (np.array(cosines) > OBLIQUE).sum(axis=0) >= 2
