"""Holes of a surface: their rims, and flat patches that close them."""

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.errors import MeshError
from palpate.geometry import TriangleMesh, bounding_diagonal, half_edges, triangle_areas
from palpate.optional_imports import late_import
from palpate.scanning.mending.action import Action, place_text
from palpate.scanning.mending.cleaning import Faces, seam_width
from palpate.scanning.plane import Plane, plane_text
from palpate.shapes import Points, Triangles, Vector3, Vertices

# Largest hole that is closed, as a fraction of the surface's area, except at the support. A flat
# patch deviates by about its size squared over the object's.
_MAX_PATCH = 0.05
# Rims within this fraction of the diagonal from the support belong to it: a camera does not see the
# object just above a table.
SUPPORT_REACH = 0.1
Chain = Int[np.ndarray, " _"]
Places = Float[np.ndarray, "_ 3"]


def rims(triangles: Triangles) -> list[Chain]:
    """Closed chains of vertices around the holes, oriented as a patch needs them.

    Parameters
    ----------
    triangles : (m, 3) int          consistently oriented

    Returns
    -------
    list of (k,) int                k >= 3; no vertex occurs twice in a chain
    """
    halves = half_edges(triangles)
    open_half = np.flatnonzero(halves.count[halves.edge] == 1)
    # A patch traverses an edge in the opposite direction to the adjacent triangle.
    starts = halves.tail[halves.following[open_half]].tolist()
    ends = halves.tail[open_half].tolist()
    onward: dict[int, list[int]] = {}
    for start, end in zip(starts, ends, strict=True):
        onward.setdefault(start, []).append(end)
    chains = []
    while onward:
        chain = [next(iter(onward))]
        while chain[-1] in onward:
            follower = onward[chain[-1]].pop()
            if not onward[chain[-1]]:
                del onward[chain[-1]]
            if follower in chain:
                # Rims that touch at a vertex become separate chains.
                where = chain.index(follower)
                if len(chain) - where >= 3:
                    chains.append(np.array(chain[where:]))
                chain = chain[: where + 1]
            else:
                chain.append(follower)
    return chains


def closed(
    mesh: TriangleMesh, support: Plane | None
) -> tuple[TriangleMesh, Bool[np.ndarray, " _"], list[Action]]:
    """Close holes by flat patches; those at the support, in its plane.

    Parameters
    ----------
    mesh : TriangleMesh             consistently oriented
    support : Plane or None         plane on which the object stood

    Returns
    -------
    mesh : TriangleMesh             without boundary
    guessed : (m,) bool             triangles added, which were not measured
    actions : list of Action

    Raises
    ------
    MeshError                       a hole away from the support exceeds 5 % of the area
    """
    chains = rims(mesh.triangles)
    reach = SUPPORT_REACH * bounding_diagonal(mesh)
    standing: list[Chain] = []
    free: list[Chain] = []
    for chain in chains:
        near = support is not None and (abs(support.heights(mesh.vertices[chain])) < reach).all()
        (standing if near else free).append(chain)
    vertices, patches, actions = mesh.vertices, [], []
    whole = float(triangle_areas(mesh).sum())
    for chain in free:
        _check_size(vertices[chain], whole)
        patches.append(patch(vertices, [chain]))
    if free:
        place = vertices[free[0]].mean(axis=0)
        actions.append(Action("hole", len(free), place, "closed with a patch"))
    if support is not None and standing:
        vertices, skirt = on_plane(mesh, standing, support)
        patches.append(skirt)
        place = vertices[standing[0]].mean(axis=0)
        actions.append(Action("open base", 1, place, "closed with the support's plane"))
    triangles = np.concatenate([mesh.triangles, *patches])
    guessed = np.arange(len(triangles)) >= len(mesh.triangles)
    return TriangleMesh(vertices=vertices, triangles=triangles), guessed, actions


