"""A mesh that is finer at the rims of its supports, where the traction grows without bound.

Where a held face ends, the traction behaves as a negative power of the distance. Elements of even
size there make the model too stiff as a whole, by 0.5 to 10 %, whatever happens elsewhere. Every
edge that leaves the rim is therefore cut near it, which puts one narrow row of elements on either
side. A model of the given mesh beside that of the graded one shows how much there was to gain.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.bem import SurfaceSettings, make_surface
from palpate.geometry import SurfacePoints, TriangleMesh, closest_points
from palpate.pipeline.model.moving_supports import held_directions
from palpate.records import Contact, DisplacementField, Probing, Session

# Width of the row at the rim over the length of the edges there.
ROW = 0.3
# The error falls at least with the first power of the elements' size at the rim: of what one step
# gains, this much is left.
LEFT_OF_STEP = ROW / (1.0 - ROW)


def graded_session(session: Session, *, surface: SurfaceSettings = SurfaceSettings()) -> Session:
    """The same session on a mesh that is finer at the rims of its supports.

    Parameters
    ----------
    session : Session
    surface : SurfaceSettings       new vertices lie on the surface so understood

    Returns
    -------
    Session                         vertices of the given mesh first, in their order; all points of
                                    its fields placed anew
    """
    boundary = make_surface(
        session.mesh, session.held_triangles, directions=held_directions(session), settings=surface
    )
    held = np.zeros(len(session.mesh.triangles), dtype=bool)
    held[session.held_triangles] = True
    mesh, parent = graded_mesh(session.mesh, held, boundary.element_nodes[:, 3:])

    def children(triangles: Int[np.ndarray, " k"]) -> Int[np.ndarray, " c"]:
        return np.flatnonzero(np.isin(parent, triangles))

    return replace(
        session,
        mesh=mesh,
        held_triangles=children(session.held_triangles),
        supports=tuple(replace(one, triangles=children(one.triangles)) for one in session.supports),
        probings=tuple(_replaced(one, mesh, parent) for one in session.probings),
    )


def graded_mesh(
    mesh: TriangleMesh,
    held: Bool[np.ndarray, " m"],
    middle: Float[np.ndarray, "m 3 3"],
) -> tuple[TriangleMesh, Int[np.ndarray, " t"]]:
    """Cut every edge that leaves the rim of the held triangles near it.

    Parameters
    ----------
    mesh : TriangleMesh
    held : (m,) bool
    middle : (m, 3, 3) float [m]    midpoints of the edges 01, 12, 20 on the surface

    Returns
    -------
    TriangleMesh                    vertices of the given one first
    (t,) int                        the given triangle that each of its triangles is a part of
    """
    corner = mesh.triangles
    is_rim = np.zeros(len(mesh.vertices), dtype=bool)
    is_rim[np.intersect1d(corner[held], corner[~held])] = True
    ends = np.sort(corner[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, edge = np.unique(ends, axis=0, return_inverse=True)
    edge = edge.reshape(-1, 3)
    # The midpoint of a sharp edge is the mean of what its two sides say.
    between = np.zeros((len(edges), 3))
    np.add.at(between, edge.ravel(), 0.5 * middle.reshape(-1, 3))
    # Edges that leave the rim, and those that cross a face between two places of the rim.
    sides = np.bincount(edge.ravel(), np.repeat(held, 3), minlength=len(edges))
    ends_at_rim = is_rim[edges].sum(axis=1)
    is_cut = (ends_at_rim == 1) | ((ends_at_rim == 2) & (sides != 1))
    start = np.where(is_rim[edges[is_cut, 0]], edges[is_cut, 0], edges[is_cut, 1])
    end = edges[is_cut].sum(axis=1) - start
    # Quadratic along the edge; a crossing one is cut in its middle.
    t = np.where(ends_at_rim[is_cut] == 1, ROW, 0.5)[:, None]
    place = (1 - t) * (1 - 2 * t) * mesh.vertices[start] + t * (2 * t - 1) * mesh.vertices[end]
    place += 4 * t * (1 - t) * between[is_cut]
    vertices = np.concatenate([mesh.vertices, place])
    number = np.full(len(edges), -1)
    number[is_cut] = len(mesh.vertices) + np.arange(len(place))
    triangles, parent = _cut(corner, number[edge], vertices)
    return TriangleMesh(vertices, triangles), parent


def _cut(
    corner: Int[np.ndarray, "m 3"], new: Int[np.ndarray, "m 3"], vertices: Float[np.ndarray, "v 3"]
) -> tuple[Int[np.ndarray, "t 3"], Int[np.ndarray, " t"]]:
    """Triangles with new vertices on none to three of their edges (-1: none there), in parts."""
    count = (new >= 0).sum(axis=1)
    # Turned so that the edge that is cut alone, or not alone, lies between p and q.
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


def _replaced(probing: Probing, mesh: TriangleMesh, parent: Int[np.ndarray, " t"]) -> Probing:
    """A probing whose points and triangles are those of the graded mesh."""

    def contact(one: Contact) -> Contact:
        if one.triangles is None:
            return one
        return replace(one, triangles=np.flatnonzero(np.isin(parent, one.triangles)))

    def field(one: DisplacementField | None) -> DisplacementField | None:
        return None if one is None else replace(one, surface=_placed(mesh, one.surface))

    return replace(
        probing,
        contact=contact(probing.contact),
        loads=tuple(replace(load, contact=contact(load.contact)) for load in probing.loads),
        displacement=field(probing.displacement),
        support_displacement=field(probing.support_displacement),
    )


def _placed(mesh: TriangleMesh, place: SurfacePoints) -> SurfacePoints:
    return replace(closest_points(mesh, place.position), distance=place.distance)
