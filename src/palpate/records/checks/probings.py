"""Plausibility of a single probing: sizes, units and signs."""

import numpy as np

from palpate.geometry import TriangleMesh, triangle_distances, unit_normals
from palpate.records.checks.loads import UNIT_HINT, largest_displacement, modulus_range, pascals
from palpate.records.estimate import BIASED
from palpate.records.large_rotation import LARGE_ROTATION, rigid_rotation_angle
from palpate.records.probing import Probing, observed_rows
from palpate.shapes import Vector3

# Range of moduli outside which the unit of the force is doubted [Pa]: brain tissue has 1 kPa, wood
# along its grain 10 GPa.
_USUAL_MODULUS = (1e2, 1e10)
# Largest distance of the contact point from the surface, in contact radii.
_MAX_OFF_SURFACE = 0.5
# Signs are doubted if, within so many contact radii, with at least so many points, this fraction of
# them moves against the force, by so many standard deviations of their mean.
_NEAR_RADII, _MIN_POINTS, _COUNTER_FRACTION = 3.0, 4, 0.9
_COUNTER_SIGMAS = 3.0


def probing_notes(mesh: TriangleMesh, probing: Probing, size: float) -> list[str]:
    """Notes on implausible sizes and signs of a probing.

    Parameters
    ----------
    mesh : TriangleMesh
    probing : Probing
    size : float [m]                bounding diagonal of the mesh

    Returns
    -------
    list of str                     without the probing's name and without initial capital
    """
    notes = []
    doubt = f"against an object of {size:.3g} m: {UNIT_HINT}."
    radius = probing.contact.radius
    if radius is not None and radius < 1e-3 * size:
        notes.append(f"the contact radius of {radius:.3g} m is implausible {doubt}")
    largest = largest_displacement(probing)
    moved = f"the largest displacement of {largest:.3g} m is implausibly"
    if 0.0 < largest < 1e-5 * size:
        notes.append(f"{moved} small {doubt}")
    elif largest > 0.5 * size:
        notes.append(f"{moved} large {doubt}")
    elif largest > 0.1 * size:
        notes.append(
            f"the largest displacement is {100.0 * largest / size:.0f} % of the object's size,"
            f" outside small deformation; {BIASED}: press less, or fit with --strain finite."
        )
    if probing.displacement is not None:
        measured = observed_rows(probing.displacement)
        angle = rigid_rotation_angle(
            probing.displacement.points[measured], probing.displacement.displacement[measured]
        )
        if angle > LARGE_ROTATION:
            notes.append(
                f"the measured points turned by {np.degrees(angle):.0f} degrees as a whole, outside"
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
    if largest and not _USUAL_MODULUS[0] <= modulus <= _USUAL_MODULUS[1]:
        notes.append(
            f"the force of {force:.3g} N and the largest displacement of {largest:.3g} m mean a"
            f" Young's modulus of about {pascals(modulus)},"
            f" {'softer' if modulus < 1e5 else 'stiffer'} than what is usually probed; is it in N?"
        )
    if probing.force_std is not None and np.linalg.norm(probing.force_std) > force:
        notes.append("force_std exceeds the force itself; check both.")
    if probing.contact.triangles is not None:
        return notes
    direction = probing.force / force
    distance = triangle_distances(mesh, probing.contact.point)
    triangle, gap = int(distance.argmin()), float(distance.min())
    if probing.contact.radius is not None and gap > _MAX_OFF_SURFACE * probing.contact.radius:
        notes.append(
            f"the contact point is {gap:.3g} m off the surface, its radius is"
            f" {probing.contact.radius:.3g} m: the patch is smaller than that, or elsewhere; check"
            " the point."
        )
    notes += _counter_notes(probing, direction)
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


def _counter_notes(probing: Probing, direction: Vector3) -> list[str]:
    """A note if the surface around the contact moved against the force, as no held body does."""
    field, radius = probing.displacement, probing.contact.radius
    if field is None or radius is None:
        return []
    near = observed_rows(field)
    near &= np.linalg.norm(field.points - probing.contact.point, axis=1) < _NEAR_RADII * radius
    along = field.displacement[near] @ direction
    counter = int((along < 0.0).sum())
    if len(along) < _MIN_POINTS or counter < _COUNTER_FRACTION * len(along):
        return []
    if field.std is not None:
        std = float(np.sqrt((field.std[near] ** 2).max(axis=1).mean() / len(along)))
        if abs(float(along.mean())) < _COUNTER_SIGMAS * std:
            return []
    text = (
        f"{counter} of {len(along)} points within {_NEAR_RADII:g} contact radii moved against the"
        " force, as no held body does: check the signs of force and displacement, the order of"
        " their components, and that they belong to one probing."
    )
    return [text]