def on_plane(mesh: TriangleMesh, chains: list[Chain], support: Plane) -> tuple[Places, Faces]:
    """Extend rims perpendicularly to a plane and close the surface there.

    Parameters
    ----------
    mesh : TriangleMesh
    chains : list of (k,) int       from `rims`
    support : Plane

    Returns
    -------
    vertices : (w, 3) float [m]     those of the mesh, then new ones; rims that already lie near the
                                    plane are moved into it instead
    triangles : (n, 3) int          new triangles of skirt and base

    Raises
    ------
    InputError                      a package of the extra `surface` is not installed
    """
    vertices = mesh.vertices.copy()
    rim = np.concatenate(chains)
    if (abs(support.heights(vertices[rim])) <= seam_width(mesh)).all():
        vertices[rim] = support.projected(vertices[rim])
        return vertices, patch(vertices, chains, support.normal)
    foot = {int(v): len(vertices) + k for k, v in enumerate(rim)}
    vertices = np.concatenate([vertices, support.projected(vertices[rim])])
    skirt, feet = [], []
    for chain in chains:
        following = np.roll(chain, -1)
        low, low_following = (np.array([foot[int(v)] for v in row]) for row in (chain, following))
        skirt += [
            np.stack([chain, following, low_following], axis=1),
            np.stack([chain, low_following, low], axis=1),
        ]
        feet.append(low)
    return vertices, np.concatenate([*skirt, patch(vertices, feet, support.normal)])


def patch(vertices: Vertices, chains: list[Chain], normal: Vector3 | None = None) -> Faces:
    """Triangulate one or more rims, projected to a plane, without new vertices.

    Parameters
    ----------
    vertices : (v, 3) float [m]
    chains : list of (k,) int       rims oriented as the patch; holes in it, the opposite way
    normal : (3,) float or None     of the plane; None: the area-weighted mean of the rims' normals

    Returns
    -------
    (n, 3) int

    Raises
    ------
    InputError                      a package of the extra `surface` is not installed
    """
    manifold = late_import("manifold3d", extra="surface", purpose="closing a hole")
    area = sum((_newell(vertices[chain]) for chain in chains), np.zeros(3))
    direction = area if normal is None else normal * np.sign(area @ normal or 1.0)
    frame = np.linalg.svd(direction[None] / np.linalg.norm(direction))[2]
    right, up = frame[1], frame[2]
    if np.cross(right, up) @ direction < 0.0:
        right = -right
    plane = np.stack([right, up], axis=1)
    corners = np.concatenate(chains)
    polygons = [vertices[chain] @ plane for chain in chains]
    # A fan about one corner, as for a convex polygon, would cross a ragged rim.
    return corners[manifold.triangulate(polygons, allow_convex=False).astype(np.int64)]


def _newell(ring: Points) -> Float[np.ndarray, "3"]:
    """Area vector of a closed chain: normal times area [m^2], by Newell's method."""
    centred = ring - ring.mean(axis=0)
    return 0.5 * np.cross(centred, np.roll(centred, -1, axis=0)).sum(axis=0)


def _check_size(ring: Points, whole: float) -> None:
    """Raise if a hole is not a gap in a surface but the missing side of a body."""
    area = _newell(ring)
    fraction = float(np.linalg.norm(area)) / whole
    centred = ring - ring.mean(axis=0)
    # The area vector underestimates a bent rim or a slit: at least a quarter of its disc counts.
    disc_fraction = float((centred**2).sum(axis=1).max()) * np.pi / whole
    if max(fraction, disc_fraction / 4.0) <= _MAX_PATCH:
        return
    direction = np.linalg.svd(centred)[2][2]
    rim_plane = Plane(ring.mean(axis=0), direction)
    off = float(abs(rim_plane.heights(ring)).max())
    flat = f"its rim lies within {1e3 * off:.2g} mm of a plane: say --support"
    flat += f' "{plane_text(rim_plane)}" if the object stood there'
    bent = "scan the missing side too, or close it in a mesh program"
    is_flat = off < 0.02 * np.sqrt(whole)
    raise MeshError(
        f"the surface does not close: {len(ring)} edges around {place_text(rim_plane.point)} are"
        f" open, {100.0 * max(fraction, disc_fraction / 4.0):.0f} % of its area is missing, and at"
        f" most {100.0 * _MAX_PATCH:.0f} % is guessed; {flat if is_flat else bent}"
    )
