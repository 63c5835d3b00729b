"""Plausibility of a session and its probings: notes on probable mistakes in sizes, units and signs,
and refusal of impossible errors.
"""

import numpy as np

from palpate.errors import InputError, quoted
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    place_text,
    triangle_areas,
    triangle_distances,
    unit_normals,
    wall_thickness,
)
from palpate.records.error_priors import ErrorPriors
from palpate.records.estimate import BIASED
from palpate.records.load_checks import (
    UNIT_HINT,
    held_points,
    largest_displacement,
    modulus_range,
    pascals,
)
from palpate.records.probing import (
    LARGE_ROTATION,
    Probing,
    lengths,
    observed_rows,
    rigid_rotation_angle,
)
from palpate.records.session import Session
from palpate.records.support import FIXED
from palpate.shapes import Vector3

# Edge over wall thickness beyond which bending is modelled too stiff: by 3 % at 1.7, 20 % at 2.8.
_COARSE_EDGE = 1.7
# Least fraction of the surface on thin walls; smaller thin parts hardly affect bending.
_MIN_THIN_FRACTION = 0.02
# Range of objects that can be probed on a bench [m]; outside it the unit is probably wrong.
_SMALLEST_OBJECT, _LARGEST_OBJECT = 1e-3, 5.0
_EARTH_GRAVITY = 9.81
# Least plausible density [kg/m^3]; foams have 10 to 100.
_SMALLEST_DENSITY = 5.0
# Settlement into a support, over the largest measured displacement, that would have been noticed.
_MAX_SETTLEMENT = 2.0
# Least plausible fraction of the surface that is held; with less the selector probably missed.
_SMALLEST_SUPPORT = 2e-3
# Largest fraction that is held unless an object is embedded; a larger tolerance selects more.
_LARGEST_SUPPORT = 0.6
# A fixed support has slipped if the median displacement of its points, at least so many, exceeds
# this fraction of the median of all points.
_SLIP_FRACTION, _MIN_HELD_POINTS = 0.5, 4
# Range of moduli outside which the unit of the force is doubted [Pa]: brain tissue has 1 kPa, wood
# along its grain 10 GPa.
_USUAL_MODULUS = (1e2, 1e10)
# Largest distance of the contact point from the surface, in contact radii.
_MAX_OFF_SURFACE = 0.5
# Signs are doubted if, within so many contact radii, with at least so many points, this fraction of
# them moves against the force, by so many standard deviations of their mean.
_NEAR_RADII, _MIN_POINTS, _COUNTER_FRACTION = 3.0, 4, 0.9
_COUNTER_SIGMAS = 3.0


def check_error_lengths(session: Session) -> None:
    """Refuse standard deviations of lengths that exceed the size of the body: wrong unit.

    Parameters
    ----------
    session : Session

    Raises
    ------
    InputError                      the text names the error
    """
    size, default = bounding_diagonal(session.mesh), ErrorPriors()
    given = {
        f"point_std of {quoted(name)}": value
        for name, value in session.errors.contact_points.items()
    }
    for probing in session.probings:
        if probing.tip_displacement_std is not None:
            given[f"tip_displacement_std of {quoted(probing.name)}"] = float(
                probing.tip_displacement_std.max()
            )
    for key in ("contact_point", "pose_translation"):
        value = getattr(session.errors, key)
        if value != getattr(default, key):
            given[f"{key.replace('_', ' ')} of [errors]"] = value
    for name, value in given.items():
        if value > size:
            raise InputError(
                f"{name} is {value:.3g} m, one standard deviation, more than the body of"
                f" {size:.3g} m across; {UNIT_HINT}, or give the error with its unit"
            )


def plausibility_notes(session: Session) -> tuple[str, ...]:
    """Notes on sizes and signs that are possible but probably a mistake.

    Parameters
    ----------
    session : Session

    Returns
    -------
    tuple of str                    full sentences
    """
    mesh = session.mesh
    size = bounding_diagonal(mesh)
    notes = _thin_notes(mesh)
    if not _SMALLEST_OBJECT <= size <= _LARGEST_OBJECT:
        notes.append(f"The object is {size:.3g} m across, an implausible size: {UNIT_HINT}.")
    notes += _support_notes(session)
    gravity = session.gravity
    if gravity is not None and abs(np.linalg.norm(gravity) / _EARTH_GRAVITY - 1.0) > 0.01:
        notes.append(
            f"Gravity is {np.linalg.norm(gravity):.3g} m/s^2; the earth's is {_EARTH_GRAVITY}."
        )
    if session.density is not None and session.density < _SMALLEST_DENSITY:
        notes.append(
            f"The density is {session.density:.3g} kg/m^3, lighter than foam: is it in g/cm^3?"
        )
    notes += _slip_notes(session)
    notes += _settlement_notes(session)
    for probing in session.probings:
        notes += [f"Probing {probing.name}: {text}" for text in _probing_notes(mesh, probing, size)]
    return tuple(notes)


