"""Reads contacts, forces, additional loads and support motions of a probing in session.toml."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.geometry import (
    TriangleMesh,
    area_vectors,
    bounding_diagonal,
    closest_points,
    read_mesh,
)
from palpate.records.contact import RIGID, UNIFORM, Contact, contact_profiles
from palpate.records.probing import Load
from palpate.records.quantities import ANGLE_UNITS, LENGTH_UNITS
from palpate.records.support import HeldObject, RigidMotion, listed_triangles
from palpate.records.text.toml_table import TomlTable
from palpate.records.tools import FRICTIONS, TOOLS, ConvexMesh, Tool, mesh_tool
from palpate.shapes import Indices, Vector3


def read_push(table: TomlTable, body: HeldObject, loads: Sequence[Load]) -> tuple[Contact, Vector3]:
    """Contact and force of a probing; with additional loads only, zero force at the first of them.

    Parameters
    ----------
    table : TomlTable               of the probing
    body : HeldObject
    loads : sequence of Load        additional loads of the probing

    Returns
    -------
    contact : Contact
    force : (3,) float [N]

    Raises
    ------
    RecordError                     a missing or invalid key
    MeshError                       the mesh of a tool cannot be read
    """
    if loads and "contact" not in table.values and "force" not in table.values:
        return loads[0].contact, np.zeros(3)
    contact = table.table("contact", f"{table.name} contact")
    if "support" not in contact.values:
        force = table.vector("force")
        if "tool" in contact.values:
            point = body.metres_per_unit * contact.vector("point")
            tool = _tool(contact, body.metres_per_unit, force)
            return Contact.under(tool, point, bounding_diagonal(body.mesh)), force
        return _contact(contact, body), force
    contact.check_keys(("support",))
    number = contact.number("support")
    count = len(body.supports)
    if number not in range(1, count + 1):
        contact.fail("support", f"is {number:g}; must be the number of a support, 1 to {count}")
    held = body.supports[int(number) - 1].triangles
    return Contact(_middle(body.mesh, held), None, RIGID, held), table.vector("force")


def read_loads(table: TomlTable, body: HeldObject) -> tuple[Load, ...]:
    """Additional loads of a probing, from its tables `[[probe.load]]`.

    Parameters
    ----------
    table : TomlTable               of the probing
    body : HeldObject

    Returns
    -------
    tuple of Load

    Raises
    ------
    RecordError                     a missing, unknown or invalid key
    MeshError                       the mesh of a tool cannot be read
    """
    loads = []
    for number, load in enumerate(table.optional("load", table.tables) or (), start=1):
        named = TomlTable(table.file, f"{table.name} load {number}", load.values)
        named.check_keys(("contact", "force", "pressure"))
        with named.error_context():
            contact = named.table("contact", f"{named.name} contact")
            loads.append(
                Load(
                    _contact(contact, body),
                    named.optional("force", named.vector),
                    named.optional("pressure", named.number),
                )
            )
    return tuple(loads)


def read_support_motion(table: TomlTable, *, metres_per_unit: float) -> RigidMotion | None:
    """Rigid motion of the support in a probing, if its table gives one.

    Parameters
    ----------
    table : TomlTable               of the probing
    metres_per_unit : float         length unit of the session

    Returns
    -------
    RigidMotion or None

    Raises
    ------
    RecordError                     a missing, unknown or invalid key
    """
    if "support_motion" not in table.values:
        return None
    motion = table.table("support_motion", f"{table.name} support_motion")
    motion.check_keys(("translation", "rotation"))
    rotation = motion.optional("rotation", motion.vector)
    with motion.error_context():
        return RigidMotion(
            metres_per_unit * motion.vector("translation"),
            np.zeros(3) if rotation is None else rotation,
        )


def _contact(contact: TomlTable, body: HeldObject) -> Contact:
    """Contact of a circular patch, or of triangles."""
    metres = body.metres_per_unit
    if "triangles" in contact.values:
        contact.check_keys(("triangles", "traction"))
        chosen = np.unique(listed_triangles(contact, len(body.mesh.triangles)))
        if not chosen.size:
            contact.fail("triangles", "names no triangle; give at least one")
        if "traction" in contact.values:
            contact.choice("traction", (UNIFORM,))
        return Contact(_middle(body.mesh, chosen), None, UNIFORM, chosen)
    # `point_std` is read along with the other errors, in `read_error_priors`.
    contact.check_keys(("point", "point_std", "radius", "profile"))
    return Contact(
        point=metres * contact.vector("point"),
        radius=contact.optional("radius", lambda key: contact.quantity(key, LENGTH_UNITS, metres)),
        profile=contact.choice("profile", contact_profiles()),
    )


def _tool(contact: TomlTable, metres: float, force: Vector3) -> Tool:
    stated = contact.optional("friction", lambda key: contact.choice(key, tuple(FRICTIONS)))
    friction = FRICTIONS[stated or "slides"]
    shape = contact.choice("tool", tuple(TOOLS))
    kind = TOOLS[shape]
    if kind is ConvexMesh:
        return _mesh_tool(contact, metres, friction, force)
    contact.check_keys(
        ("point", "point_std", "tool", "tool_radius", "tool_inner_radius", "tool_angle", "friction")
    )
    sizes = {
        "radius": contact.quantity("tool_radius", LENGTH_UNITS, metres),
        "inner_radius": contact.optional(
            "tool_inner_radius", lambda key: contact.quantity(key, LENGTH_UNITS, metres)
        ),
        "angle": contact.optional("tool_angle", lambda key: contact.quantity(key, ANGLE_UNITS)),
    }
    wanted = {item.name for item in fields(kind)}
    for name, size in sizes.items():
        if size is None and name in wanted:
            contact.fail(f"tool_{name}", f"is missing; a tool '{shape}' needs it")
        if size is not None and name not in wanted:
            contact.fail(f"tool_{name}", f"a tool '{shape}' has none; leave it out")
    given = {name: size for name, size in sizes.items() if size is not None}
    with contact.error_context():
        return kind(**given, friction=friction)


def _mesh_tool(contact: TomlTable, metres: float, friction: float, force: Vector3) -> Tool:
    contact.check_keys(("point", "point_std", "tool", "tool_mesh", "tool_rotation", "friction"))
    rotation = contact.optional("tool_rotation", contact.vector)
    mesh = read_mesh(contact.existing_file("tool_mesh"), metres_per_unit=metres)
    if rotation is not None:
        turn = Rotation.from_rotvec(rotation)
    elif force.any():
        # The shortest one that lets the tool press along its own -z.
        turn = Rotation.align_vectors(force[None], [[0.0, 0.0, -1.0]])[0]
    else:
        turn = Rotation.identity()
    with contact.error_context():
        return mesh_tool(mesh, turn.as_matrix(), friction=friction)


def _middle(mesh: TriangleMesh, triangles: Indices) -> Vector3:
    """Point of the surface closest to the centroid of some triangles."""
    area = np.linalg.norm(area_vectors(mesh)[triangles], axis=1)
    centroid = np.average(
        mesh.vertices[mesh.triangles[triangles]].mean(axis=1), axis=0, weights=area
    )
    return closest_points(mesh, centroid[None]).position[0]
