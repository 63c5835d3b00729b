"""The arm: where it really goes when it is sent somewhere, what it does there, how it looks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from palpate.errors import InputError
from palpate.geometry import SurfacePoints, TriangleMesh, closest_points, vertex_normals
from palpate.lab.bodies import Body, Press, Tip, press, press_to_force, rod, solve_finite
from palpate.lab.config import Arm, Probe
from palpate.records import Camera, Contact, camera_centre
from palpate.shapes import Vector3

# A point this far off the surface, in radii of the tip, was not meant to be on it.
_OFF = 0.25
# Elements under the tip: so many across the touched circle.
_ACROSS = 6.0
# The rod ends before the nearest camera.
_ROD_REACH = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Probed:
    """What happened in one probing.

    Attributes
    ----------
    probe : Probe                   what was asked for
    tip : Tip                       the tip as it really went
    states : tuple of Press         one an instant, the last at the end
    """

    probe: Probe
    tip: Tip
    states: tuple[Press, ...]


def aimed(probe: Probe, arm: Arm, mesh: TriangleMesh, *, rng: np.random.Generator) -> Tip:
    """The tip as it really goes: turned and set down a little beside what it was told.

    Parameters
    ----------
    probe : Probe
    arm : Arm
    mesh : TriangleMesh             the body at rest
    rng : Generator

    Returns
    -------
    Tip                             on its way to where it will touch

    Raises
    ------
    InputError                      a point that is not on the body; a direction out of it; an arm
                                    that would run through the body
    """
    place = closest_points(mesh, probe.point[None])
    on = place.position[0]
    normal = _smooth_normal(mesh, place)
    if place.distance[0] > _OFF * arm.radius:
        inside = "inside" if (on - probe.point) @ normal > 0.0 else "away from"
        raise InputError(
            f"probe '{probe.name}': its point is {1e3 * place.distance[0]:.3g} mm {inside} the"
            " body; give a point on the surface"
        )
    direction = -normal if probe.direction is None else probe.direction
    direction = direction / np.linalg.norm(direction)
    if direction @ normal >= 0.0:
        raise InputError(
            f"probe '{probe.name}': its direction {np.round(direction, 3).tolist()} leads out of"
            f" the body, whose outward normal there is {np.round(normal, 3).tolist()}; turn it"
        )
    across = np.stack(_across(direction))
    turn = np.deg2rad(arm.misalignment) * rng.standard_normal(2) @ across
    beside = arm.placement * rng.standard_normal(2) @ np.stack(_across(normal))
    flat = arm.tip == "punch"
    # A sphere that comes in at a slant touches there if its centre goes over the place.
    axis = on + beside + (0.0 if flat else arm.radius) * normal
    tip = Tip(arm.radius, axis, cv2.Rodrigues(turn)[0] @ direction, flat=flat)
    _check_way(probe.name, tip, mesh)
    return tip


def fine_place(
    tip: Tip, probe: Probe, *, young: float, poisson: float
) -> tuple[Vector3, float, float]:
    """Where a body needs small elements, and how small: under the tip.

    The touched circle is taken from Hertz's formulae for a half space.

    Parameters
    ----------
    tip : Tip
    probe : Probe
    young : float [Pa]
    poisson : float

    Returns
    -------
    point (3,), radius, edge [m]
    """
    if tip.flat:
        radius = tip.radius
    elif probe.depth is not None:
        radius = np.sqrt(tip.radius * probe.depth)
    else:
        reduced = young / (1.0 - poisson**2)
        radius = np.cbrt(0.75 * float(probe.force or 0.0) * tip.radius / reduced)
    radius = min(float(radius), tip.radius)
    return probe.point, radius, 2.0 * radius / _ACROSS


def probed(body: Body, probe: Probe, tip: Tip, *, sticking: bool, finite: bool) -> Probed:
    """Press a tip as a probe asks.

    Parameters
    ----------
    body : Body
    probe : Probe
    tip : Tip
    sticking : bool                 only to a depth
    finite : bool                   at finite strain: the tip's forces are those of the linear body
                                    and keep their direction; how far they push is not linear

    Returns
    -------
    Probed                          as many states as the probe has steps

    Raises
    ------
    InputError                      sticking to a force; a tip that passes the body or reaches its
                                    support
    NotConvergedError               the contact does not settle
    """
    if sticking and probe.depth is None:
        raise InputError(
            f"probe '{probe.name}' goes to a force with a sticking tip; give a depth instead"
        )
    share = np.arange(1, probe.steps + 1) / probe.steps
    if probe.depth is not None:
        states = press(body, tip, share * probe.depth, sticking=sticking)
    else:
        forces = share * float(probe.force or 0.0)
        states = tuple(press_to_force(body, tip, float(one)) for one in forces)
    return Probed(
        probe, tip, tuple(_at_finite_strain(body, tip, one) for one in states) if finite else states
    )


def _at_finite_strain(body: Body, tip: Tip, state: Press) -> Press:
    """The same forces on the same nodes, and how far they push a body of finite strain."""
    displacement = solve_finite(body, state.load, steps=1).displacement
    weight = np.linalg.norm(state.load, axis=1)
    farther = (weight @ (displacement - state.displacement) / weight.sum()) @ tip.direction
    return replace(
        state,
        depth=state.depth + float(farther),
        place=state.place + farther * tip.direction,
        displacement=displacement,
    )


def contact_told(probed: Probed) -> Contact:
    """The contact as a person at the bench would put it into a session.

    Where the arm was sent; for a sphere Hertz's pressure over the touched circle, for a punch an
    even one over its face.
    """
    tip = probed.tip
    profile = "uniform" if tip.flat else "hertz"
    radius = tip.radius if tip.flat else probed.states[-1].radius
    return Contact(point=probed.probe.point, radius=radius, profile=profile)


def rod_at(tip: Tip, place: Vector3, cameras: Sequence[Camera]) -> TriangleMesh:
    """The arm's rod at one instant, as long as half the way to the nearest camera.

    Parameters
    ----------
    tip : Tip
    place : (3,) float [m]          of the sphere's centre, or of the punch's face
    cameras : sequence of Camera

    Returns
    -------
    TriangleMesh                    closed, outward, object frame
    """
    away = [np.linalg.norm(camera_centre(camera) - place) for camera in cameras]
    length = _ROD_REACH * float(min(away))
    upright = rod(radius=tip.radius, length=length, flat=tip.flat)
    axes = np.stack([*_across(-tip.direction), -tip.direction])
    return TriangleMesh(place + upright.vertices @ axes, upright.triangles)


def _smooth_normal(mesh: TriangleMesh, place: SurfacePoints) -> Vector3:
    """Outward normal of the round body that the facets stand for."""
    corners = mesh.triangles[place.triangle[0]]
    normal = place.barycentric[0] @ vertex_normals(mesh.vertices, mesh.triangles)[corners]
    return normal / np.linalg.norm(normal)


def _across(direction: Vector3) -> tuple[Vector3, Vector3]:
    """Two unit vectors that make a right-handed frame with a direction as the third."""
    other = np.eye(3)[np.abs(direction).argmin()]
    first = np.cross(other, direction)
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)


def _check_way(name: str, tip: Tip, mesh: TriangleMesh) -> None:
    """Refuse an arm that runs through the body on its way to where it touches."""
    offset = mesh.vertices - tip.point
    behind = -(offset @ tip.direction)  # of the sphere's centre at first touch, or of the face
    beside = np.linalg.norm(offset + behind[:, None] * tip.direction, axis=1)
    hit = (beside < tip.radius) & (behind > 2.0 * tip.radius)
    if hit.any():
        where = np.round(1e3 * mesh.vertices[hit][behind[hit].argmax()], 1).tolist()
        raise InputError(
            f"probe '{name}': the arm would run through the body at {where} mm on its way; turn"
            " its direction, or take a thinner tip"
        )
