"""A closed manifold surface with outward normals from the output of a scanner or CAD program.

Holes are closed by flat patches across their rims. `prepare_surface` also remeshes the surface for
the boundary element model, and gives the deviation that this causes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.errors import MeshError
from palpate.geometry import (
    MeshQuality,
    TriangleMesh,
    bounding_diagonal,
    checked_mesh,
    enclosed_volume,
    half_edges,
    mesh_quality,
    place_text,
    triangle_areas,
)
from palpate.optional_imports import late_import
from palpate.progress import Progress, silent
from palpate.scanning.cleaning import (
    Faces,
    cleaned,
    compacted,
    oriented,
    pieces,
    seam_width,
    without_dust,
    without_walls,
)
from palpate.scanning.plane import Action, Plane, plane_text
from palpate.scanning.remesh import Deviation, deviation, distances, remeshed
from palpate.scanning.solid import above, united, wrapped
from palpate.shapes import Points, Triangles, Vector3, Vertices

# Thickness relative to size below which, roughly, a surface is a sheet and not that of a body.
_SHEET = 1e-3
# Largest hole that is closed, as a fraction of the surface's area, except at the support. A flat
# patch deviates by about its size squared over the object's.
_MAX_PATCH = 0.05
# Rims within this fraction of the diagonal from the support belong to it: a camera does not see the
# object just above a table.
SUPPORT_REACH = 0.1
Chain = Int[np.ndarray, " _"]
Places = Float[np.ndarray, "_ 3"]


def mend(
    mesh: TriangleMesh, support: Plane | None = None
) -> tuple[TriangleMesh, tuple[Action, ...], TriangleMesh | None]:
    """Mend a surface, or raise an error that says where and why it cannot be mended.

    Parameters
    ----------
    mesh : TriangleMesh             welded
    support : Plane or None         plane on which the object stood; the surface is cut off or
                                    closed there

    Returns
    -------
    mesh : TriangleMesh             closed, manifold, outward normals; triangles not yet even
    actions : tuple of Action       repairs made
    guessed : TriangleMesh or None  patches that close holes and were not measured

    Raises
    ------
    MeshError                       the surface is one-sided, a sheet, of several objects, has a
                                    cavity, lacks a large part, or does not reach the support
    """
    mesh, actions = cleaned(mesh)
    for step in (without_walls, without_dust):
        mesh, more = step(mesh)
        actions += more
    before = mesh
    mesh, turned = oriented(mesh)
    if turned.any():
        position = mesh.vertices[mesh.triangles[np.flatnonzero(turned)[0]]].mean(axis=0)
        actions.append(Action("flipped triangle", int(turned.sum()), position, "turned outward"))
    _refuse_cavities(before, mesh)
    if support is not None:
        support = _upward(support, mesh)
    mesh, guessed, more = _closed(mesh, support)
    actions += more
    patches = compacted(mesh.vertices, mesh.triangles[guessed]) if guessed.any() else None
    _refuse_sheet(mesh)
    mesh, more = _one_solid(mesh)
    actions += more
    if support is not None:
        mesh, more = _cut(mesh, support)
        actions += more
    return mesh, tuple(actions), patches


def _upward(support: Plane, mesh: TriangleMesh) -> Plane:
    """The plane with its normal pointing to the object's side."""
    side = np.median(support.heights(mesh.vertices))
    return support if side >= 0.0 else Plane(support.point, -support.normal)


def _one_solid(mesh: TriangleMesh) -> tuple[TriangleMesh, list[Action]]:
    """The surface if it is valid; else the union of its parts; else a reconstruction on a grid."""
    try:
        return checked_mesh(mesh)[0], []
    except MeshError as error:
        reason = error
    label = pieces(mesh.triangles)
    if label.max() > 0:
        try:
            parts = [
                checked_mesh(compacted(mesh.vertices, mesh.triangles[label == k]))[0]
                for k in range(label.max() + 1)
            ]
        except MeshError:
            parts = []
        if parts:
            whole, actions = united(parts)
            return checked_mesh(whole)[0], actions
    solid = checked_mesh(wrapped(mesh))[0]
    gap = distances(solid.vertices, mesh)
    if float(gap.max()) > 0.05 * bounding_diagonal(mesh):
        raise MeshError(
            f"{reason}; what it winds around is {1e3 * gap.max():.3g} mm off it near"
            f" {place_text(solid.vertices[gap.argmax()])}"
        ) from reason
    position = _first_crossing(mesh)
    return solid, [Action("self-intersection", 1, position, "the outer skin found anew on a grid")]


def _first_crossing(mesh: TriangleMesh) -> Vector3:
    igl = late_import("igl", extra="surface", purpose="mending a surface")
    centre = mesh.vertices[mesh.triangles].mean(axis=1)
    winding = igl.fast_winding_number(mesh.vertices, mesh.triangles, centre)
    # On a simple surface the winding number is 1/2; where it intersects itself, it is not.
    return centre[int(np.abs(np.asarray(winding) - 0.5).argmax())]


