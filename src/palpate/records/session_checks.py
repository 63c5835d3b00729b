"""What a session must satisfy beyond its syntax, and what looks implausible about it."""

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
    wall_thickness,
)
from palpate.records.contact import RIGID, Contact
from palpate.records.large_turn import LARGE_TURN, whole_turn
from palpate.records.probing import DisplacementField, Probing, observed_rows
from palpate.records.quantities import modulus_unit
from palpate.records.session import Session
from palpate.shapes import Indices

# Edge over thickness from which a wall bends too little: by at most 3 % at 1.7, by 20 % at 2.8.
_COARSE_EDGE = 1.7
# Of the surface; smaller thin parts do not decide how a body bends.
_THIN_SHARE = 0.02
# Objects that one can probe on a bench; beyond them the unit is more likely wrong than the object.
_SMALLEST_OBJECT, _LARGEST_OBJECT = 1e-3, 5.0
_UNIT_HINT = "is the mesh in another unit, e.g. millimetres? Check length_unit in [object]"
# Young's moduli: of diamond; and of a body of 1 kg/m^3, the lightest solid, that is as high as its
# own weight lets it be. No gel is softer than a pascal.
_STIFFEST, _SOFTEST, _SOFTEST_PER_METRE = 1.2e12, 1.0, 9.81
# Beyond these a force in another unit is more likely: brain tissue has 1 kPa, wood along its grain
# 10 GPa.
_DOUBTED_MODULUS = (1e2, 1e10)
# The strongest steels yield here [Pa].
_STRONGEST = 3e9
_EARTH = 9.81
# Foams have 10 to 100 kg/m^3.
_LIGHTEST = 5.0
# Over the largest measured displacement: an object that sinks farther was to be seen to sink.
_SINKS = 2.0
# Of the surface: a smaller support is more likely one that was missed.
_SMALLEST_SUPPORT = 2e-3


def check_contact(mesh: TriangleMesh, held: Indices, contact: Contact) -> None:
    """Refuse a contact patch that misses the surface, is wider than it, or reaches the support.

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
    """Refuse a field that shows no motion: none at all, or only of a support that does not move.

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
    if not field.displacement[measured].any():
        raise InputError(
            f"the displacement of all {int(measured.sum())} measured points of {field.source} is"
            " exactly zero: nothing moved, which says nothing about stiffness; were the pictures at"
            " rest compared with themselves?"
        )
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


def check_load(mesh: TriangleMesh, probing: Probing) -> None:
    """Refuse a force that no material answers with the displacement that was measured.

    Parameters
    ----------
    mesh : TriangleMesh
    probing : Probing

    Raises
    ------
    InputError                      the text tells the modulus, pressure or motion that it means
    """
    size, force = bounding_diagonal(mesh), float(np.linalg.norm(probing.force))
    moved, radius = _largest_displacement(probing), probing.contact.radius
    if moved > size:
        raise InputError(
            f"the largest displacement is {moved:.3g} m, more than the body of {size:.3g} m across:"
            f" a held body does not move so far; {_UNIT_HINT}, and the unit of the displacements"
        )
    low, high = modulus_range(mesh, force, moved)
    pressure = 0.0 if radius is None else force / (np.pi * radius**2)
    if low > _STIFFEST:
        what = f"a Young's modulus of {_pascals(low)} or more, stiffer than diamond"
    elif high < max(_SOFTEST, _SOFTEST_PER_METRE * size):
        what = f"a Young's modulus of {_pascals(high)} or less, of a body too soft for its weight"
    elif pressure > _STRONGEST:
        what = f"a pressure of {_pascals(pressure)} at the contact, more than any steel bears"
        if moved:
            what += f", and a Young's modulus of about {_pascals(float(np.sqrt(low * high)))}"
    else:
        return
    raise InputError(
        f"a force of {force:.3g} N, with a displacement of {moved:.3g} m at most of a body of"
        f" {size:.3g} m, means {what}; is the force in N? Check length_unit and the contact radius"
    )


def _pascals(value: float) -> str:
    factor, unit = modulus_unit(value)
    return f"{float(f'{value / factor:.2g}'):g} {unit}"


def modulus_range(mesh: TriangleMesh, force: float, moved: float) -> tuple[float, float]:
    """Between which Young's moduli a body lies that a force moves so far, to an order of magnitude.

    A body of thickness t and length L is loaded the stiff way through its thickness, F t / (L^2 u),
    and the soft way by bending, F L^3 / (t^4 u).

    Parameters
    ----------
    mesh : TriangleMesh
    force : float [N]
    moved : float [m]               largest displacement; 0: none was measured

    Returns
    -------
    (float, float) [Pa]             (0, infinity) where nothing moved
    """
    if moved == 0.0:
        return 0.0, np.inf
    length = bounding_diagonal(mesh)
    # Exact for a square rod, two thirds of a cube's side, twice a plate's thickness.
    thickness = 4.0 * enclosed_volume(mesh) / float(triangle_areas(mesh).sum())
    return (
        force * thickness / (length**2 * moved),
        force * length**3 / (thickness**4 * moved),
    )


def check_copies(probings: tuple[Probing, ...]) -> None:
    """Refuse one measurement that stands for two probings: counted twice, it would look surer.

    Parameters
    ----------
    probings : tuple of Probing

    Raises
    ------
    InputError                      two share half of their rows or more; the text names both
    """
    earlier: list[tuple[Probing, set[bytes]]] = []
    for probing in probings:
        if probing.displacement is None:
            continue
        rows = _moved_rows(probing.displacement)
        for twin, others in earlier:
            shared = len(rows & others)
            if 2 * shared >= min(len(rows), len(others)):
                raise InputError(
                    f"{shared} of {len(rows)} points of probing {quoted(probing.name)} have the"
                    f" same displacement, digit by digit, as in probing {quoted(twin.name)};"
                    " noise makes any two measurements differ: name the file that belongs to each,"
                    " or leave one out"
                )
        earlier.append((probing, rows))


