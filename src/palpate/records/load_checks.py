"""Checks of a probing against the mesh: its contact and force, and its measured displacements (no
motion at all, positions instead, duplicated data).
"""

import numpy as np

from palpate.errors import InputError, quoted
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    enclosed_volume,
    mesh_quality,
    triangle_areas,
    triangle_distances,
    unit_normals,
)
from palpate.records.contact import RIGID, Contact
from palpate.records.probing import DisplacementField, Probing, lengths, observed_rows
from palpate.records.quantities import HIGHEST_PRESSURE, MODULUS_RANGE, modulus_unit
from palpate.shapes import Flags, Indices

UNIT_HINT = "is the mesh in another unit, e.g. millimetres? Check length_unit in [object]"
# Least Young's modulus of a body that does not collapse under its own weight, per metre of height,
# for the lightest solid (1 kg/m^3) [Pa/m].
_SOFTEST_PER_METRE = 9.81
# Displacements are taken for positions under load if they differ from the points by less than this
# fraction of themselves, exceed this fraction of the body's size, and there are at least so many.
_MAX_DIFFERENCE, _MIN_LENGTH, _MIN_POINTS = 0.3, 0.1, 3


def check_contact(mesh: TriangleMesh, held: Indices, contact: Contact) -> None:
    """Refuse a contact patch that misses the surface, is wider than it, or reaches the support.

    Parameters
    ----------
    mesh : TriangleMesh
    held : (k,) int                 triangles of the support
    contact : Contact

    Raises
    ------
    InputError                      the text gives the distances; also loaded triangles that belong
                                    to the support
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
    size = bounding_diagonal(mesh)
    if radius is not None and 2.0 * radius > size:
        raise InputError(
            f"the contact is wider than the body: its radius is {radius:.3g} m, the mesh is"
            f" {size:.3g} m across; check the radius and length_unit"
        )
    reach = 3.0 * mesh_quality(mesh).edge_mean if radius is None else radius
    if gap >= reach:
        what = "three mean edge lengths" if radius is None else "its radius"
        raise InputError(
            f"the contact misses the surface: its point is {gap:.4g} m away from it, {what} is"
            f" {reach:.3g} m (the mesh is {size:.3g} m across);"
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
    # Triangles that face the other way are on the far side of a thin object, out of reach.
    normals = unit_normals(mesh)
    facing = normals[held] @ normals[int(distance.argmin())] > -0.5
    clearance = float(distance[held][facing].min(initial=np.inf))
    if clearance < radius:
        raise InputError(
            f"the contact is partly on the support: its point is {clearance:.4g} m from the"
            f" support, nearer than its radius of {radius:.4g} m; probe farther from the support,"
            " or check the radius"
        )


def check_load(mesh: TriangleMesh, probing: Probing) -> None:
    """Refuse a force that is incompatible with the measured displacement for any material.

    Parameters
    ----------
    mesh : TriangleMesh
    probing : Probing

    Raises
    ------
    InputError                      the text gives the implied modulus, pressure or displacement
    """
    size, force = bounding_diagonal(mesh), float(np.linalg.norm(probing.force))
    if probing.tip_displacement is not None and not probing.tip_displacement.any():
        raise InputError(
            f"tip_displacement is exactly zero under {force:.3g} N, as of a body that nothing"
            " moves; leave it out where it was not measured"
        )
    moved, radius = largest_displacement(probing), probing.contact.radius
    tip = probing.tip_displacement
    is_tip = tip is not None and float(np.linalg.norm(tip)) == moved
    key = "tip_displacement" if is_tip else "displacement"
    if moved > size:
        raise InputError(
            f"{key} reaches {moved:.3g} m, more than the body of {size:.3g} m across:"
            f" a held body does not move so far; {UNIT_HINT}, and the unit of the displacements"
        )
    low, high = modulus_range(mesh, force, moved)
    pressure = 0.0 if radius is None else force / (np.pi * radius**2)
    softest, stiffest = MODULUS_RANGE
    if low > stiffest:
        what = f"a Young's modulus of {pascals(low)} or more, stiffer than diamond"
    elif high < max(softest, _SOFTEST_PER_METRE * size):
        what = f"a Young's modulus of {pascals(high)} or less, of a body too soft for its weight"
    elif pressure > HIGHEST_PRESSURE:
        what = f"a pressure of {pascals(pressure)} at the contact, more than any steel bears"
        if moved:
            what += f", and a Young's modulus of about {pascals(float(np.sqrt(low * high)))}"
    else:
        return
    raise InputError(
        f"a force of {force:.3g} N, with a {key} of {moved:.3g} m at most of a body of"
        f" {size:.3g} m, means {what}; is the force in N? Check length_unit and the contact radius"
    )


def pascals(value: float) -> str:
    """A modulus or pressure as text, to two digits, in Pa, kPa, MPa or GPa.

    Parameters
    ----------
    value : float [Pa]

    Returns
    -------
    str
    """
    factor, unit = modulus_unit(value)
    return f"{float(f'{value / factor:.2g}'):g} {unit}"


def modulus_range(mesh: TriangleMesh, force: float, moved: float) -> tuple[float, float]:
    """Bounds on Young's modulus from a force and its displacement, to an order of magnitude.

    For a body of thickness t and length L: the lower bound F t / (L^2 u) assumes compression
    through the thickness, the upper bound F L^3 / (t^4 u) bending.

    Parameters
    ----------
    mesh : TriangleMesh
    force : float [N]
    moved : float [m]               largest displacement; 0: none was measured

    Returns
    -------
    (float, float) [Pa]             (0, infinity) if nothing moved
    """
    if moved == 0.0:
        return 0.0, np.inf
    length = bounding_diagonal(mesh)
    # The side of a long square rod exactly; two thirds of a cube's side; twice a plate's thickness.
    thickness = 4.0 * enclosed_volume(mesh) / float(triangle_areas(mesh).sum())
    return (
        force * thickness / (length**2 * moved),
        force * length**3 / (thickness**4 * moved),
    )


def largest_displacement(probing: Probing) -> float:
    """Length of the longest measured displacement vector, including the tip's.

    Parameters
    ----------
    probing : Probing

    Returns
    -------
    float [m]                       0 if nothing was measured
    """
    largest = [0.0]
    if probing.displacement is not None:
        moved = probing.displacement.displacement[observed_rows(probing.displacement)]
        largest += [float(lengths(moved).max(initial=0.0))]
    if probing.tip_displacement is not None:
        largest.append(float(np.linalg.norm(probing.tip_displacement)))
    return max(largest)


def check_observed_points(mesh: TriangleMesh, held: Indices, field: DisplacementField) -> None:
    """Refuse a field that carries no information: all zero, positions, or only on fixed supports.

    Parameters
    ----------
    mesh : TriangleMesh
    held : (k,) int                 triangles that do not move
    field : DisplacementField       on that mesh

    Raises
    ------
    InputError                      the text says which of these it is
    """
    measured = observed_rows(field)
    if not lengths(field.displacement[measured]).any():
        raise InputError(
            f"the displacement of all {int(measured.sum())} measured points of {field.source} is"
            " exactly zero: nothing moved, which says nothing about stiffness; were the pictures at"
            " rest compared with themselves?"
        )
    _check_not_positions(mesh, field, measured)
    fixed = held_points(mesh, held, field)[measured]
    if fixed.all():
        raise InputError(
            f"all {len(fixed)} measured points of {field.source} are on the support, which does"
            " not move: they say nothing; check the support and length_unit (the mesh is"
            f" {bounding_diagonal(mesh):.3g} m across)"
        )


def held_points(mesh: TriangleMesh, held: Indices, field: DisplacementField) -> Flags:
    """Which points of a field lie on held triangles.

    Parameters
    ----------
    mesh : TriangleMesh
    held : (k,) int                 triangles
    field : DisplacementField       on that mesh

    Returns
    -------
    (n,) bool
    """
    corners = mesh.triangles[field.surface.triangle]
    is_held = np.zeros(len(mesh.vertices), dtype=bool)
    is_held[mesh.triangles[held]] = True
    # A point is held if every vertex with non-zero barycentric weight is.
    return (is_held[corners] | (field.surface.barycentric < 1e-6)).all(axis=1)


def _check_not_positions(mesh: TriangleMesh, field: DisplacementField, measured: Flags) -> None:
    """Refuse positions under load in place of displacements."""
    moved, rest = field.displacement[measured], field.points[measured]
    length, difference = (float(np.sqrt((lengths(x) ** 2).mean())) for x in (moved, moved - rest))
    if (
        measured.sum() >= _MIN_POINTS
        and length > _MIN_LENGTH * bounding_diagonal(mesh)
        and difference < _MAX_DIFFERENCE * length
    ):
        raise InputError(
            f"ux,uy,uz of {field.source} are nearly its x,y,z: they differ by {difference:.3g} m,"
            f" of {length:.3g} m: are they places under load? Take x,y,z off them"
        )


def check_copies(probings: tuple[Probing, ...]) -> None:
    """Refuse the same measurement in two probings: counted twice, it would narrow the intervals.

    Parameters
    ----------
    probings : tuple of Probing

    Raises
    ------
    InputError                      two share at least half of their rows; the text names both
    """
    earlier: list[tuple[Probing, set[bytes]]] = []
    for probing in probings:
        if probing.displacement is None:
            continue
        rows = _moved_rows(probing.displacement)
        for other, others in earlier:
            if shared := copied_rows(rows, others):
                raise InputError(
                    f"{shared} of {len(rows)} points of probing {quoted(probing.name)} have the"
                    f" same displacement, digit by digit, as in probing {quoted(other.name)};"
                    " noise makes any two measurements differ: name the file that belongs to each,"
                    " or leave one out"
                )
        earlier.append((probing, rows))


def copied_rows(rows: set[bytes], others: set[bytes]) -> int:
    """Number of rows that two measurements share, digit by digit, if one is a copy of the other.

    Parameters
    ----------
    rows, others : set of bytes     one entry per row

    Returns
    -------
    int                             0 if it is less than half of the rows of the shorter one
    """
    shared = len(rows & others)
    return shared if 2 * shared >= min(len(rows), len(others)) else 0


def _moved_rows(field: DisplacementField) -> set[bytes]:
    """Position and displacement of each measured point that moved, as bytes."""
    rows = np.hstack([field.points, field.displacement])[observed_rows(field)]
    return {row.tobytes() for row in rows[rows[:, 3:].any(axis=1)]}