def _refuse_cavities(before: TriangleMesh, mesh: TriangleMesh) -> None:
    """Raise if a piece inside another faced inward, and so is the wall of a cavity."""
    label = pieces(mesh.triangles)
    if label.max() == 0:
        return
    igl = late_import("igl", extra="surface", purpose="mending a surface")
    for k in range(label.max() + 1):
        mine = label == k
        part = compacted(before.vertices, before.triangles[mine])
        if enclosed_volume(part) >= 0.0:
            continue
        others = np.ascontiguousarray(mesh.triangles[~mine])
        inside = np.asarray(igl.fast_winding_number(mesh.vertices, others, part.vertices))
        if (inside > 0.75).all():
            raise MeshError(
                f"the object is hollow: a cavity of {-1e6 * enclosed_volume(part):.3g} cm^3 around"
                f" {place_text(part.vertices.mean(axis=0))}; the model knows solid bodies only:"
                " fill it in a mesh program if the body is solid"
            )


def _refuse_sheet(mesh: TriangleMesh) -> None:
    """Raise if the surface encloses almost no volume."""
    area, size = float(triangle_areas(mesh).sum()), bounding_diagonal(mesh)
    if abs(enclosed_volume(mesh)) < 0.25 * _SHEET * area * size:
        raise MeshError(
            f"the surface is a sheet without thickness around"
            f" {place_text(mesh.vertices.mean(axis=0))}: it encloses nothing; give it its thickness"
            " in a mesh program (thicken, solidify), or scan its other side"
        )


def _cut(mesh: TriangleMesh, support: Plane) -> tuple[TriangleMesh, list[Action]]:
    """Cut off the part below the support; raises if the surface does not reach the support."""
    heights = support.heights(mesh.vertices)
    deepest, actions = int(heights.argmin()), []
    position = mesh.vertices[deepest]
    if heights[deepest] < -seam_width(mesh):
        mesh = above(mesh, support)
        actions = [Action("part below the support", 1, position, "cut off at its plane")]
    if not (abs(support.heights(mesh.vertices))[mesh.triangles] < seam_width(mesh)).all(1).any():
        raise MeshError(
            f"nothing of the object lies on the support: its lowest point, {place_text(position)},"
            f" is {1e3 * heights[deepest]:.3g} mm above the plane; check the plane and the unit of"
            " the mesh"
        )
    return mesh, actions


@dataclass(frozen=True, slots=True, eq=False)
class PreparedSurface:
    """A surface ready for a session.

    Attributes
    ----------
    given : TriangleMesh            the input
    mended : TriangleMesh           closed, manifold, outward normals
    mesh : TriangleMesh             the mended surface, remeshed evenly
    actions : tuple of Action       repairs
    guessed : (m,) bool             triangles of `mesh` that close holes and were not measured
    deviation : Deviation           of `mesh` from `mended`
    quality : MeshQuality           of `mesh`
    """

    given: TriangleMesh
    mended: TriangleMesh
    mesh: TriangleMesh
    actions: tuple[Action, ...]
    guessed: Bool[np.ndarray, " m"]
    deviation: Deviation
    quality: MeshQuality


def prepare_surface(
    given: TriangleMesh,
    *,
    vertices: int,
    near: Points | None = None,
    support: Plane | None = None,
    progress: Progress = silent,
) -> PreparedSurface:
    """Mend a surface and remesh it evenly.

    Parameters
    ----------
    given : TriangleMesh            welded; may be open, inconsistently oriented, folded, in pieces
    vertices : int                  wanted number
    near : (n, 3) float [m] or None points near which triangles are to be finer
    support : Plane or None         plane on which the object stood
    progress : callable

    Returns
    -------
    PreparedSurface

    Raises
    ------
    InputError                      vertices out of range, `near` away from the surface
    MeshError                       the surface cannot be mended or remeshed; says why, and where
    """
    progress("mending", 0.0)
    mended, actions, guessed = mend(given, support)
    progress("remeshing", 0.4)
    mesh = remeshed(mended, vertices=vertices, near=near)
    progress("comparing", 0.9)
    return PreparedSurface(
        given=given,
        mended=mended,
        mesh=mesh,
        actions=actions,
        guessed=_guessed(mesh, guessed),
        deviation=deviation(mended, mesh),
        quality=mesh_quality(mesh),
    )


def _guessed(mesh: TriangleMesh, patches: TriangleMesh | None) -> Bool[np.ndarray, " m"]:
    """Triangles that lie on patches, within the distance by which chords miss a curved surface."""
    if patches is None:
        return np.zeros(len(mesh.triangles), dtype=bool)
    centre = mesh.vertices[mesh.triangles].mean(axis=1)
    return distances(centre, patches) < 0.1 * np.sqrt(triangle_areas(mesh))


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


def _closed(
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
        position = vertices[free[0]].mean(axis=0)
        actions.append(Action("hole", len(free), position, "closed with a patch"))
    if support is not None and standing:
        vertices, skirt = on_plane(mesh, standing, support)
        patches.append(skirt)
        position = vertices[standing[0]].mean(axis=0)
        actions.append(Action("open base", 1, position, "closed with the support's plane"))
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