def _moved_rows(field: DisplacementField) -> set[bytes]:
    """Place and displacement of the points that were seen to move, one entry each."""
    rows = np.hstack([field.points, field.displacement])[observed_rows(field)]
    return {row.tobytes() for row in rows[rows[:, 3:].any(axis=1)]}


def plausibility_notes(session: Session) -> tuple[str, ...]:
    """Sentences about sizes and signs that are possible but more likely a mistake.

    Parameters
    ----------
    session : Session

    Returns
    -------
    tuple of str                    full sentences
    """
    mesh = session.mesh
    size = bounding_diagonal(mesh)
    notes = []
    notes += _thin_notes(mesh)
    if not _SMALLEST_OBJECT <= size <= _LARGEST_OBJECT:
        notes.append(f"The object is {size:.3g} m across, an implausible size: {_UNIT_HINT}.")
    if session.probings:
        area = triangle_areas(mesh)
        share = float(area[session.held_triangles].sum() / area.sum())
        if share < _SMALLEST_SUPPORT:
            notes.append(
                f"The support is {100.0 * share:.2g} % of the surface"
                f" ({len(session.held_triangles)} triangles): is it all that is held? Check the"
                " selectors in [support]."
            )
    if session.gravity is not None and abs(np.linalg.norm(session.gravity) / _EARTH - 1.0) > 0.01:
        notes.append(
            f"Gravity is {np.linalg.norm(session.gravity):.3g} m/s^2; the earth's is {_EARTH}."
        )
    if session.density is not None and session.density < _LIGHTEST:
        notes.append(
            f"The density is {session.density:.3g} kg/m^3, lighter than foam: is it in g/cm^3?"
        )
    notes += _settlement_notes(session)
    for probing in session.probings:
        notes += [f"Probing {probing.name}: {text}" for text in _probing_notes(mesh, probing, size)]
    return tuple(notes)


def _thin_notes(mesh: TriangleMesh) -> list[str]:
    """Whether walls are thinner than their triangles can follow, and what mesh would do."""
    corner = mesh.vertices[mesh.triangles]
    edge = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).mean(axis=1)
    thickness, area = wall_thickness(mesh), triangle_areas(mesh)
    thin = edge > _COARSE_EDGE * thickness
    if area[thin].sum() < _THIN_SHARE * area.sum():
        return []
    k = int(np.where(thin, thickness, np.inf).argmin())
    share = edge[thin] / (_COARSE_EDGE * thickness[thin])
    wanted = len(mesh.vertices) + 0.5 * float((share**2 - 1.0).sum())
    place = ", ".join(f"{1e3 * x:.0f}" for x in corner[k].mean(axis=0))
    text = (
        f"The object is {1e3 * thickness[k]:.3g} mm thin at ({place}) mm, where the edges of its"
        f" triangles are {1e3 * edge[k]:.3g} mm long: stretching in its plane is modelled, bending"
        f" out of it comes out too stiff. If it bends, use about {wanted:.2g} vertices (palpate"
        " mesh)."
    )
    return [text]


def _settlement_notes(session: Session) -> list[str]:
    """Supports into whose springs the object would sink farther than anything moved."""
    notes = []
    areas = triangle_areas(session.mesh)
    for number, support in enumerate(session.supports, start=1):
        for probing in session.probings:
            force = float(np.linalg.norm(probing.force))
            sunk = force * support.compliance / float(areas[support.triangles].sum())
            largest = _largest_displacement(probing)
            if len(session.supports) == 1 and sunk > _SINKS * largest > 0.0:
                notes.append(
                    f"Probing {probing.name}: under its {force:.3g} N the object would sink"
                    f" {sunk:.3g} m into support {number}, whose stiffness is"
                    f" {support.stiffness:.3g} N/m^3; nothing moved farther than {largest:.3g} m:"
                    " is it in N/m^3?"
                )
    return notes


def _probing_notes(mesh: TriangleMesh, probing: Probing, size: float) -> list[str]:
    notes = []
    doubt = f"against an object of {size:.3g} m: {_UNIT_HINT}."
    radius = probing.contact.radius
    if radius is not None and radius < 1e-3 * size:
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
    if probing.displacement is not None:
        seen = observed_rows(probing.displacement)
        turn = whole_turn(
            probing.displacement.points[seen], probing.displacement.displacement[seen]
        )
        if turn > LARGE_TURN:
            notes.append(
                f"the measured points turned by {np.degrees(turn):.0f} degrees as a whole, outside"
                " small deformation: if the whole object turned, with its support, turn the"
                " measured displacements back first."
            )
    return notes + _force_notes(mesh, probing, largest)


def _force_notes(mesh: TriangleMesh, probing: Probing, largest: float) -> list[str]:
    notes: list[str] = []
    force = float(np.linalg.norm(probing.force))
    if not force:
        return notes
    modulus = float(np.sqrt(np.prod(modulus_range(mesh, force, largest)))) if largest else 0.0
    if largest and not _DOUBTED_MODULUS[0] <= modulus <= _DOUBTED_MODULUS[1]:
        notes.append(
            f"the force of {force:.3g} N and the largest displacement of {largest:.3g} m mean a"
            f" Young's modulus of about {_pascals(modulus)},"
            f" {'softer' if modulus < 1e5 else 'stiffer'} than what is usually probed; is it in N?"
        )
    if probing.force_std is not None and np.linalg.norm(probing.force_std) > force:
        notes.append("force_std exceeds the force itself; check both.")
    if probing.contact.triangles is not None:
        return notes
    direction = probing.force / force
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
