"""The outward part of a sphere's pressure.

A sphere without friction presses along its own normals, which lean outward by r / R at the
distance r from the middle of the touched circle. The outward traction p r / R has no resultant,
but it widens the dent: left out, it makes nu 0.004 too large on the facility's half ball. It is
minus the gradient of a potential Q(r): so it is what Q does, as a traction along each of two
tangents, when it is shifted along that tangent.
"""

import numpy as np
from jaxtyping import Float

from palpate.bem import (
    BoundarySystem,
    LoadCells,
    PressureDisc,
    RightHand,
    SurfaceLoad,
    load_right_hand,
    load_shape,
)
from palpate.geometry import unit_normals
from palpate.probe import ContactPatch
from palpate.records import SLIDES, SPHERE

# Of the touched radius: a central difference over twice this far is exact to its square.
_SHIFT = 0.05
# Integral of Q over the circle, over force and a^2 / R, where the pressure is Hertz's.
_INTEGRAL = 0.2


def leans_outward(patch: ContactPatch) -> bool:
    """Whether a patch's pressure has an outward part: under a sphere that slides."""
    tool = patch.contact.tool
    return tool is not None and tool.shape == SPHERE and tool.friction == SLIDES


def outward_columns(
    system: BoundarySystem, patch: ContactPatch, *, cells: LoadCells | None = None
) -> RightHand:
    """What the outward traction adds to the columns of a patch, for one newton along each axis.

    Parameters
    ----------
    system : BoundarySystem
    patch : ContactPatch            of a sphere
    cells : LoadCells or None       see `load_points`

    Returns
    -------
    RightHand                       three columns: the pressure counts, and forces along the surface
                                    add nothing

    Source
    ------
    The traction p r / R of a frictionless sphere of radius R, with Hertz's p (Johnson, Contact
    Mechanics, 1985, section 4.2, there neglected as small).
    """
    contact = patch.contact
    if contact.tool is None or contact.radius is None:
        return RightHand(np.zeros((3, system.size, 3)))
    normal = unit_normals(system.surface.mesh)[patch.triangle]
    tangents = np.linalg.svd(normal[None])[2][1:]
    step = _SHIFT * contact.radius
    size = _INTEGRAL * contact.radius**2 / contact.tool.radius / (2.0 * step)
    loads, forces = [], []
    for tangent in tangents:
        for side in (1.0, -1.0):
            loads.append(_potential_load(patch, contact.point + side * step * tangent))
            forces.append(side * size * tangent)
    shapes = [load_shape(system.surface, load) for load in loads]
    parts = load_right_hand(system, loads, shapes, forces=np.array(forces), cells=cells)
    return RightHand(parts.terms.sum(axis=2)[:, :, None] * -normal)


def _potential(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Q at a distance over the touched radius, up to a factor."""
    return np.clip(1.0 - s**2, 0.0, None) ** 1.5


def _potential_load(patch: ContactPatch, centre: Float[np.ndarray, "3"]) -> SurfaceLoad:
    """Q as a load, about a centre of its own."""
    radius = patch.contact.radius or 0.0

    def density(triangle: np.ndarray, barycentric: np.ndarray, position: np.ndarray) -> np.ndarray:
        return _potential(np.linalg.norm(position - centre, axis=1) / radius)

    return SurfaceLoad(patch.triangles, density, PressureDisc(centre, radius, _potential))
