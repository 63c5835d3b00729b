"""A ball pressed into the object at a chosen point: its force, and the surface displacement."""

from dataclasses import dataclass

import numpy as np

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, closest_points, unit_normals
from palpate.shapes import Vector3, Vertices
from palpate.simulation import (
    ContactState,
    GreenFunctions,
    PlacedTool,
    Sphere,
    force_covariance,
    start_contact,
    surface_displacement,
    touch,
)

# Initial gap, and largest step, as fractions of the ball's radius.
_INITIAL_GAP, _MAX_STEP = 1e-3, 0.02


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
    steps = max(1, int(np.ceil(abs(depth - before.depth) / (_MAX_STEP * ball.bounding_radius))))
    state = before.state
    for at in np.linspace(before.depth, depth, steps + 1)[1:]:
        position = before.point + (ball.bounding_radius - at) * before.normal
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


def ray_intersection(mesh: TriangleMesh, origin: Vector3, direction: Vector3) -> Vector3 | None:
    """First intersection of a ray with a surface, from outside.

    Parameters
    ----------
    mesh : TriangleMesh
    origin : (3,) float [m]
    direction : (3,) float          of any length

    Returns
    -------
    (3,) float [m] or None          None if there is no intersection

    Source
    ------
    Moeller and Trumbore, J. Graphics Tools 2 (1997) 21
    """
    first, second, third = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    side, other = second - first, third - first
    first_cross = np.cross(direction, other)
    scale = np.einsum("ma,ma->m", side, first_cross)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = origin - first
        u = np.einsum("ma,ma->m", offset, first_cross) / scale
        second_cross = np.cross(offset, side)
        v = second_cross @ direction / scale
        distance = np.einsum("ma,ma->m", other, second_cross) / scale
        # From outside: the ray runs against the normal.
        hit = (scale > 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0)
    if not hit.any():
        return None
    return np.asarray(origin + distance[hit].min() * direction)