def _thin_notes(mesh: TriangleMesh) -> list[str]:
    """A note on walls too thin for the size of their triangles, with the mesh that would do."""
    corner = mesh.vertices[mesh.triangles]
    edge = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).mean(axis=1)
    thickness, area = wall_thickness(mesh), triangle_areas(mesh)
    thin = edge > _COARSE_EDGE * thickness
    if area[thin].sum() < _MIN_THIN_FRACTION * area.sum():
        return []
    k = int(np.where(thin, thickness, np.inf).argmin())
    share = edge[thin] / (_COARSE_EDGE * thickness[thin])
    wanted = len(mesh.vertices) + 0.5 * float((share**2 - 1.0).sum())
    position = place_text(corner[k].mean(axis=0), decimals=0)
    text = (
        f"The object is {1e3 * thickness[k]:.3g} mm thin at {position}, where the edges of its"
        f" triangles are {1e3 * edge[k]:.3g} mm long: stretching in its plane is modelled, bending"
        f" out of it comes out too stiff. If it bends, use about {wanted:.2g} vertices (palpate"
        " mesh)."
    )
    return [text]


def _support_notes(session: Session) -> list[str]:
    """A note on a support that is an implausibly small or large part of the surface."""
    area, held = triangle_areas(session.mesh), session.held_triangles
    fraction = float(area[held].sum() / area.sum())
    text = f"The support is {100.0 * fraction:.3g} % of the surface"
    if session.probings and fraction < _SMALLEST_SUPPORT:
        text += (
            f" ({len(held)} triangles): is it all that is held? Check the selectors in [support]."
        )
        return [text]
    if fraction > _LARGEST_SUPPORT:
        text += ": if the object stands on one side only, check the tolerance of the plane."
        return [text]
    return []


def _slip_notes(session: Session) -> list[str]:
    """Notes on fixed supports whose points moved like the rest."""
    fixed = [
        support.triangles
        for support in session.supports
        if support.motion == FIXED and support.stiffness is None and support.directions is None
    ]
    held = np.concatenate([np.zeros(0, dtype=np.int64), *fixed])
    notes = []
    for probing in session.probings:
        field = probing.displacement
        if field is None:
            continue
        moved, measured = lengths(field.displacement), observed_rows(field)
        motion = float(np.median(moved[measured]))
        on_support = moved[held_points(session.mesh, held, field) & measured]
        if len(on_support) >= _MIN_HELD_POINTS and np.median(on_support) > _SLIP_FRACTION * motion:
            notes.append(
                f"Probing {probing.name}: {len(on_support)} points on the support moved by"
                f" {np.median(on_support):.3g} m (median), all points by {motion:.3g} m: it"
                " slipped, or"
                ' the points are in another frame; see motion = "given" or "free" of [support].'
            )
    return notes


def _settlement_notes(session: Session) -> list[str]:
    """Notes on an only, elastic support, into which the object would sink farther than anything
    moved."""
    notes: list[str] = []
    if len(session.supports) != 1:
        return notes
    (support,) = session.supports
    area = float(triangle_areas(session.mesh)[support.triangles].sum())
    for probing in session.probings:
        force = float(np.linalg.norm(probing.force))
        settlement = force * support.compliance / area
        largest = largest_displacement(probing)
        if settlement > _MAX_SETTLEMENT * largest > 0.0:
            notes.append(
                f"Probing {probing.name}: under its {force:.3g} N the object would sink"
                f" {settlement:.3g} m into support 1, whose stiffness is"
                f" {support.stiffness:.3g} N/m^3; nothing moved farther than {largest:.3g} m: is it"
                " in N/m^3?"
            )
    return notes


def _probing_notes(mesh: TriangleMesh, probing: Probing, size: float) -> list[str]:
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
    direction = probing.force / force
    # Across the force it may be as large as one likes: a gauge of one axis does not see that.
    if probing.force_std is not None and np.linalg.norm(probing.force_std * direction) > force:
        notes.append("force_std exceeds the force itself, along it; check both.")
    if probing.contact.triangles is not None:
        return notes
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
    along = np.nan_to_num(field.displacement[near]) @ direction
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
