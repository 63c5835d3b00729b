"""Response to a push that was not measured, on an object of known constants: displacement and
stress."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.bem import (
    BoundarySystem,
    ElasticMap,
    InteriorState,
    SurfaceLoad,
    check_memory,
    held_system,
    interior_state,
    make_elastic_map,
)
from palpate.errors import InputError
from palpate.field import make_map_response, nodal_load
from palpate.geometry import bounding_diagonal, interpolation_matrix, unit_normals
from palpate.pipeline.contacts import settled_contact
from palpate.pipeline.model.contact_loads import outward_pushes, surface_load
from palpate.pipeline.model.grading import graded_session, refined_session
from palpate.pipeline.model.supports import (
    check_balance,
    compliances,
    compliant_supports,
    session_springs,
    session_surface,
    sliding_motion,
)
from palpate.probe import ContactPatch, find_contact_patch
from palpate.progress import Progress, silent
from palpate.records import Contact, ModulusMap, Session, require_probings
from palpate.shapes import Points, Vector3, Vertices


@dataclass(frozen=True, slots=True, eq=False)
class PokedState:
    """Response of an object to a tool, without that to gravity.

    Attributes
    ----------
    contact : Contact
    displacement : (3,) float [m]           of the contact point
    largest : (3,) float [m]                displacement of the vertex that moves most
    largest_point : (3,) float [m]          that vertex
    reaction : (3,) float [N]               force of the support on the object
    interior : InteriorState or None        displacement and stress at interior points; None: no
                                            points were requested
    """

    contact: Contact
    displacement: Vector3
    largest: Vector3
    largest_point: Vector3
    reaction: Vector3
    interior: InteriorState | None

    def __repr__(self) -> str:
        here = ", ".join(f"{1e3 * x:.3g}" for x in self.displacement)
        most = 1e3 * float(np.linalg.norm(self.largest))
        return f"PokedState: the contact moves by ({here}) mm, no vertex by more than {most:.3g} mm"


def poke_session(
    session: Session,
    force: Vector3,
    contact: Contact,
    *,
    shear_modulus: float,
    poisson_ratio: float,
    modulus: ModulusMap | None = None,
    interior: Points | None = None,
    cache: Path | None = None,
    progress: Progress = silent,
) -> PokedState:
    """Response of a session's object to a tool that presses on it.

    Parameters
    ----------
    session : Session
    force : (3,) float [N]              of the tool on the object, object frame
    contact : Contact                   where it presses; the radius under a tool follows from the
                                        force and the constants
    shear_modulus : float [Pa]          > 0
    poisson_ratio : float [-]           -1 < nu <= 0.5
    modulus : ModulusMap or None        None: the same everywhere
    interior : (n, 3) float [m]         points inside the object, at least 5 % of a triangle's
                                        radius from its surface
    cache : Path or None                folder in which what is computed of the body is kept
    progress : callable                 called with the current step (text) and the fraction done

    Returns
    -------
    PokedState

    Raises
    ------
    InputError                          points inside a body that is not the same everywhere;
                                        constants out of range, a contact off the surface or on the
                                        support, a tool that pulls or is buried, a point outside or
                                        too close to the surface
    SingularSystemError                 the support does not hold the object
    NotConvergedError                   the iteration for a large object does not converge
    """
    _check_interior(modulus, interior)
    contact = settled_contact(
        session, contact, force, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio
    )
    # A point off the surface is refused before the integrals are computed.
    find_contact_patch(
        session.mesh, contact, session.held_triangles, name="the tool", point_name="the point (at)"
    )
    progress("integrals over the surface", 0.0)
    dense = bool(compliant_supports(session))
    session, system = held_object(session, [contact], cache=cache, dense=dense)
    patch = find_contact_patch(
        session.mesh, contact, session.held_triangles, name="the tool", point_name="the point (at)"
    )
    check_balance(sliding_motion(session), [(contact.point, force)], "the tool")
    progress("factorisation", 0.6)
    elastic_map = make_elastic_map(
        system, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio,
        springs=session_springs(session, system), compliance=compliances(session),
    )  # fmt: skip
    # The outward traction under the tool is made of loads of its own.
    normal = unit_normals(session.mesh)[patch.triangle]
    pushes = [(surface_load(patch), force), *outward_pushes(patch, normal, force)]
    loads, forces = zip(*pushes, strict=True)
    displacement, at_contact, reaction = _pressed(elastic_map, loads, np.array(forces), patch)
    if modulus is not None:
        change = _map_change(session, modulus, poisson_ratio, patch, force) / shear_modulus
        nodes = system.surface.displacement
        where = interpolation_matrix(nodes, np.array([patch.triangle]), patch.barycentric[None])
        displacement, at_contact = displacement + change, at_contact + (where @ change)[0]
    progress("interior points", 0.8)
    inside = None
    if interior is not None:
        parts = [
            interior_state(elastic_map, load, push_force, interior) for load, push_force in pushes
        ]
        inside = InteriorState(
            np.sum([part.displacement for part in parts], axis=0),
            np.sum([part.stress for part in parts], axis=0),
        )
    farthest = int(np.argmax(np.linalg.norm(displacement, axis=1)))
    return PokedState(
        contact=contact,
        displacement=at_contact,
        largest=displacement[farthest],
        largest_point=session.mesh.vertices[farthest],
        reaction=reaction,
        interior=inside,
    )


def _pressed(
    elastic_map: ElasticMap,
    loads: Sequence[SurfaceLoad],
    forces: Float[np.ndarray, "k 3"],
    patch: ContactPatch,
) -> tuple[Vertices, Vector3, Vector3]:
    """Displacement of the vertices and of the contact point under loads together, and the reaction
    of the support."""
    states = elastic_map.respond(loads, forces)
    displacement, reaction = (
        np.sum([getattr(state, name) for state in states], axis=0)
        for name in ("displacement", "reaction")
    )
    at_contact = elastic_map.at_point(loads, forces, states, patch.triangle, patch.barycentric)
    return displacement, at_contact, reaction


def _check_interior(modulus: ModulusMap | None, interior: Points | None) -> None:
    """Refuse points inside a body that is not the same everywhere."""
    if modulus is not None and interior is not None:
        raise InputError(
            "points inside are computed where the modulus is the same everywhere, but this object"
            " has a map of it: leave --interior out"
        )


def _map_change(
    session: Session,
    modulus: ModulusMap,
    poisson_ratio: float,
    patch: ContactPatch,
    force: Vector3,
) -> Points:
    """What a map changes in the displacement of every vertex, times the modulus [m Pa]."""
    changed = make_map_response(session, modulus, poisson_ratio)
    load = nodal_load(session.mesh, patch.triangles, patch.density, force, changed.solid)
    change = changed.at(session.mesh.vertices) @ changed.change(load[:, None])
    return change.reshape(-1, 3)


def held_object(
    session: Session,
    contacts: Sequence[Contact] | None = None,
    *,
    cache: Path | None = None,
    dense: bool = False,
) -> tuple[Session, BoundarySystem]:
    """The boundary element model of a session's object without any load.

    Parameters
    ----------
    session : Session
    contacts : sequence of Contact or None    where it is pressed; None: as its probings say
    cache : Path or None                folder in which what is computed of the body is kept
    dense : bool                        True: dense matrices for a mesh of any size

    Returns
    -------
    Session                             the same on a mesh graded at the rims of its supports
    BoundarySystem                      of that mesh

    Raises
    ------
    InputError                          the model does not fit into memory
    """
    session = graded_session(refined_session(session, contacts))
    rollers = any(support.directions is not None for support in session.supports)
    check_memory(len(session.mesh.vertices), rollers=rollers, dense=dense)
    return session, held_system(session_surface(session), dense=dense, cache=cache)


def tool_contact(session: Session, point: Vector3, radius: float | None) -> Contact:
    """The contact of a session's first probing, moved to another point.

    Parameters
    ----------
    session : Session                   with probings
    point : (3,) float [m]
    radius : float or None [m]          None: that of the first probing, or what its tool touches

    Returns
    -------
    Contact

    Raises
    ------
    InputError                          no probings; a radius that is not positive or exceeds half
                                        the object's size; no radius, and the first probing has none
    """
    require_probings(session)
    first, size = session.probings[0].contact, bounding_diagonal(session.mesh)
    if radius is not None and 2.0 * radius > size:
        raise InputError(
            f"the contact is wider than the body: its radius is {radius:.3g} m, the mesh is"
            f" {size:.3g} m across; give the radius of the patch in metres, or with its unit"
        )
    if first.radius is not None:
        if radius is None:
            return replace(first, point=point)
        return Contact(point, radius, first.profile)
    if radius is None:
        raise InputError(
            f"{session.path}: its first probing presses on no round patch, so there is no radius;"
            " give one with --radius: under a point the displacement grows without bound as the"
            " mesh gets finer"
        )
    return Contact(point, radius, "smooth")


def von_mises_stress(stress: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, " n"]:
    """Von Mises equivalent stress: the uniaxial stress of equal distortion energy.

    Parameters
    ----------
    stress : (n, 3, 3) float [Pa]       symmetric

    Returns
    -------
    (n,) float [Pa]                     sqrt(3/2 s : s) of the deviator s, >= 0

    Source
    ------
    von Mises, Nachrichten von der Gesellschaft der Wissenschaften zu Goettingen (1913), 582
    """
    mean = np.trace(stress, axis1=1, axis2=2) / 3.0
    deviator = stress - mean[:, None, None] * np.eye(3)
    return np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))
