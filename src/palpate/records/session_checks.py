"""What a session must satisfy beyond its syntax, and what looks implausible about it."""

from collections.abc import Sequence

import numpy as np

from palpate.errors import InputError
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    mesh_quality,
    triangle_distances,
    unit_normals,
)
from palpate.records.contact import RIGID, Contact
from palpate.records.probing import DisplacementField, Probing, observed_rows
from palpate.records.support import FREE, GIVEN, Support
from palpate.shapes import Indices

# Mean edge over thickness from which a sheet bends wrongly: by 30 to 90 % at 2.
_COARSE_EDGE = 1.5
# Objects that one can probe on a bench; beyond them the unit is more likely wrong than the object.
_SMALLEST_OBJECT, _LARGEST_OBJECT = 1e-3, 5.0
_UNIT_HINT = "is the mesh in another unit, e.g. millimetres? Check length_unit in [object]"


def check_supports(
    mesh: TriangleMesh, supports: Sequence[Support], probings: Sequence[Probing]
) -> None:
    """Refuse supports that touch, and motions and forces that do not belong to them.

    Parameters
    ----------
    mesh : TriangleMesh
    supports : sequence of Support
    probings : sequence of Probing

    Raises
    ------
    InputError                      the text names supports by their number from 1, and the probing
    """
    corners = [np.unique(mesh.triangles[support.triangles]) for support in supports]
    for second in range(len(supports)):
        for first in range(second):
            shared = np.intersect1d(corners[first], corners[second]).size
            if shared:
                raise InputError(
                    f"supports {first + 1} and {second + 1} share {shared} vertices, which cannot"
                    " follow both; leave a row of free triangles between them"
                )
    given = [number for number, one in enumerate(supports, start=1) if one.motion == GIVEN]
    for probing in probings:
        _check_motion(probing, given)
        if probing.contact.profile == RIGID and probing.contact.triangles is not None:
            _check_pulled(probing, probing.contact.triangles, supports)


def _check_motion(probing: Probing, given: Sequence[int]) -> None:
    """Refuse a motion that is missing, or that no support asks for."""
    place = f"probing '{probing.name}'"
    has_motion = probing.support_motion is not None
    if given and not has_motion and probing.support_displacement is None:
        raise InputError(
            f"{place}: the motion of support {given[0]} is to be given; name the file of its"
            " displacements as support_displacement, or a rigid motion as support_motion"
        )
    if not given and (has_motion or probing.support_displacement is not None):
        raise InputError(
            f'{place}: gives a motion of the support, but no support has motion = "given"; say so'
            " in [support], or leave it out"
        )
    if has_motion and len(given) > 1:
        raise InputError(
            f"{place}: support_motion is one motion, but that of {len(given)} supports is to be"
            " given; give support_displacement, with points on each of them"
        )


def _check_pulled(probing: Probing, triangles: Indices, supports: Sequence[Support]) -> None:
    """Refuse a force on a support that cannot follow it, or that nothing reacts against."""
    place = f"probing '{probing.name}'"
    pulled = [
        number
        for number, one in enumerate(supports, start=1)
        if np.array_equal(one.triangles, triangles)
    ]
    if not pulled or len(supports) < 2:
        raise InputError(
            f"{place}: its force acts on a support, but no other support is there to react against"
            " it; select the other grip in a [[support]] of its own"
        )
    if supports[pulled[0] - 1].motion != FREE:
        raise InputError(
            f"{place}: its force acts on support {pulled[0]}, whose motion is"
            f" '{supports[pulled[0] - 1].motion}'; a support that is pulled moves as the force"
            ' makes it: say motion = "free", and give its measured points in the displacement file'
        )
    if probing.tip_displacement is not None:
        raise InputError(
            f"{place}: tip_displacement is of a tool's contact point, but the force acts on a"
            " support; give the displacement of the grip in the displacement file"
        )


def check_contact(mesh: TriangleMesh, held: Indices, contact: Contact) -> None:
    """Refuse a contact patch that misses the surface or reaches into the support.

    Parameters
    ----------
    mesh : TriangleMesh
    held : (k,) int                 triangles of the support
    contact : Contact

    Raises
    ------
    InputError                      the text gives the distances
    """
    if contact.triangles is not None:
        shared = np.intersect1d(contact.triangles, held).size
        if shared and contact.profile != RIGID:
            raise InputError(
                f"{shared} of the {contact.triangles.size} loaded triangles belong to the support;"
                " a load there moves nothing: leave them out, or load the support as a whole with"
                " contact = { support = 1 }"
            )
        return
    distance = triangle_distances(mesh, contact.point)
    gap = float(distance.min())
    radius = contact.radius
    reach = 3.0 * mesh_quality(mesh).edge_mean if radius is None else radius
    if gap >= reach:
        what = "three mean edge lengths" if radius is None else "its radius"
        raise InputError(
            f"the contact misses the surface: its point is {gap:.4g} m away from it, {what} is"
            f" {reach:.3g} m (the mesh is {bounding_diagonal(mesh):.3g} m across);"
            " check the point and length_unit"
        )
    if radius is None:
        vertex = int(np.linalg.norm(mesh.vertices - contact.point, axis=1).argmin())
        if vertex in mesh.triangles[held]:
            raise InputError(
                f"the contact is partly on the support: the nearest vertex ({vertex}) belongs to a"
                " held triangle; probe farther from the support, or refine the mesh there"
            )
        return
    # Triangles that face the other way are the far side of a thin object, out of the tool's reach.
    normals = unit_normals(mesh)
    facing = normals[held] @ normals[int(distance.argmin())] > -0.5
    clear = float(distance[held][facing].min(initial=np.inf))
    if clear < radius:
        raise InputError(
            f"the contact is partly on the support: its point is {clear:.4g} m from the support,"
            f" nearer than its radius of {radius:.4g} m; probe farther from the support, or check"
            " the radius"
        )


