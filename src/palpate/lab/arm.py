"""The arm: its true motion for a commanded probing, the contact there, and its visible rod."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.geometry import (
    SurfacePoints,
    TriangleMesh,
    closest_points,
    half_edges,
    triangle_areas,
    vertex_normals,
)
from palpate.lab.config import Arm, LabConfig, Material, Probe, Specimen
from palpate.lab.specimens import rod
from palpate.records import Camera, camera_centre
from palpate.shapes import Points, Vector3
from palpate.solids import (
    Body,
    Press,
    Solid,
    Tip,
    held_nodes,
    make_body,
    make_solid,
    press,
    press_to_force,
    solve_finite,
)

# Largest distance of a commanded point from the surface, in tip radii.
_MAX_DISTANCE = 0.25
# Number of elements across the contact circle.
_ELEMENTS_ACROSS = 6.0
# Edge of the elements at the rim of a punch, in tip radii.
_RIM = 0.125
# Edge of the elements at the rim of the support, in radii of a circle of the support's area. The
# traction is singular there: elements of half that radius make a ball on a small glued patch so
# stiff that its Poisson's ratio appears 0.005 too small. The error is proportional to the edge.
_SUPPORT_RIM = 0.1
# Largest radius of the shaft behind a ball, so that the rod occludes little [m].
_SHAFT = 4e-3
# Length of the rod, as a fraction of the distance to the nearest camera.
_ROD_LENGTH = 0.5


def aim(probe: Probe, arm: Arm, mesh: TriangleMesh, *, rng: np.random.Generator) -> Tip:
    """The tip's true axis: the commanded one with the arm's misalignment and placement error.

    Parameters
    ----------
    probe : Probe
    arm : Arm
    mesh : TriangleMesh             the body at rest
    rng : Generator                 for the errors

    Returns
    -------
    Tip                             `Tip.point` is its place at first contact

    Raises
    ------
    InputError                      a point that is not on the body; a direction that leads out of
                                    it; an arm that would pass through the body
    """
    nearest = closest_points(mesh, probe.point[None])
    on = nearest.position[0]
    normal = _smooth_normal(mesh, nearest)
    if nearest.distance[0] > _MAX_DISTANCE * arm.radius:
        inside = "inside" if (on - probe.point) @ normal > 0.0 else "away from"
        raise InputError(
            f"probe '{probe.name}': its point is {1e3 * nearest.distance[0]:.3g} mm {inside} the"
            " body; give a point on the surface"
        )
    direction = -normal if probe.direction is None else probe.direction
    direction = direction / np.linalg.norm(direction)
    if direction @ normal >= 0.0:
        raise InputError(
            f"probe '{probe.name}': its direction {np.round(direction, 3).tolist()} leads out of"
            f" the body, whose outward normal there is {np.round(normal, 3).tolist()}; turn it"
        )
    across = np.stack(_perpendicular(direction))
    turn = np.deg2rad(arm.misalignment) * rng.standard_normal(2) @ across
    beside = arm.placement * rng.standard_normal(2) @ np.stack(_perpendicular(normal))
    # An obliquely approaching sphere touches there if its centre passes above along the normal.
    centre = on + beside + arm.tool.lead(np.zeros(1)) * normal
    tip = Tip(arm.tool, centre, cv2.Rodrigues(turn)[0] @ direction)
    _check_path(probe.name, tip, mesh)
    return tip


def fine_place(tip: Tip, probe: Probe, material: Material) -> tuple[Vector3, float, float]:
    """Refined region of the finite elements under the tip.

    The contact radius is that on an elastic half space.

    Parameters
    ----------
    tip : Tip
    probe : Probe
    material : Material

    Returns
    -------
    point : (3,) float [m]          centre of the region
    radius, edge : float [m]        its radius, and the edge of the elements within
    """
    modulus = material.young_modulus / (1.0 - material.poisson_ratio**2)
    depth = probe.depth or tip.tool.dent(float(probe.force or 0.0) / modulus)
    # Johnson, Contact Mechanics (1985), equation 4.22: that of a ball.
    radius = tip.radius if tip.tool.is_flat else min(float(np.sqrt(tip.radius * depth)), tip.radius)
    return probe.point, radius, 2.0 * radius / _ELEMENTS_ACROSS


def solid_under(specimen: Specimen, tip: Tip, probe: Probe, material: Material) -> Solid:
    """Finite element mesh of the specimen, refined under the tip and at the support's rim.

    Nodes lie on a punch's rim: otherwise the effective punch would be smaller by part of the node
    spacing, 3 % with six elements across. The pressure is singular there, so the elements at the
    rim are smaller still: with `_RIM` the force at a given depth is 1 % too large.

    Parameters
    ----------
    specimen : Specimen
    tip : Tip                       of `aim`
    probe : Probe
    material : Material

    Returns
    -------
    Solid

    Raises
    ------
    InputError, MeshError           as `make_solid`
    """
    small = _RIM * tip.radius
    rim = tip.rim(small)
    rim = rim[closest_points(specimen.body, rim).distance < _MAX_DISTANCE * tip.radius]
    fine = [fine_place(tip, probe, material), *((point, 0.0, small) for point in rim)]
    area = triangle_areas(specimen.body)[specimen.held].sum()
    edge = min(_SUPPORT_RIM * float(np.sqrt(area / np.pi)), specimen.element)
    fine += [(point, 0.0, edge) for point in _support_rim(specimen, edge)]
    return make_solid(specimen.body, edge=specimen.element, fine=fine, marked=rim)


def _support_rim(specimen: Specimen, apart: float) -> Points:
    """Points along the rim of the held surface, at most `apart` from each other [m]."""
    body = specimen.body
    held = np.isin(np.arange(len(body.triangles)), specimen.held)
    ends = body.vertices[half_edges(body.triangles).rim(held)]
    along = ends[:, 1] - ends[:, 0]
    parts = int(np.ceil(np.linalg.norm(along, axis=1).max(initial=0.0) / apart))
    share = (np.arange(parts) + 0.5) / max(parts, 1)
    return (ends[:, None, 0] + share[:, None] * along[:, None]).reshape(-1, 3)


def specimen_body(config: LabConfig, solid: Solid) -> Body:
    """The specimen as a body, held where its configuration says.

    Parameters
    ----------
    config : LabConfig
    solid : Solid                   of `solid_under`

    Returns
    -------
    Body
    """
    material, specimen = config.material, config.specimen
    return make_body(
        solid, held_nodes(solid, specimen.held), shear_modulus=material.shear_modulus,
        poisson_ratio=material.poisson_ratio, support_stiffness=specimen.support_stiffness,
    )  # fmt: skip


def probe_body(body: Body, probe: Probe, tip: Tip, *, finite: bool) -> tuple[Press, ...]:
    """Press a tip to the depth or force of a probe, in its load steps.

    Parameters
    ----------
    body : Body
    probe : Probe
    tip : Tip
    finite : bool                   displacements at finite strain, under the nodal forces of the
                                    linear contact as dead loads

    Returns
    -------
    tuple of Press                  one per load step, the last at full load

    Raises
    ------
    InputError                      a force with a sticking tip; a tip that misses the body or
                                    reaches its support
    NotConvergedError               contact or finite-strain equilibrium does not converge
    """
    share = np.arange(1, probe.steps + 1) / probe.steps
    if probe.depth is not None:
        states = press(body, tip, share * probe.depth)
    elif tip.tool.friction:
        raise InputError(
            f"probe '{probe.name}' goes to a force with a sticking tip; give a depth instead"
        )
    else:
        forces = share * float(probe.force or 0.0)
        states = tuple(press_to_force(body, tip, float(force)) for force in forces)
    if finite:
        states = tuple(_at_finite_strain(body, tip, state) for state in states)
    return states


def _at_finite_strain(body: Body, tip: Tip, state: Press) -> Press:
    """Nodal forces as dead loads, with the displacement and depth at finite strain."""
    displacement = solve_finite(body, state.load)
    weight = np.linalg.norm(state.load, axis=1)
    farther = (weight @ (displacement - state.displacement) / weight.sum()) @ tip.direction
    return replace(
        state,
        depth=state.depth + float(farther),
        tip_position=state.tip_position + farther * tip.direction,
        displacement=displacement,
    )


def rod_at(tip: Tip, centre: Vector3, cameras: Sequence[Camera]) -> TriangleMesh:
    """The arm's rod at one instant, half as long as the distance to the nearest camera.

    Parameters
    ----------
    tip : Tip
    centre : (3,) float [m]         centre of the sphere, or of the punch's face
    cameras : sequence of Camera

    Returns
    -------
    TriangleMesh                    closed, outward, object frame
    """
    away = [np.linalg.norm(camera_centre(camera) - centre) for camera in cameras]
    length = _ROD_LENGTH * float(min(away))
    upright = rod(_outline(tip), radius=tip.radius, length=length)
    axes = np.stack([*_perpendicular(-tip.direction), -tip.direction])
    return TriangleMesh(centre + upright.vertices @ axes, upright.triangles)


def _outline(tip: Tip) -> Float[np.ndarray, "k 2"]:
    """Contour of the rod's end, from its axis to the shaft: radius, and height above the tip's
    origin [m]."""
    if tip.tool.is_flat:
        return np.array([[0.0, 0.0], [tip.radius, 0.0]])
    shaft = min(tip.radius, _SHAFT)
    angle = np.linspace(-0.5 * np.pi, np.arccos(shaft / tip.radius), 13)
    end = tip.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    end[0, 0] = 0.0
    return end


def _smooth_normal(mesh: TriangleMesh, point: SurfacePoints) -> Vector3:
    """Outward normal interpolated from the vertex normals, as of the smooth surface."""
    corners = mesh.triangles[point.triangle[0]]
    normal = point.barycentric[0] @ vertex_normals(mesh.vertices, mesh.triangles)[corners]
    return normal / np.linalg.norm(normal)


def _perpendicular(direction: Vector3) -> tuple[Vector3, Vector3]:
    """Two unit vectors that form a right-handed frame with `direction` as the third axis."""
    other = np.eye(3)[np.abs(direction).argmin()]
    first = np.cross(other, direction)
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)


def _check_path(name: str, tip: Tip, mesh: TriangleMesh) -> None:
    """Refuse an arm that would pass through the body on its way to the contact point."""
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
