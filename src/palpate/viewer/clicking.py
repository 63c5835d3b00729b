"""What a click on the object does: support and contacts of session.toml, and a pressed ball.

Support and contacts are set in a draft that is written into session.toml. A ball pressed into the
object at a chosen point gives its force, and the surface displacement.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from palpate.contact import ContactState, PlacedTool
from palpate.disk import atomic_replacement, free_name, new_files
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, closest_points, unit_normals
from palpate.records import Session, Sphere, read_session, read_text
from palpate.shapes import Indices, Vector3, Vertices
from palpate.simulation import (
    GreenFunctions,
    force_covariance,
    start_contact,
    surface_displacement,
    touch,
)

_SUPPORT_FILE = "support_triangles.txt"
_SELECTORS = ("plane", "box", "triangles")
# Least cosine between the normals of a flat face's triangles.
_FLAT = 0.985
_DIGITS = 9
# Initial gap, and largest step, as fractions of the ball's radius.
_INITIAL_GAP, _MAX_STEP = 1e-3, 0.02


@dataclass(frozen=True, slots=True)
class Draft:
    """Changes that are not written yet.

    Attributes
    ----------
    support : (k,) int or None      held triangles; None: as in the session
    contacts : mapping              name of a probing -> contact point, (3,) float [m]
    """

    support: Indices | None = None
    contacts: dict[str, Vector3] = field(default_factory=dict)

    def with_support(self, triangles: Indices) -> "Draft":
        """A copy with another support."""
        return replace(self, support=np.unique(triangles))

    def with_contact(self, probe: str, point: Vector3) -> "Draft":
        """A copy with another contact point [m] of a probing."""
        return replace(self, contacts=self.contacts | {probe: point})


def flat_face(mesh: TriangleMesh, triangle: int) -> Indices:
    """The flat face of a triangle: connected triangles with nearly the same normal.

    Parameters
    ----------
    mesh : TriangleMesh
    triangle : int

    Returns
    -------
    (k,) int                        including the triangle itself
    """
    normals = unit_normals(mesh)
    rows = np.flatnonzero(normals @ normals[triangle] > _FLAT)
    corners = mesh.triangles[rows]
    sides = np.sort(np.stack([corners, np.roll(corners, 1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    side = np.unique(sides, axis=0, return_inverse=True)[1].ravel()
    of_side = csr_array((np.ones(len(side)), (np.repeat(np.arange(len(rows)), 3), side)))
    part = connected_components(of_side @ of_side.T)[1]
    return np.asarray(rows[part == part[np.searchsorted(rows, triangle)]])


def triangles_near(mesh: TriangleMesh, point: Vector3, radius: float) -> Indices:
    """Triangles whose centroid lies within a ball.

    Parameters
    ----------
    mesh : TriangleMesh
    point : (3,) float [m]
    radius : float [m]

    Returns
    -------
    (k,) int
    """
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    return np.flatnonzero(np.linalg.norm(middle - point, axis=1) <= radius)


def draft_files(session: Session, draft: Draft) -> tuple[Path, ...]:
    """Files that `write_draft` writes.

    Parameters
    ----------
    session : Session
    draft : Draft

    Returns
    -------
    tuple of Path                   if the support was changed, a new file for its triangles, whose
                                    name is still free; last the session's, which is changed

    Raises
    ------
    InputError                      no changes
    """
    if draft.support is None and not draft.contacts:
        raise InputError("nothing was set; click on the object first")
    if draft.support is None:
        return (session.path,)
    return free_name(*_support_list(session, draft.support)), session.path


def _support_list(session: Session, triangles: Indices) -> tuple[Path, bytes]:
    """The file of held triangles: the name that is wanted, and its content."""
    content = "".join(f"{row}\n" for row in triangles)
    return session.path.with_name(_SUPPORT_FILE), content.encode()


def write_draft(session: Session, draft: Draft) -> Session:
    """Write the changes into session.toml, preserving comments, order and everything else.

    The support becomes a list of triangles in a new file. Both files are written together, and only
    if the new session can be read.

    Parameters
    ----------
    session : Session
    draft : Draft

    Returns
    -------
    Session                         read again, without displacements and pictures

    Raises
    ------
    InputError                      no changes; several supports, or a contact without a point
    RecordError                     the new session is invalid, or cannot be written
    """
    draft_files(session, draft)
    text, support_file = read_text(session.path), ""
    with new_files(session.path) as write, atomic_replacement(session.path) as staged:
        if draft.support is not None:
            support_file = write(*_support_list(session, draft.support)).name
        new = session_text(text, session, draft, support_file)
        staged.write_text(new, encoding="utf-8", newline="")
        read_session(staged, observations=False)
    return read_session(session.path, observations=False)


def session_text(text: str, session: Session, draft: Draft, support_file: str) -> str:
    """Text of a session file with the changes applied.

    Parameters
    ----------
    text : str                      of session.toml
    session : Session               as read from it
    draft : Draft
    support_file : str              name of the file for the support's triangles, if it was changed

    Returns
    -------
    str

    Raises
    ------
    InputError                      several supports, or a contact without a point
    """
    document: Any = tomlkit.parse(text)
    if draft.support is not None:
        _set_support(document, session, support_file)
    for name, point in draft.contacts.items():
        _set_contact(document, session, name, point)
    return tomlkit.dumps(document)


def _set_support(document: Any, session: Session, file: str) -> None:
    tables = document.get("support", [])
    if isinstance(tables, list) and len(tables) > 1:
        raise InputError(
            f"{session.path}: has {len(tables)} supports; which of them is meant cannot be said by"
            " clicking: change their triangles there"
        )
    if not tables:
        document["support"] = tomlkit.table()
    table = document["support"]
    table = table[0] if isinstance(table, list) else table
    for key in _SELECTORS:
        table.pop(key, None)
    table["triangles"] = file


def _set_contact(document: Any, session: Session, name: str, point: Vector3) -> None:
    probes = document["probe"]
    probes = probes if isinstance(probes, list) else [probes]
    contact = next(probe for probe in probes if probe["name"] == name).get("contact", {})
    if "point" not in contact:
        raise InputError(
            f"{session.path}: the contact of probing '{name}' is no point; change it there"
        )
    value = np.round(np.asarray(point) / session.metres_per_unit, _DIGITS)
    contact["point"] = [float(f"{x:.6g}") + 0.0 for x in value]


@dataclass(frozen=True, slots=True, eq=False)
class Pressed:
    """A ball in contact with the object.

    Attributes
    ----------
    point : (3,) float [m]          chosen point of the surface, at rest
    normal : (3,) float             outward unit normal there
    depth : float [m]               indentation depth of the ball below that point
    state : ContactState
    displacement : (v, 3) float [m] of all vertices
    force : (3,) float [N]          of the ball on the object
    sigma : float [N]               standard deviation of the force's magnitude due to that of the
                                    constants
    """

    point: Vector3
    normal: Vector3
    depth: float
    state: ContactState
    displacement: Vertices
    force: Vector3
    sigma: float

    @property
    def centre(self) -> Vector3:
        """Centre of the ball [m]."""
        return self.state.tools[0].position

    @property
    def touching(self) -> int:
        """Number of vertices in contact."""
        return len(self.state.touching)


def place_ball(green: GreenFunctions, point: Vector3, radius: float) -> Pressed:
    """Place a ball just above a point of the surface, without contact.

    Parameters
    ----------
    green : GreenFunctions
    point : (3,) float [m]          moved to the closest point of the surface
    radius : float [m]              of the ball

    Returns
    -------
    Pressed

    Raises
    ------
    InputError                      a point that is held, or without Green's functions; a ball that
                                    would intersect the object
    """
    closest = closest_points(green.mesh, point[None])
    corners = green.mesh.triangles[closest.triangle[0]]
    if not np.isin(corners, green.nodes).any():
        held = np.isin(corners, green.mesh.triangles[green.held_triangles]).all()
        why = "it is held there" if held else "only the part about the contacts is prepared"
        raise InputError(f"the object cannot be pressed there: {why}; choose another place")
    normal = unit_normals(green.mesh)[closest.triangle[0]]
    position = closest.position[0]
    ball = PlacedTool(Sphere(radius), position + (1.0 + _INITIAL_GAP) * radius * normal)
    state = start_contact(green, [ball])
    zero = np.zeros_like(green.mesh.vertices)
    return Pressed(position, normal, -_INITIAL_GAP * radius, state, zero, np.zeros(3), 0.0)


def press(green: GreenFunctions, before: Pressed, depth: float) -> Pressed:
    """Move the ball along the normal to another depth, in small steps.

    Parameters
    ----------
    green : GreenFunctions
    before : Pressed
    depth : float [m]               new indentation depth

    Returns
    -------
    Pressed

    Raises
    ------
    NotConvergedError               the contact iteration does not converge
    """
    ball = before.state.tools[0].tool
    steps = max(1, int(np.ceil(abs(depth - before.depth) / (_MAX_STEP * ball.reach))))
    state = before.state
    for at in np.linspace(before.depth, depth, steps + 1)[1:]:
        position = before.point + (ball.reach - at) * before.normal
        state = touch(green, [PlacedTool(ball, position)], state)
    force = -state.tool_force[0]
    length = float(np.linalg.norm(force))
    along = force / length if length else np.zeros(3)
    variance = float(along @ force_covariance(green, state)[0] @ along)
    displacement = surface_displacement(green, state)
    return Pressed(
        before.point,
        before.normal,
        depth,
        state,
        displacement,
        force,
        float(np.sqrt(max(variance, 0.0))),
    )


def force_text(pressed: Pressed) -> str:
    """The force as text, with a warning if the mesh is too coarse for the contact.

    Parameters
    ----------
    pressed : Pressed

    Returns
    -------
    str                             one line; where there is a warning, it is a second one
    """
    length = float(np.linalg.norm(pressed.force))
    resolved = bool(pressed.state.resolved.all())
    # Unless the contact is resolved, the constants' share would understate the error of the force.
    known = resolved and pressed.sigma > 0.0
    doubt = f" \N{PLUS-MINUS SIGN} {pressed.sigma:.2g}" if known else ""
    text = f"{length:.3g}{doubt} N at {1e3 * pressed.depth:.2f} mm"
    if not resolved:
        text += (
            f"\nThe ball touches {pressed.touching} of the mesh's vertices: too few for a force"
            " that can be trusted. Take a larger ball, or a finer mesh."
        )
    return text