def check_observed_points(mesh: TriangleMesh, held: Indices, field: DisplacementField) -> None:
    """Refuse a field whose measured points all sit on a support that does not move.

    Parameters
    ----------
    mesh : TriangleMesh
    held : (k,) int                 triangles that do not move
    field : DisplacementField       on that mesh

    Raises
    ------
    InputError
    """
    measured = observed_rows(field)
    corners = mesh.triangles[field.surface.triangle[measured]]
    is_held = np.zeros(len(mesh.vertices), dtype=bool)
    is_held[mesh.triangles[held]] = True
    # A point counts as held where every vertex that carries weight is.
    fixed = (is_held[corners] | (field.surface.barycentric[measured] < 1e-6)).all(axis=1)
    if fixed.all():
        raise InputError(
            f"all {len(fixed)} measured points of {field.source} are on the support, which does"
            " not move: they say nothing; check the support and length_unit (the mesh is"
            f" {bounding_diagonal(mesh):.3g} m across)"
        )


def plausibility_notes(mesh: TriangleMesh, probings: tuple[Probing, ...]) -> tuple[str, ...]:
    """Sentences about sizes and signs that are possible but more likely a mistake.

    Parameters
    ----------
    mesh : TriangleMesh             in metres
    probings : tuple of Probing

    Returns
    -------
    tuple of str                    full sentences
    """
    size = bounding_diagonal(mesh)
    notes = []
    edge = mesh_quality(mesh).edge_mean
    offset = mesh.vertices - mesh.vertices.mean(axis=0)
    axes = np.linalg.svd(offset, full_matrices=False)[2]
    thickness = float(np.ptp(offset @ axes.T, axis=0).min())
    if edge > _COARSE_EDGE * thickness:
        notes.append(
            f"The object is a sheet {1e3 * thickness:.3g} mm thick and the edges of its triangles"
            f" are {1e3 * edge:.3g} mm long: stretching in its plane is modelled, bending out of it"
            " comes out far too stiff. If it bends, use edges shorter than it is thick."
        )
    if not _SMALLEST_OBJECT <= size <= _LARGEST_OBJECT:
        notes.append(f"The object is {size:.3g} m across, an implausible size: {_UNIT_HINT}.")
    for probing in probings:
        notes += [f"Probing {probing.name}: {text}" for text in _probing_notes(mesh, probing, size)]
    return tuple(notes)


def _probing_notes(mesh: TriangleMesh, probing: Probing, size: float) -> list[str]:
    notes = []
    doubt = f"against an object of {size:.3g} m: {_UNIT_HINT}."
    radius = probing.contact.radius
    if radius is not None and not 1e-3 * size <= radius <= 0.5 * size:
        notes.append(f"the contact radius of {radius:.3g} m is implausible {doubt}")
    largest = _largest_displacement(probing)
    moved = f"the largest displacement of {largest:.3g} m is implausibly"
    if 0.0 < largest < 1e-5 * size:
        notes.append(f"{moved} small {doubt}")
    elif largest > 0.5 * size:
        notes.append(f"{moved} large {doubt}")
    elif largest > 0.1 * size:
        notes.append(
            f"the largest displacement is {100.0 * largest / size:.0f} % of the object's size,"
            " outside small deformation; the estimate will be biased: press less."
        )
    size = float(np.linalg.norm(probing.force))
    if probing.contact.triangles is not None or not size:
        return notes
    direction = probing.force / size
    triangle = int(triangle_distances(mesh, probing.contact.point).argmin())
    if float(unit_normals(mesh)[triangle] @ direction) > 0.5:
        notes.append(
            "the force points out of the surface: the tool pulls; the force must be the one on"
            " the object, not on the tool."
        )
    tip = probing.tip_displacement
    if tip is not None and float(tip @ direction) < 0.0:
        notes.append(
            "the tip moved against the force; check the signs of force and tip_displacement."
        )
    return notes


def _largest_displacement(probing: Probing) -> float:
    """Length of the longest measured displacement vector, tip included [m]."""
    lengths = [0.0]
    if probing.displacement is not None:
        moved = probing.displacement.displacement[observed_rows(probing.displacement)]
        lengths += [float(np.linalg.norm(moved, axis=1).max(initial=0.0))]
    if probing.tip_displacement is not None:
        lengths.append(float(np.linalg.norm(probing.tip_displacement)))
    return max(lengths)
