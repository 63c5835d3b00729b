"""One solid from parts that overlap, or from a surface that passes through itself."""

from typing import Any

import numpy as np

from palpate.errors import MeshError
from palpate.geometry import TriangleMesh, bounding_diagonal, checked_mesh, enclosed_volume
from palpate.optional_imports import late_import
from palpate.scanning.mending.action import Action, place_text
from palpate.scanning.mending.adapt import adapted
from palpate.scanning.mending.cleaning import compacted
from palpate.scanning.mending.deviation import distances
from palpate.scanning.mending.pieces import pieces
from palpate.scanning.plane import Plane

_PURPOSE = "uniting parts of a surface"
# What a part must have of the volume of all to be an object of its own.
_PART = 0.01
# Nodes of the grid on which a surface that passes through itself is found anew: cells of about a
# seventieth of the object, in seconds.
_NODES = 4e5
# Edges of the triangles made of it, in cells.
_EDGE = 2.5
# Least distance of a node from the surface, in cells.
_LEAST = 0.02
_MARGIN = 3
# Edges shorter than this beside a cut are collapsed, of the diagonal.
_NEEDLE = 3e-4


def united(parts: list[TriangleMesh]) -> tuple[TriangleMesh, list[Action]]:
    """The skin of closed parts together, exact, its edges sharp.

    Parameters
    ----------
    parts : list of TriangleMesh    each closed, manifold, outward

    Returns
    -------
    mesh : TriangleMesh
    actions : list of Action

    Raises
    ------
    MeshError                       they are several objects
    """
    manifold = late_import("manifold3d", extra="surface", purpose=_PURPOSE)
    whole = manifold.Manifold.batch_boolean([_solid(part) for part in parts], manifold.OpType.Add)
    separate = sorted(whole.decompose(), key=lambda solid: -solid.volume())
    large = [solid for solid in separate if solid.volume() > _PART * whole.volume()]
    if len(large) > 1:
        raise _several(large)
    place = parts[1].vertices.mean(axis=0)
    return _mesh(separate[0]), [Action("overlapping part", len(parts) - 1, place, "united")]


def wrapped(mesh: TriangleMesh) -> TriangleMesh:
    """The skin of what a surface winds around, found anew on a grid.

    Overlaps, folds, walls and gaps below a cell vanish; sharp edges are blunt by a part of a cell.

    Parameters
    ----------
    mesh : TriangleMesh             consistently oriented, outward as far as it can be said

    Returns
    -------
    TriangleMesh                    closed

    Raises
    ------
    MeshError                       it is several objects

    Source
    ------
    Jacobson, Kavan, Sorkine-Hornung, Robust inside-outside segmentation using generalized winding
    numbers, ACM Trans. Graph. 32 (2013); Barill and others, Fast winding numbers for soups and
    clouds, ACM Trans. Graph. 37 (2018).
    """
    igl = late_import("igl", extra="surface", purpose="finding a surface anew")
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    cell = float((np.prod(high - low) / _NODES) ** (1.0 / 3.0))
    sides = [np.arange(-_MARGIN, int(span / cell) + _MARGIN + 2) for span in high - low]
    # Off the faces of boxes, which would lie on the nodes.
    origin = low - 0.317 * cell
    z, y, x = np.meshgrid(sides[2], sides[1], sides[0], indexing="ij")
    place = origin + cell * np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    # Turned inside out, a part winds -1 times around its inside: no body.
    inside = np.asarray(igl.fast_winding_number(mesh.vertices, mesh.triangles, place)).ravel() > 0.5
    # A surface through a node would have triangles without area there.
    gap = np.maximum(distances(place, mesh), _LEAST * cell)
    signed = np.where(inside, -1.0, 1.0) * gap
    found = igl.marching_cubes(signed, place, *(len(side) for side in sides), 0.0)
    skin = compacted(np.asarray(found[0]), found[1].astype(np.int64))
    # The steps of the grid are no creases.
    skin = largest_piece(skin)
    size = np.full(len(skin.vertices), _EDGE * cell)
    return adapted(skin, size, creases=False)


def largest_piece(mesh: TriangleMesh) -> TriangleMesh:
    """The one object of a closed surface.

    Parameters
    ----------
    mesh : TriangleMesh             closed

    Returns
    -------
    TriangleMesh                    the piece with the largest volume

    Raises
    ------
    MeshError                       a second piece is as good an object
    """
    label = pieces(mesh.triangles)
    parts = [compacted(mesh.vertices, mesh.triangles[label == k]) for k in range(label.max() + 1)]
    volume = np.array([enclosed_volume(part) for part in parts])
    if (volume > _PART * volume.max()).sum() > 1:
        raise _several([parts[k] for k in np.argsort(-volume)[:2]])
    return parts[int(volume.argmax())]


def above(mesh: TriangleMesh, plane: Plane) -> TriangleMesh:
    """The part of a solid above a plane, the cut closed.

    Parameters
    ----------
    mesh : TriangleMesh             closed, manifold, outward
    plane : Plane                   its normal points to what is kept

    Returns
    -------
    TriangleMesh
    """
    cut = _solid(mesh).trim_by_plane(plane.normal.tolist(), float(plane.normal @ plane.point))
    # Where the plane passes close by a vertex it leaves needles.
    cut = cut.simplify(_NEEDLE * bounding_diagonal(mesh))
    return checked_mesh(largest_piece(_mesh(cut)))[0]


def _several(parts: list[Any]) -> MeshError:
    meshes = [part if isinstance(part, TriangleMesh) else _mesh(part) for part in parts]
    places = " and ".join(place_text(mesh.vertices.mean(axis=0)) for mesh in meshes[:2])
    sizes = " and ".join(f"{1e6 * enclosed_volume(mesh):.3g} cm^3" for mesh in meshes[:2])
    return MeshError(
        f"the surface is {len(meshes)} separate objects, around {places}, of {sizes}; keep one,"
        " or join them in a mesh program"
    )


def _solid(mesh: TriangleMesh) -> Any:
    manifold = late_import("manifold3d", extra="surface", purpose=_PURPOSE)
    # It takes no read-only arrays.
    return manifold.Manifold(
        manifold.Mesh64(mesh.vertices.copy(), mesh.triangles.astype(np.uint64))
    )


def _mesh(solid: Any) -> TriangleMesh:
    found = solid.to_mesh64()
    vertices = np.array(found.vert_properties[:, :3], dtype=np.float64)
    return compacted(vertices, found.tri_verts.astype(np.int64))
