"""Places of the surface that a tool can reach."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, split_sides, unit_normals, vertex_normals
from palpate.pipeline.model.supports import check_balance, sliding_motion
from palpate.pipeline.motion.sequences import session_rig
from palpate.records import Session, camera_centre
from palpate.shapes import Points, Vector3

# Number of places that are compared.
MOST_PLACES = 40
# Distance of a contact's centre from creases and rims of held parts, in contact radii.
_CLEARANCE = 1.3
# A tool approaches along the surface normal: radius of its shaft and height at which it begins, in
# contact radii; and the largest cosine between that normal and the mean normal of the supports.
_SHAFT_RADII, _SHAFT_STARTS, _FROM_BELOW = 1.5, 1.0, 0.3


def first_place(session: Session, *, radius: float) -> tuple[Vector3, Vector3]:
    """Where to push before anything is measured: of the places that a tool can reach, the one that
    faces the cameras most.

    Parameters
    ----------
    session : Session               with a rig; without probings
    radius : float [m]              of the contact, about

    Returns
    -------
    point : (3,) float [m]
    inward : (3,) float [-]         unit inward normal there

    Raises
    ------
    InputError                      no place that a tool can reach
    RecordError, CalibrationError   the rig cannot be read
    """
    point, inward = reachable_places(session, radius=radius)
    if not len(point):
        raise InputError(
            f"no place of the surface can be reached by a tool with a contact of {radius:g} m: it"
            " needs a flat or gently curved place, free above and away from edges and supports,"
            " and on rollers one where it presses straight against them"
        )
    eyes = np.stack([camera_centre(camera) for camera in session_rig(session).cameras])
    away = point[:, None] - eyes
    facing = np.einsum("pca,pa->pc", away, inward) / np.linalg.norm(away, axis=2)
    best = int(facing.min(axis=1).argmax())
    return point[best], inward[best]


def reachable_places(session: Session, *, radius: float) -> tuple[Points, Points]:
    """Evenly spread places at which a tool can press, away from those of the session's probings.

    Parameters
    ----------
    session : Session
    radius : float [m]              of the contact

    Returns
    -------
    point : (c, 3) float [m]        may be none
    inward : (c, 3) float [-]       unit inward normals there
    """
    mesh = session.mesh
    normals = vertex_normals(mesh.vertices, mesh.triangles)
    free = _far_from_edges(session, radius) & ~_from_the_support(session, normals)
    taken = np.array([probing.contact.point for probing in session.probings]).reshape(-1, 3)
    free &= cKDTree(taken).query(mesh.vertices)[0] > radius
    free &= _is_answered(session, normals, free)
    vertices = _spread(mesh.vertices, np.flatnonzero(free), taken, 3 * MOST_PLACES)
    reachable = [k for k in vertices if _shaft_is_free(mesh, mesh.vertices[k], normals[k], radius)]
    chosen = np.array(reachable[:MOST_PLACES], dtype=np.int64)
    return mesh.vertices[chosen], -normals[chosen]


def _far_from_edges(session: Session, radius: float) -> Bool[np.ndarray, " v"]:
    """Vertices that keep clear of creases, rims and what is held."""
    mesh = session.mesh
    held = np.zeros(len(mesh.triangles), dtype=np.int64)
    held[session.held_triangles] = 1
    sides = split_sides(mesh, held)
    corner = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=2)
    ends = corner[sides.cut[sides.edge]]
    free = np.ones(len(mesh.vertices), dtype=bool)
    if len(ends):
        along = np.linspace(0.0, 1.0, 9)[:, None, None]
        line = mesh.vertices[ends[:, 0]] * (1 - along) + mesh.vertices[ends[:, 1]] * along
        free = cKDTree(line.reshape(-1, 3)).query(mesh.vertices)[0] > _CLEARANCE * radius
    free[np.unique(mesh.triangles[session.held_triangles])] = False
    return free


def _from_the_support(session: Session, normals: Points) -> Bool[np.ndarray, " v"]:
    """Vertices that face the same way as the supports, where the fixture obstructs the tool."""
    outward = unit_normals(session.mesh)[session.held_triangles].mean(axis=0)
    return normals @ outward > _FROM_BELOW


def _is_answered(
    session: Session, normals: Points, free: Bool[np.ndarray, " v"]
) -> Bool[np.ndarray, " v"]:
    """Which of the free vertices can be pressed without the object sliding off its rollers."""
    sliding = sliding_motion(session)
    answered = free.copy()
    for k in np.flatnonzero(free) if sliding is not None else ():
        try:
            check_balance(sliding, [(session.mesh.vertices[k], -normals[k])], "")
        except InputError:
            answered[k] = False
    return answered


def _shaft_is_free(
    mesh: TriangleMesh, point: np.ndarray, outward: np.ndarray, radius: float
) -> bool:
    """Whether the tool's shaft would be clear of the object."""
    offset = mesh.vertices[mesh.triangles].mean(axis=1) - point
    along = offset @ outward
    off_axis = np.linalg.norm(offset - along[:, None] * outward, axis=1)
    return not bool(((along > _SHAFT_STARTS * radius) & (off_axis < _SHAFT_RADII * radius)).any())


def _spread(
    vertices: Points, free: Int[np.ndarray, " f"], taken: Float[np.ndarray, "p 3"], count: int
) -> list[int]:
    """Farthest-point sample of the free vertices, starting from the points already taken."""
    if not len(free):
        return []
    gap = cKDTree(taken).query(vertices[free])[0]
    chosen = []
    for _ in range(min(count, len(free))):
        k = int(gap.argmax())
        chosen.append(int(free[k]))
        gap = np.minimum(gap, np.linalg.norm(vertices[free] - vertices[free[k]], axis=1))
    return chosen
