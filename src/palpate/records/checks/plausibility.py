"""Plausibility of a session: notes on probable mistakes, and refusal of impossible errors."""

import numpy as np

from palpate.errors import InputError, quoted
from palpate.geometry import TriangleMesh, bounding_diagonal, triangle_areas, wall_thickness
from palpate.records.checks.displacements import held_points
from palpate.records.checks.loads import UNIT_HINT, largest_displacement
from palpate.records.checks.probings import probing_notes
from palpate.records.error_priors import ErrorPriors
from palpate.records.session import Session
from palpate.records.support import FIXED

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
    if (
        session.gravity is not None
        and abs(np.linalg.norm(session.gravity) / _EARTH_GRAVITY - 1.0) > 0.01
    ):
        notes.append(
            f"Gravity is {np.linalg.norm(session.gravity):.3g} m/s^2; the earth's is"
            f" {_EARTH_GRAVITY}."
        )
    if session.density is not None and session.density < _SMALLEST_DENSITY:
        notes.append(
            f"The density is {session.density:.3g} kg/m^3, lighter than foam: is it in g/cm^3?"
        )
    notes += _slip_notes(session)
    notes += _settlement_notes(session)
    for probing in session.probings:
        notes += [f"Probing {probing.name}: {text}" for text in probing_notes(mesh, probing, size)]
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
    place = ", ".join(f"{1e3 * x:.0f}" for x in corner[k].mean(axis=0))
    text = (
        f"The object is {1e3 * thickness[k]:.3g} mm thin at ({place}) mm, where the edges of its"
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
        if probing.displacement is None:
            continue
        moved = np.linalg.norm(probing.displacement.displacement, axis=1)
        motion = float(np.nanmedian(moved))
        on_support = moved[held_points(session.mesh, held, probing.displacement)]
        on_support = on_support[~np.isnan(on_support)]
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
