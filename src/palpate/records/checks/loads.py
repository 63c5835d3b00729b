"""Checks of a probing's contact and force against the mesh and the displacements."""

import numpy as np

from palpate.errors import InputError
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    enclosed_volume,
    mesh_quality,
    triangle_areas,
    triangle_distances,
    unit_normals,
)
from palpate.records.contacts.contact import Contact
from palpate.records.contacts.pressure import RIGID
from palpate.records.probing import Probing, observed_rows
from palpate.records.quantities import HIGHEST_PRESSURE, MODULUS_RANGE, modulus_unit
from palpate.shapes import Indices

UNIT_HINT = "is the mesh in another unit, e.g. millimetres? Check length_unit in [object]"
# Least Young's modulus of a body that does not collapse under its own weight, per metre of height,
# for the lightest solid (1 kg/m^3) [Pa/m].
_SOFTEST_PER_METRE = 9.81


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
    lengths = [0.0]
    if probing.displacement is not None:
        moved = probing.displacement.displacement[observed_rows(probing.displacement)]
        lengths += [float(np.linalg.norm(moved, axis=1).max(initial=0.0))]
    if probing.tip_displacement is not None:
        lengths.append(float(np.linalg.norm(probing.tip_displacement)))
    return max(lengths)
