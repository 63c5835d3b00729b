"""Meshes graded where elements of uniform size make the model too stiff.

At the rim of a held face the traction varies as a negative power of the distance, and so does the
strain at a hollow (re-entrant) edge. Elements of uniform size there make the whole model too stiff,
by 0.5 to 10 %. Every edge that leaves such a line is therefore split near it, which inserts one
narrow row of elements on either side. Comparing the model of the mesh before grading with that of
the graded one shows how much was gained.

A face one element wide has no vertices of its own, only those of its edges: every field is linear
across it, and a plate whose edge is such a strip bends 10 to 20 % too little. Edges across such
faces are split at their middle first. So are elements about a flat punch that is hardly wider than
they are: the surface has a kink at the punch's rim, which no element can follow. On a block of 594
vertices, under a punch as wide as two of its edges, that moved nu by 0.001 to 0.002. And so are
elements about a contact that a crease or the rim of a support crosses, where no half space tells
what the mesh misses of the dip (`bem`): again and again, until they are smaller than the contact.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.bem import BoundarySurface
from palpate.checkpoints import Cache
from palpate.geometry import (
    SurfacePoints,
    TriangleMesh,
    closest_points,
    cut_distance,
    distinct_points,
    unit_normals,
)
from palpate.pipeline.model.supports import session_surface
from palpate.records import Contact, DisplacementField, Probing, Session

# Width of the row at the rim over the length of the edges there.
ROW = 0.3
# The error falls at least with the first power of the element size at the rim, so that at most this
# fraction of the change from one refinement step is left.
REMAINING_FRACTION = ROW / (1.0 - ROW)
# Edges about a flat punch, or a contact that a crease crosses, that are longer than this fraction
# of its radius are split.
_LONG_AT_CONTACT = 0.5
# Most times that edges about contacts across a crease are halved: contacts 1/32 of an edge wide.
# Each contact takes one or two hundred vertices; beyond so many in all, or twice those of the mesh,
# a fit would take minutes, and the halvings end.
_MOST_HALVINGS, _MOST_VERTICES = 6, 2500
# Sine of the elevation of a neighbour's centre above a triangle's plane beyond which their common
# edge is hollow: a few degrees, far less than at a crease.
_HOLLOW = 0.1


def refined_session(
    session: Session, contacts: Sequence[Contact] | None = None, *, cache: Cache | None = None
) -> Session:
    """A session on a mesh whose faces are all at least two elements wide, and that is finer
    about flat punches and contacts that a crease crosses.

    Parameters
    ----------
    session : Session
    contacts : sequence of Contact or None    None: those of its probings
    cache : Cache or None           as for `session_surface`

    Returns
    -------
    Session                         vertices of the given mesh first, in their order; points of its
                                    fields are located anew on the new mesh
    """
    if contacts is None:
        contacts = [probing.contact for probing in session.probings]
    most = max(_MOST_VERTICES, 2 * len(session.mesh.vertices))
    boundary = session_surface(session, cache=cache)
    across = [contact for contact in contacts if _is_crossed(boundary, contact)]
    session = _divided_session(session, *refined_mesh(boundary, contacts))
    for _ in range(_MOST_HALVINGS - 1 if across else 0):
        mesh, parent = refined_mesh(session_surface(session, cache=cache), across)
        if not len(session.mesh.vertices) < len(mesh.vertices) <= most:
            break
        session = _divided_session(session, mesh, parent)
    return session


def graded_session(session: Session, *, cache: Cache | None = None) -> Session:
    """A session on a mesh graded at the rims of its supports and at hollow edges.

    Parameters
    ----------
    session : Session
    cache : Cache or None           as for `session_surface`

    Returns
    -------
    Session                         as from `refined_session`
    """
    return _divided_session(session, *graded_mesh(session_surface(session, cache=cache)))


def edge_refined_session(session: Session, *, cache: Cache | None = None) -> Session:
    """A session on a mesh whose edges at creases are halved, except at those creases (rims,
    hollow edges) that grading refines.

    Parameters
    ----------
    session : Session
    cache : Cache or None           as for `session_surface`

    Returns
    -------
    Session                         as from `refined_session`
    """
    boundary = session_surface(session, cache=cache)
    ends, on_rim = _edge_ends(boundary), _at_rim(boundary)
    creases = boundary.sides.cut & ~_hollow_edges(boundary) & ~on_rim[ends].all(axis=1)
    at_crease = np.zeros(len(boundary.mesh.vertices), dtype=bool)
    at_crease[ends[creases]] = True
    cuts = np.where(at_crease[ends].any(axis=1)[:, None], ends, -1)
    return _divided_session(session, *_divided(boundary, cuts, 0.5))


def halved_session(session: Session) -> Session:
    """A session on a mesh with every edge halved.

    Parameters
    ----------
    session : Session

    Returns
    -------
    Session                         as from `refined_session`
    """
    boundary = session_surface(session)
    return _divided_session(session, *_divided(boundary, _edge_ends(boundary), 0.5))


def refined_mesh(
    boundary: BoundarySurface, contacts: Sequence[Contact] = ()
) -> tuple[TriangleMesh, Int[np.ndarray, " t"]]:
    """Halve every edge that crosses a face from one crease or rim to another, and long edges about
    flat punches and contacts that a crease crosses.

    Parameters
    ----------
    boundary : BoundarySurface
    contacts : sequence of Contact

    Returns
    -------
    TriangleMesh                    vertices of the given one first
    (t,) int                        the given triangle that each of its triangles is a part of
    """
    ends, cut = _edge_ends(boundary), boundary.sides.cut
    at_crease = np.zeros(len(boundary.mesh.vertices), dtype=bool)
    at_crease[ends[cut]] = True
    long = ~cut & at_crease[ends].all(axis=1)
    position = boundary.mesh.vertices[ends]
    length = np.linalg.norm(position[:, 1] - position[:, 0], axis=1)
    for contact in contacts:
        if contact.radius is not None and (contact.has_sharp_rim or _is_crossed(boundary, contact)):
            distance = (
                np.linalg.norm(position.mean(axis=1) - contact.point, axis=1) - contact.radius
            )
            long |= (distance < length) & (length > _LONG_AT_CONTACT * contact.radius)
    return _divided(boundary, np.where(long[:, None], ends, -1), 0.5)


def _is_crossed(boundary: BoundarySurface, contact: Contact) -> bool:
    """Whether a crease or the rim of a support crosses a round contact."""
    every = np.arange(len(boundary.mesh.triangles))
    return (
        contact.radius is not None
        and cut_distance(boundary.mesh, boundary.sides, every, contact.point) < contact.reach
    )


def graded_mesh(boundary: BoundarySurface) -> tuple[TriangleMesh, Int[np.ndarray, " t"]]:
    """Split every edge that leaves the rim of the held triangles, or a hollow edge, near that line.

    Parameters
    ----------
    boundary : BoundarySurface

    Returns
    -------
    TriangleMesh                    vertices of the given one first
    (t,) int                        the given triangle that each of its triangles is a part of
    """
    ends, on_line = _edge_ends(boundary), _at_rim(boundary)
    on_line[ends[_hollow_edges(boundary)]] = True
    outward = np.where(on_line[ends[:, 0], None], ends, ends[:, ::-1])
    leaves = on_line[ends].sum(axis=1) == 1
    return _divided(boundary, np.where(leaves[:, None], outward, -1), ROW)


def _at_rim(boundary: BoundarySurface) -> Bool[np.ndarray, " v"]:
    """Vertices where held triangles end."""
    triangles, held = boundary.mesh.triangles, boundary.held
    at_rim = np.zeros(len(boundary.mesh.vertices), dtype=bool)
    at_rim[np.intersect1d(triangles[held], triangles[~held])] = True
    return at_rim


def _hollow_edges(boundary: BoundarySurface) -> Bool[np.ndarray, " e"]:
    """Creases that are re-entrant: the inside of a corner."""
    mesh, sides = boundary.mesh, boundary.sides
    centre, normal = mesh.vertices[mesh.triangles].mean(axis=1), unit_normals(mesh)
    away = centre[sides.twin // 3] - centre[:, None]
    rise = np.einsum("mkj,mj->mk", away, normal) / np.linalg.norm(away, axis=2).clip(min=1e-300)
    hollow = np.zeros(len(sides.cut), dtype=bool)
    hollow[sides.edge[rise > _HOLLOW]] = True
    return hollow & sides.cut


def _divided_session(
    session: Session, mesh: TriangleMesh, parent: Int[np.ndarray, " t"]
) -> Session:
    """A session on a mesh whose triangles are parts of its own."""
    placed = _placed_on(mesh, session)

    def children(triangles: Int[np.ndarray, " k"]) -> Int[np.ndarray, " c"]:
        return np.flatnonzero(np.isin(parent, triangles))

    return replace(
        session,
        mesh=mesh,
        held_triangles=children(session.held_triangles),
        supports=tuple(
            replace(support, triangles=children(support.triangles)) for support in session.supports
        ),
        probings=tuple(_divided_probing(probing, placed, parent) for probing in session.probings),
    )


def _placed_on(mesh: TriangleMesh, session: Session) -> Callable[[SurfacePoints], SurfacePoints]:
    """Function that locates points of a session's fields on another mesh; points common to several
    fields are searched for only once."""
    fields = [
        field
        for probing in session.probings
        for field in (probing.displacement, probing.support_displacement)
        if field is not None
    ]
    located: dict[int, SurfacePoints] = {}
    if fields:
        every, numbers = distinct_points([field.surface for field in fields])
        near = closest_points(mesh, every.position)
        for field, number in zip(fields, numbers, strict=True):
            located[id(field.surface)] = SurfacePoints(
                near.triangle[number],
                near.barycentric[number],
                near.position[number],
                field.surface.distance,
            )
    return lambda points: located[id(points)]


def _edge_ends(boundary: BoundarySurface) -> Int[np.ndarray, "e 2"]:
    """Both vertices of every edge of `Sides.edge`."""
    corner, sides = boundary.mesh.triangles, boundary.sides
    ends = np.empty((len(sides.cut), 2), dtype=np.int64)
    ends[sides.edge] = np.stack([corner, np.roll(corner, -1, axis=1)], axis=2)
    return ends


def _divided(
    boundary: BoundarySurface, cuts: Int[np.ndarray, "e 2"], share: float
) -> tuple[TriangleMesh, Int[np.ndarray, " t"]]:
    """Split edges (start, end; -1: not split) at a fraction of their length from their start."""
    mesh, edge = boundary.mesh, boundary.sides.edge
    # The midside node of an edge is the mean of those of its two sides.
    between = np.zeros((len(cuts), 3))
    np.add.at(between, edge.ravel(), 0.5 * boundary.element_nodes[:, 3:].reshape(-1, 3))
    is_cut = cuts[:, 0] >= 0
    start, end = mesh.vertices[cuts[is_cut]].transpose(1, 0, 2)
    # Quadratic along the edge.
    middle = (1 - share) * (1 - 2 * share) * start + share * (2 * share - 1) * end
    middle += 4 * share * (1 - share) * between[is_cut]
    vertices = np.concatenate([mesh.vertices, middle])
    number = np.full(len(cuts), -1)
    number[is_cut] = len(mesh.vertices) + np.arange(len(middle))
    triangles, parent = _cut(mesh.triangles, number[edge], vertices)
    return TriangleMesh(vertices, triangles), parent


def _cut(
    corner: Int[np.ndarray, "m 3"], new: Int[np.ndarray, "m 3"], vertices: Float[np.ndarray, "v 3"]
) -> tuple[Int[np.ndarray, "t 3"], Int[np.ndarray, " t"]]:
    """Subdivide triangles with new vertices on none to three of their edges (-1: none there)."""
    count = (new >= 0).sum(axis=1)
    # Rotated so that the only split edge, or the only one not split, lies between p and q.
    first = np.where(count == 1, new.argmax(axis=1), new.argmin(axis=1))
    every = np.arange(len(corner))
    p, q, r = (corner[every, (first + k) % 3] for k in range(3))
    pq, qr, rp = (new[every, (first + k) % 3] for k in range(3))
    across = np.linalg.norm(vertices[p] - vertices[qr], axis=1)
    shorter = across < np.linalg.norm(vertices[q] - vertices[rp], axis=1)
    kinds = [
        (count == 0, [(p, q, r)]),
        (count == 1, [(p, pq, r), (pq, q, r)]),
        ((count == 2) & shorter, [(rp, qr, r), (p, q, qr), (p, qr, rp)]),
        ((count == 2) & ~shorter, [(rp, qr, r), (p, q, rp), (q, qr, rp)]),
        (count == 3, [(p, pq, rp), (pq, q, qr), (rp, qr, r), (pq, qr, rp)]),
    ]
    parts, parent = [], []
    for chosen, children in kinds:
        for child in children:
            parts.append(np.stack([x[chosen] for x in child], axis=1))
            parent.append(np.flatnonzero(chosen))
    return np.concatenate(parts), np.concatenate(parent)


def _divided_probing(
    probing: Probing,
    placed: Callable[[SurfacePoints], SurfacePoints],
    parent: Int[np.ndarray, " t"],
) -> Probing:
    """A probing with its points and triangles on the new mesh."""

    def divided(contact: Contact) -> Contact:
        if contact.triangles is None:
            return contact
        return replace(contact, triangles=np.flatnonzero(np.isin(parent, contact.triangles)))

    def relocated(field: DisplacementField | None) -> DisplacementField | None:
        return None if field is None else replace(field, surface=placed(field.surface))

    return replace(
        probing,
        contact=divided(probing.contact),
        loads=tuple(replace(load, contact=divided(load.contact)) for load in probing.loads),
        displacement=relocated(probing.displacement),
        support_displacement=relocated(probing.support_displacement),
    )
