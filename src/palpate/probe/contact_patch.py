"""The part of the surface on which a tool presses, and the distribution of its pressure."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palpate.errors import InputError
from palpate.geometry import (
    BESIDE,
    TriangleMesh,
    closest_points,
    triangle_distances,
    unit_normals,
)
from palpate.records import Contact

# Cosine above which a tangent is named by an axis.
_ALONG_AXIS = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class ContactPatch:
    """Where a tool touches an object.

    Attributes
    ----------
    contact : Contact
    triangles : (k,) int          triangles that the contact sphere reaches, connected to the
                                  contact point; or the given triangles of a load
    triangle : int                triangle at the contact point
    barycentric : (3,) float [-]  position of the contact point in it
    vertex : int                  vertex nearest to the contact point
    corners : (m, 3) int          vertices of all triangles of the mesh
    """

    contact: Contact
    triangles: Int[np.ndarray, " k"]
    triangle: int
    barycentric: Float[np.ndarray, "3"]
    vertex: int
    corners: Int[np.ndarray, "m 3"]

    def density(
        self,
        triangle: Int[np.ndarray, " n"],
        barycentric: Float[np.ndarray, "n 3"],
        position: Float[np.ndarray, "n 3"],
    ) -> Float[np.ndarray, " n"]:
        """Pressure at points of the surface, up to a factor.

        Parameters
        ----------
        triangle : (n,) int
        barycentric : (n, 3) float [-]
        position : (n, 3) float [m]

        Returns
        -------
        (n,) float [-]            `Contact.pressure_at`; without a radius, the linear hat function
                                  of the nearest vertex
        """
        if self.contact.radius is None:
            return (barycentric * (self.corners[triangle] == self.vertex)).sum(axis=1)
        return self.contact.pressure_at((position - self.contact.point) / self.contact.radius)


def find_contact_patch(
    mesh: TriangleMesh,
    contact: Contact,
    held_triangles: Int[np.ndarray, " h"],
    *,
    name: str,
    point_name: str = "contact.point",
) -> ContactPatch:
    """Find the triangles under a tool.

    Parameters
    ----------
    mesh : TriangleMesh
    contact : Contact
    held_triangles : (h,) int         the support; a tool cannot press there
    name : str                        of the probing, for messages
    point_name : str                  what the contact's point is given as, for messages

    Returns
    -------
    ContactPatch

    Raises
    ------
    InputError                        the contact misses the surface, or reaches the support
    """
    nearest = closest_points(mesh, contact.point[None])
    first = int(nearest.triangle[0])
    barycentric = nearest.barycentric[0]
    vertex = int(mesh.triangles[first][np.argmax(barycentric)])
    if contact.triangles is not None:
        triangles = contact.triangles
    elif contact.radius is None:
        vertex = int(np.argmin(np.linalg.norm(mesh.vertices - contact.point, axis=1)))
        triangles = np.flatnonzero((mesh.triangles == vertex).any(axis=1))
    else:
        distance = float(nearest.distance[0])
        if distance >= contact.reach:
            raise InputError(
                f"probe '{name}': the contact point is {1e3 * distance:.3g} mm from the surface, "
                f"farther than its radius of {1e3 * contact.reach:.3g} mm; check the frame and "
                f"the units of {point_name}"
            )
        triangles = _connected_triangles(mesh, nearest.position[0], contact.reach, first)
    held = np.intersect1d(triangles, held_triangles)
    if held.size:
        raise InputError(
            f"probe '{name}': the contact patch reaches {held.size} triangles of the support "
            f"(first: {held[:3].tolist()}); a load there moves nothing; move the contact or "
            "shrink its radius"
        )
    return ContactPatch(contact, triangles, first, barycentric, vertex, mesh.triangles)


def _connected_triangles(
    mesh: TriangleMesh, point: Float[np.ndarray, "3"], radius: float, first: int
) -> Int[np.ndarray, " k"]:
    """Triangles within a sphere that are connected with the first one and face as it does."""
    near = np.flatnonzero(triangle_distances(mesh, point) < radius)
    normals = unit_normals(mesh)
    near = near[(normals[near] @ normals[first] > BESIDE) | (near == first)]
    corner = mesh.triangles[near]
    row = np.repeat(np.arange(near.size), 3)
    incidence = coo_array(
        (np.ones(row.size), (row, corner.ravel())), shape=(near.size, mesh.vertices.shape[0])
    ).tocsr()
    _, label = connected_components(incidence @ incidence.T, directed=False)
    return near[label == label[near == first][0]]


def named_tangents(
    mesh: TriangleMesh, patch: ContactPatch
) -> tuple[Float[np.ndarray, "2 3"], list[str]]:
    """Two tangents of the surface under a patch, aligned with axes if possible, and their names.

    Parameters
    ----------
    mesh : TriangleMesh
    patch : ContactPatch

    Returns
    -------
    (2, 3) float [-]                        at right angles to each other
    list of 2 str                           "+x", "-y", or the vector
    """
    corner = mesh.vertices[mesh.triangles[patch.triangles]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).sum(axis=0)
    normal /= np.linalg.norm(normal)
    first = np.eye(3)[int(np.abs(normal).argmin())]
    first = first - (first @ normal) * normal
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    second *= np.sign(second[int(np.abs(second).argmax())])
    return np.stack([first, second]), [_direction_name(tangent) for tangent in (first, second)]


def _direction_name(direction: Float[np.ndarray, "3"]) -> str:
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > _ALONG_AXIS:
        return "+-"[int(direction[axis] < 0)] + "xyz"[axis]
    return "(" + ", ".join(f"{x:g}" for x in np.round(direction, 2) + 0.0) + ")"
