"""A closed manifold surface with outward normals from the output of a scanner or CAD program."""

from dataclasses import dataclass

import numpy as np

from palpate.errors import MeshError
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    checked_mesh,
    enclosed_volume,
    triangle_areas,
)
from palpate.optional_imports import late_import
from palpate.scanning.mending.action import Action, place_text
from palpate.scanning.mending.cleaning import cleaned, compacted, seam_width
from palpate.scanning.mending.deviation import distances
from palpate.scanning.mending.holes import closed
from palpate.scanning.mending.pieces import oriented, pieces, without_dust, without_walls
from palpate.scanning.mending.solid import above, united, wrapped
from palpate.scanning.plane import Plane
from palpate.shapes import Vector3

# Thickness relative to size below which, roughly, a surface is a sheet and not that of a body.
_SHEET = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Mended:
    """A mended surface.

    Attributes
    ----------
    mesh : TriangleMesh             closed, manifold, outward normals; triangles not yet even
    actions : tuple of Action       repairs made
    guessed : TriangleMesh or None  patches that close holes and were not measured
    """

    mesh: TriangleMesh
    actions: tuple[Action, ...]
    guessed: TriangleMesh | None


def mend(mesh: TriangleMesh, support: Plane | None = None) -> Mended:
    """Mend a surface, or raise an error that says where and why it cannot be mended.

    Parameters
    ----------
    mesh : TriangleMesh             welded
    support : Plane or None         plane on which the object stood; the surface is cut off or
                                    closed there

    Returns
    -------
    Mended

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
        place = mesh.vertices[mesh.triangles[np.flatnonzero(turned)[0]]].mean(axis=0)
        actions.append(Action("flipped triangle", int(turned.sum()), place, "turned outward"))
    _refuse_cavities(before, mesh)
    if support is not None:
        support = _upward(support, mesh)
    mesh, guessed, more = closed(mesh, support)
    actions += more
    patches = compacted(mesh.vertices, mesh.triangles[guessed]) if guessed.any() else None
    _refuse_sheet(mesh)
    mesh, more = _one_solid(mesh)
    actions += more
    if support is not None:
        mesh, more = _cut(mesh, support)
        actions += more
    return Mended(mesh, tuple(actions), patches)


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
    found = checked_mesh(wrapped(mesh))[0]
    gap = distances(found.vertices, mesh)
    if float(gap.max()) > 0.05 * bounding_diagonal(mesh):
        raise MeshError(
            f"{reason}; what it winds around is {1e3 * gap.max():.3g} mm off it near"
            f" {place_text(found.vertices[gap.argmax()])}"
        ) from reason
    place = _first_crossing(mesh)
    return found, [Action("self-intersection", 1, place, "the outer skin found anew on a grid")]


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
    place = mesh.vertices[deepest]
    if heights[deepest] < -seam_width(mesh):
        mesh = above(mesh, support)
        actions = [Action("part below the support", 1, place, "cut off at its plane")]
    if not (abs(support.heights(mesh.vertices))[mesh.triangles] < seam_width(mesh)).all(1).any():
        raise MeshError(
            f"nothing of the object lies on the support: its lowest point, {place_text(place)}, is"
            f" {1e3 * heights[deepest]:.3g} mm above the plane; check the plane and the unit of the"
            " mesh"
        )
    return mesh, actions
