"""A session's object in finite elements, for presses at finite strain: its loads, the tips of its
tools, the points that are seen; and what is not served."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array

from palpate.errors import InputError
from palpate.geometry import mesh_quality
from palpate.pipeline.model.contact_loads import outward_load
from palpate.pipeline.model.grading import halved_session
from palpate.records import (
    FIXED,
    SLIDES,
    Contact,
    FlatFace,
    Probing,
    Session,
    ShapedTool,
    Sphere,
)
from palpate.shapes import Points, Vector3
from palpate.solids import (
    Solid,
    Tip,
    held_nodes,
    make_solid,
    nodal_volumes,
    pressure_load,
    surface_values,
)

# Element size away from the tools over the mean edge of the mesh. Over the contact radius: radius
# of the region under a tool, whose own shape tells where it touches, or under a pressure, and
# element size there; the same along the rim of a flat face, where pressure is without bound.
_COARSE = 1.5
_UNDER, _UNDER_PRESSURE = {Sphere: (1.0, 0.6), FlatFace: (1.3, 1.0)}, (1.3, 0.4)
_AT_RIM = (0.12, 0.16)


@dataclass(frozen=True, slots=True, eq=False)
class FiniteBody:
    """A session's object in finite elements, with its loads and observed points.

    Attributes
    ----------
    solid : Solid
    held : (n,) bool                     nodes that are fixed
    loads : tuple of (n, 3) float [N]    nodal forces of each push, as in the linear model
    weight : (n, 3) float [N]            nodal forces of the weight under each push
    at_rest : bool                       whether that acts before each push, too
    tips : tuple of Tip or None          of each probing, where its contact is solved for at finite
                                         strain; None: the load stays as it is
    same : tuple of int                  of each probing: the first one that presses as it does
    observed : tuple of sparse (p, n)    of each probing: takes nodes to its points and, where the
                                         tip's displacement was measured, to the contact point
    """

    solid: Solid
    held: Bool[np.ndarray, " n"]
    loads: tuple[Float[np.ndarray, "n 3"], ...]
    weight: Float[np.ndarray, "n 3"]
    at_rest: bool
    tips: tuple[Tip | None, ...]
    same: tuple[int, ...]
    observed: tuple[csr_array, ...]


def make_finite_body(session: Session, *, coarser: float = 1.0) -> FiniteBody:
    """Fill a session's object with tetrahedra, finer under its tools.

    Parameters
    ----------
    session : Session
    coarser : float [-]             factor on the usual edge length of all elements

    Returns
    -------
    FiniteBody

    Raises
    ------
    InputError                      of `require_finite_strain`
    MeshError                       the surface cannot be filled
    """
    require_finite_strain(session)
    tips = tuple(tip_of(probing) for probing in session.probings)
    fine = [
        region
        for probing, tip in zip(session.probings, tips, strict=True)
        for region in _fine_regions(probing.contact, tip, coarser)
    ]
    edge = coarser * _COARSE * mesh_quality(session.mesh).edge_mean
    if any(tips):
        # A tool meets the surface as it is curved.
        session = halved_session(session)
    solid = make_solid(session.mesh, edge=edge, fine=fine)
    loads, keys, observed = [], [], []
    for probing in session.probings:
        share = pressure_load(
            solid,
            probing.contact.point,
            float(probing.contact.radius or 0.0),
            probing.contact.pressure,
        )
        outward = outward_load(solid, probing.contact, probing.force)
        loads.append(share[:, None] * probing.force + outward)
        keys.append((loads[-1].tobytes(), probing.contact.tool, probing.contact.start.tobytes()))
        observed.append(surface_values(solid, _places(probing)))
    held = held_nodes(solid, session.held_triangles)
    same = tuple(map(keys.index, keys))
    weight, at_rest = _weight(solid, session), session.gravity_at_rest
    return FiniteBody(solid, held, tuple(loads), weight, at_rest, tips, same, tuple(observed))


def _weight(solid: Solid, session: Session) -> Float[np.ndarray, "n 3"]:
    """Nodal forces of the weight [N]; zero without gravity."""
    if session.gravity is None or session.density is None:
        return np.zeros_like(solid.nodes)
    return np.outer(nodal_volumes(solid), session.density * session.gravity)


def _fine_regions(
    contact: Contact, tip: Tip | None, coarser: float
) -> list[tuple[Vector3, float, float]]:
    """Where elements are finer: point, reach and edge (`make_solid`)."""
    radius = float(contact.radius or 0.0)
    reach, size = _UNDER_PRESSURE if tip is None else _UNDER[type(tip.tool)]
    regions = [(contact.point, reach * radius, coarser * size * radius)]
    if tip is not None and tip.tool.is_flat:
        reach, edge = _AT_RIM[0] * tip.radius, coarser * _AT_RIM[1] * tip.radius
        regions += [(point, reach, edge) for point in tip.rim(edge)]
    return regions


def tip_of(probing: Probing) -> Tip | None:
    """A ball or a flat face that slides and moves along the force, through the point that it
    touched first; None: a fixed patch."""
    tool = probing.contact.tool
    if not isinstance(tool, Sphere | FlatFace) or tool.friction != SLIDES:
        return None
    return Tip(tool, probing.contact.start, probing.force)


def _places(probing: Probing) -> Points:
    """Points of a probing, and its contact point where the tip's displacement was measured."""
    field = probing.displacement
    points = np.zeros((0, 3)) if field is None else field.surface.position
    if probing.tip_displacement is None:
        return points
    return np.vstack([points, probing.contact.point])


def require_finite_strain(session: Session) -> None:
    """Refuse supports and loads that are not served at finite strain.

    Parameters
    ----------
    session : Session               before or after its contacts are fitted

    Raises
    ------
    InputError                      a support that moves or slides, a load on no round patch, or
                                    without bound
    """
    for number, support in enumerate(session.supports, start=1):
        if support.motion != FIXED or support.directions is not None:
            raise InputError(
                f"finite strain: support {number} moves or slides; only supports that are fixed are"
                " served: leave --strain finite out"
            )
    for probing in session.probings:
        contact = probing.contact
        if contact.has_sharp_rim and tip_of(probing) is None:
            raise InputError(
                f"finite strain: probing '{probing.name}' has the pressure of a flat face, which"
                " no object bears at its rim; name the tool that slides, or take another profile"
            )
        if probing.loads or contact.radius is None or isinstance(contact.tool, ShapedTool):
            raise InputError(
                f"finite strain: probing '{probing.name}' has a load that is no round patch under a"
                " tool; leave --strain finite out"
            )
