"""One solid from overlapping parts, or from a self-intersecting surface."""

from typing import Any

import numpy as np

from palpate.errors import MeshError
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    checked_mesh,
    enclosed_volume,
    place_text,
)
from palpate.optional_imports import late_import
from palpate.scanning.cleaning import compacted, pieces
from palpate.scanning.plane import Action, Plane
from palpate.scanning.remesh import adapted, distances

_PURPOSE = "uniting parts of a surface"
# Fraction of the volume above which a part counts as an object of its own.
_PART = 0.01
# Nodes of the grid on which a self-intersecting surface is reconstructed: cells of about 1/70 of
# the object, within seconds.
_NODES = 4e5
# Edge length of the resulting triangles, in cells.
_EDGE = 2.5
# Minimum distance of a node from the surface, in cells.
_MIN_DISTANCE = 0.02
# Margin of the grid around the surface, in cells.
_MARGIN = 3
# Vertices closer to a cut than this fraction of the diagonal are moved into it, and shorter edges
# beside it are collapsed.
_NEEDLE = 3e-4


def united(parts: list[TriangleMesh]) -> tuple[TriangleMesh, list[Action]]:
    """Exact Boolean union of closed parts, with sharp edges.

    Parameters
    ----------
    parts : list of TriangleMesh    each closed, manifold, with outward normals

    Returns
    -------
    mesh : TriangleMesh
    actions : list of Action

    Raises
    ------
    MeshError                       the union is several separate objects
    InputError                      a package of the extra `surface` is not installed
    """
    manifold = late_import("manifold3d", extra="surface", purpose=_PURPOSE)
    whole = manifold.Manifold.batch_boolean([_solid(part) for part in parts], manifold.OpType.Add)
    separate = sorted(whole.decompose(), key=lambda solid: -solid.volume())
    large = [solid for solid in separate if solid.volume() > _PART * whole.volume()]
    if len(large) > 1:
        raise _several(large)
    position = parts[1].vertices.mean(axis=0)
    return _mesh(separate[0]), [Action("overlapping part", len(parts) - 1, position, "united")]


def wrapped(mesh: TriangleMesh) -> TriangleMesh:
    """Reconstruct the outer boundary of a surface from its winding number on a grid.

    Overlaps, folds, inner walls, and gaps smaller than a cell vanish; sharp edges are blunted by a
    fraction of a cell.

    Parameters
    ----------
    mesh : TriangleMesh             consistently oriented, with outward normals as far as defined

    Returns
    -------
    TriangleMesh                    closed

    Raises
    ------
    MeshError                       the surface bounds several objects
    InputError                      a package of the extra `surface` is not installed

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
    # Offset, so that nodes do not lie exactly on the faces of boxes.
    origin = low - 0.317 * cell
    z, y, x = np.meshgrid(sides[2], sides[1], sides[0], indexing="ij")
    nodes = origin + cell * np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    # A part that is inside out has winding number -1 and does not count as a body.
    inside = np.asarray(igl.fast_winding_number(mesh.vertices, mesh.triangles, nodes)).ravel() > 0.5
    # If the surface passed through a node, triangles there would have no area.
    gap = np.maximum(distances(nodes, mesh), _MIN_DISTANCE * cell)
    signed = np.where(inside, -1.0, 1.0) * gap
    surface = igl.marching_cubes(signed, nodes, *(len(side) for side in sides), 0.0)
    skin = compacted(np.asarray(surface[0]), surface[1].astype(np.int64))
    # Steps of the grid must not be kept as creases below.
    skin = largest_piece(skin)
    size = np.full(len(skin.vertices), _EDGE * cell)
    return adapted(skin, size, creases=False)


def largest_piece(mesh: TriangleMesh) -> TriangleMesh:
    """The piece of a closed surface with the largest volume.

    Parameters
    ----------
    mesh : TriangleMesh             closed

    Returns
    -------
    TriangleMesh

    Raises
    ------
    MeshError                       a second piece has more than 1 % of its volume
    """
    label = pieces(mesh.triangles)
    parts = [compacted(mesh.vertices, mesh.triangles[label == k]) for k in range(label.max() + 1)]
    volume = np.array([enclosed_volume(part) for part in parts])
    if (volume > _PART * volume.max()).sum() > 1:
        raise _several([parts[k] for k in np.argsort(-volume)[:2]])
    return parts[int(volume.argmax())]


def above(mesh: TriangleMesh, plane: Plane) -> TriangleMesh:
    """The part of a solid above a plane, with the cut closed.

    Parameters
    ----------
    mesh : TriangleMesh             closed, manifold, outward normals
    plane : Plane                   its normal points to the side that is kept

    Returns
    -------
    TriangleMesh

    Raises
    ------
    MeshError                       several pieces remain
    """
    needle = _NEEDLE * bounding_diagonal(mesh)
    height = plane.heights(mesh.vertices)
    # The cut goes through vertices that are this close: else it would leave needles, and where the
    # short edges of these are collapsed a corner of the cut could end above the plane.
    moved = np.where(abs(height) < needle, height, 0.0)[:, None] * plane.normal
    through = TriangleMesh(mesh.vertices - moved, mesh.triangles)
    cut = _solid(through).trim_by_plane(plane.normal.tolist(), float(plane.normal @ plane.point))
    cut = cut.simplify(needle)
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
    # manifold3d does not accept read-only arrays.
    return manifold.Manifold(
        manifold.Mesh64(mesh.vertices.copy(), mesh.triangles.astype(np.uint64))
    )


def _mesh(solid: Any) -> TriangleMesh:
    mesh = solid.to_mesh64()
    vertices = np.array(mesh.vert_properties[:, :3], dtype=np.float64)
    return compacted(vertices, mesh.tri_verts.astype(np.int64))
