"""A session's object in finite elements: how it is filled, its loads, how deep its points lie."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array

from palpate.errors import InputError, MeshError
from palpate.geometry import TriangleMesh, closest_points, enclosed_volume
from palpate.probe import find_contact_patch, named_tangents
from palpate.records import FIXED, RIGID, Probing, Session
from palpate.shapes import Points
from palpate.solids import Solid, inner_points, make_solid, surface_values

# Number of elements; the volume of one over the cube of its edge.
ELEMENTS, VOLUME = 4500, 0.118
# Points along the side of a triangle where the pressure of a contact is taken.
_SAMPLES = 12


def depth_below(session: Session, points: Points) -> Float[np.ndarray, " p"]:
    """Distance of points from the free surface [m].

    Parameters
    ----------
    session : Session
    points : (p, 3) float [m]
    """
    free = np.delete(session.mesh.triangles, session.held_triangles, axis=0)
    return closest_points(TriangleMesh(session.mesh.vertices, free), points).distance


def no_field_reason(session: Session) -> str:
    """Why no modulus that differs from place to place is computed for a session, as a full
    sentence; empty where one is.

    Parameters
    ----------
    session : Session
    """
    first, *others = session.probings
    if all(probing.repeats(first) for probing in others):
        return (
            "A modulus that differs from place to place takes pushes at several places; here is a"
            " single one."
        )
    supports = session.supports
    # One support that moves takes the whole body along, whatever its moduli.
    still = len(supports) == 1 or all(support.motion == FIXED for support in supports)
    rigid = all(support.stiffness is None and support.directions is None for support in supports)
    pulled = any(probing.contact.profile == RIGID for probing in session.probings)
    loaded = session.added_gravity is not None or any(probing.loads for probing in session.probings)
    if still and rigid and not pulled and not loaded:
        return ""
    return (
        "A modulus that differs from place to place is computed for an object on a support that"
        " holds it still, pushed by one tool at a time: springs, rollers, supports that move"
        " against each other, further loads and weight are not among that."
    )


def filled(mesh: TriangleMesh, counts: Sequence[int]) -> tuple[Solid, float]:
    """The body in the fewest elements that fit into it, and their edge [m].

    Parameters
    ----------
    mesh : TriangleMesh
    counts : sequence of int        of elements, about, ascending

    Raises
    ------
    MeshError                       not even the most of them fit
    """
    volume = enclosed_volume(mesh)
    for count in counts:
        edge = (volume / (VOLUME * count)) ** (1.0 / 3.0)
        try:
            return make_solid(mesh, edge=edge), edge
        except MeshError:
            if count == counts[-1]:
                raise
    raise AssertionError


def elements_under(solid: Solid, load: Float[np.ndarray, "n3 k"]) -> csr_array:
    """Weights of the elements under some loads, (k, m): a node's share of a load goes to the
    elements about it.

    Parameters
    ----------
    solid : Solid
    load : (3 n, k) float [N]       nodal forces
    """
    share = np.linalg.norm(load.reshape(len(solid.nodes), 3, -1), axis=1)
    count = len(solid.elements)
    row = np.repeat(np.arange(count), solid.elements.shape[1])
    entries = (np.ones(row.size), (row, solid.elements.ravel()))
    incidence = csr_array(coo_array(entries, shape=(count, len(solid.nodes))))
    share /= share.sum(axis=0) * incidence.sum(axis=0)[:, None]
    return csr_array((incidence @ share).T)


def nodal_loads(session: Session, solid: Solid) -> Float[np.ndarray, "n3 k"]:
    """Nodal forces of every probing, (3 n, k) [N].

    Parameters
    ----------
    session : Session
    solid : Solid
    """
    loads = [_nodal_load(session, probing, solid) for probing in session.probings]
    return np.stack(loads, axis=1)


def nodal_shifts(session: Session, solid: Solid) -> Float[np.ndarray, "n3 k2"]:
    """Change of each probing's nodal forces as its contact moves by a standard deviation along
    each tangent, (3 n, 2 k) [N]; zero where it would reach the support.

    Parameters
    ----------
    session : Session
    solid : Solid
    """
    mesh, held, changes = session.mesh, session.held_triangles, []
    for probing in session.probings:
        contact, std = probing.contact, session.errors.contact_std(probing.name)
        patch = find_contact_patch(mesh, contact, held, name=probing.name)
        beside = std * named_tangents(mesh, patch)[0]
        places = closest_points(mesh, contact.point + np.concatenate([beside, -beside])).position
        try:
            first, second, *others = (
                _nodal_load(session, replace(probing, contact=replace(contact, point=point)), solid)
                for point in places
            )
        except InputError:
            first, second, *others = np.zeros((4, 3 * len(solid.nodes)))
        changes += [0.5 * (first - others[0]), 0.5 * (second - others[1])]
    return np.stack(changes, axis=1)


def _nodal_load(session: Session, probing: Probing, solid: Solid) -> Float[np.ndarray, " n3"]:
    """Nodal forces of the traction under a tool, (3 n,) [N]."""
    patch = find_contact_patch(
        session.mesh, probing.contact, session.held_triangles, name=probing.name
    )
    return nodal_load(session.mesh, patch.triangles, patch.density, probing.force, solid)


def nodal_load(
    mesh: TriangleMesh,
    triangles: Int[np.ndarray, " k"],
    density: Callable[..., Float[np.ndarray, " s"]],
    force: Float[np.ndarray, "3"],
    solid: Solid,
) -> Float[np.ndarray, " n3"]:
    """Nodal forces of a traction on a surface.

    Parameters
    ----------
    mesh : TriangleMesh
    triangles : (k,) int            that carry it
    density : function              triangle, barycentric coordinates, position -> (s,) float: the
                                    traction there, up to a factor
    force : (3,) float [N]          its resultant
    solid : Solid

    Returns
    -------
    (3 n,) float [N]
    """
    inside = inner_points(_SAMPLES)
    triangle = np.repeat(triangles, len(inside))
    barycentric = np.tile(inside, (len(triangles), 1))
    corner = mesh.vertices[mesh.triangles[triangle]]
    position = np.einsum("nv,nva->na", barycentric, corner)
    side = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    weight = density(triangle, barycentric, position) * np.linalg.norm(side, axis=1)
    loaded = weight > 0.0
    share = surface_values(solid, position[loaded]).T @ weight[loaded]
    return np.outer(share / share.sum(), force).ravel()
