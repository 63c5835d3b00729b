"""Survey of a session before any fit: counts, signal to noise, and what to expect."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.arrays import known_median
from palpate.bem import LARGEST_DENSE, memory_needed
from palpate.geometry import triangle_distances, unit_normals
from palpate.pipeline.model.compliant_supports import compliant_supports
from palpate.records import DisplacementField, Probing, Session, observed_rows

# Within this many contact radii a push shows as an indentation, farther away only as bending.
NEAR_RADII = 8.0
_MIN_NEAR_POINTS = 20
_CLEAR_SIGNAL = 3.0
# Meshes with more vertices than the first get a note; the second is the number it suggests.
_LARGE, _USUAL = 3000, 2000
# Number of vertices that a fit of a few probings takes a minute for on two cores: dense matrices
# grow with its square, the compressed operator in proportion (docs/theory/compressed_operator.md).
_DENSE_MINUTE, _COMPRESSED_MINUTE = 2500, 1100


@dataclass(frozen=True, slots=True)
class FieldSurvey:
    """Counts and medians of a displacement field.

    Attributes
    ----------
    observed, missing : int             points with and without a measured displacement
    median_displacement : float [m]     of |u| over the measured points; NaN: none
    median_sigma : float [m]            of the standard deviations of all components; NaN: none
    """

    observed: int
    missing: int
    median_displacement: float
    median_sigma: float


@dataclass(frozen=True, slots=True)
class ProbingSurvey:
    """Contact, counts and signal of one probing before any fit.

    Attributes
    ----------
    name : str
    patch_triangles : int           triangles that the contact patch touches
    elements_per_radius : float     contact radius over mean edge length in the patch; NaN without a
                                    radius
    observed, missing : int
    median_displacement : float [m] of |u| over the measured points; NaN: none
    signal_to_noise : float         median |u| / sigma of a component; NaN where no sigma is given
    tangential_signal : float       the same for the part of u along the surface
    near : int                      measured points within eight contact radii; without a radius,
                                    within eight edge lengths
    """

    name: str
    patch_triangles: int
    elements_per_radius: float
    observed: int
    missing: int
    median_displacement: float
    signal_to_noise: float
    tangential_signal: float
    near: int


def survey_field(field: DisplacementField) -> FieldSurvey:
    """Counts and medians of a displacement field.

    Parameters
    ----------
    field : DisplacementField

    Returns
    -------
    FieldSurvey
    """
    measured = observed_rows(field)
    length = np.linalg.norm(field.displacement[measured], axis=1)
    sigma = np.zeros(0) if field.std is None else field.std[measured]
    return FieldSurvey(
        int(measured.sum()),
        int((~measured).sum()),
        known_median(length),
        known_median(sigma.ravel()),
    )


def survey_probing(session: Session, probing: Probing) -> ProbingSurvey:
    """Contact, counts and signal of one probing.

    Parameters
    ----------
    session : Session
    probing : Probing               of that session; without a displacement field counts are zero

    Returns
    -------
    ProbingSurvey
    """
    mesh, contact, field = session.mesh, probing.contact, probing.displacement
    distance = triangle_distances(mesh, contact.point)
    patch = contact.triangles
    if patch is None:
        patch = np.flatnonzero(distance < (contact.radius or np.nextafter(distance.min(), np.inf)))
    corner = mesh.vertices[mesh.triangles[patch]]
    edge = float(np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).mean())
    elements = contact.radius / edge if contact.radius else np.nan
    if field is None:
        return ProbingSurvey(probing.name, len(patch), elements, 0, 0, np.nan, np.nan, np.nan, 0)
    counts, measured = survey_field(field), observed_rows(field)
    displacement = field.displacement[measured]
    normal = unit_normals(mesh)[field.surface.triangle[measured]]
    tangential = displacement - np.einsum("na,na->n", displacement, normal)[:, None] * normal
    sigma = np.nan if field.std is None else field.std[measured].mean(axis=1)
    distance = np.linalg.norm(field.points[measured] - contact.point, axis=1)
    return ProbingSurvey(
        name=probing.name,
        patch_triangles=len(patch),
        elements_per_radius=elements,
        observed=counts.observed,
        missing=counts.missing,
        median_displacement=counts.median_displacement,
        signal_to_noise=known_median(np.linalg.norm(displacement, axis=1) / sigma),
        tangential_signal=known_median(np.linalg.norm(tangential, axis=1) / sigma),
        near=int((distance < NEAR_RADII * (contact.radius or edge)).sum()),
    )


def size_notes(session: Session) -> list[str]:
    """Note on the time and memory that a fit of a large mesh needs, and on a faster alternative.

    Parameters
    ----------
    session : Session

    Returns
    -------
    list of str                     empty for a mesh of usual size, and where nothing is fitted
    """
    count = len(session.mesh.vertices)
    if count <= _LARGE or not session.probings:
        return []
    rollers = any(support.directions is not None for support in session.supports)
    compliant = bool(compliant_supports(session))
    memory = memory_needed(count, len(session.probings), rollers=rollers, dense=compliant)
    minutes = count / _COMPRESSED_MINUTE
    if count <= LARGEST_DENSE or rollers or compliant:
        minutes = (count / _DENSE_MINUTE) ** 2
    text = (
        f"The mesh has {count} vertices: a fit will take about {minutes:.0f} minutes and"
        f" {memory / 1e9:.2g} GB of memory. With {_USUAL} (palpate mesh --vertices {_USUAL}) it is"
        " a matter of a minute, and fine enough for most objects."
    )
    return [text]


def session_outlook(session: Session, surveys: Sequence[ProbingSurvey]) -> str:
    """What to expect of the data, or how displacements are still to be measured, in words.

    A guess from counts, not a computation.

    Parameters
    ----------
    session : Session
    surveys : sequence of ProbingSurvey     of all its probings; none where there are steps

    Returns
    -------
    str                             sentences
    """
    if session.steps:
        return (
            f"{len(session.steps)} steps of a rigid motion: `palpate flow` measures them; they hold"
            " no force, so nothing about stiffness."
        )
    unread = [p.name for p in session.probings if p.displacement is None and p.images is not None]
    if len(unread) == len(surveys):
        return (
            f"{len(unread)} probings have pictures and no displacements yet: `palpate flow` shows"
            " what can be read from them, `palpate fit` reads them itself."
        )
    sentences = [_expectation(sum(survey.near for survey in surveys))]
    weak = [s.name for s in surveys if s.signal_to_noise < _CLEAR_SIGNAL]
    if weak:
        names = ", ".join(weak[:5]) + (", ..." if len(weak) > 5 else "")
        sentences.append(
            f"Half the vectors or more are below {_CLEAR_SIGNAL:g} sigma in {len(weak)} of"
            f" {len(surveys)} probings ({names}): expect wide intervals from these alone."
        )
    if not any(np.isfinite(survey.signal_to_noise) for survey in surveys):
        sentences.append("No standard deviations are given; the noise will be estimated.")
    coarse = [survey.name for survey in surveys if survey.elements_per_radius < 1.0]
    if coarse:
        sentences.append(
            f"The contact is smaller than an element in {len(coarse)} probings: displacements next"
            " to it will be inaccurate; refine the mesh there or leave near points out."
        )
    return " ".join([*sentences, "This is a guess by counting: `palpate fit` decides."])


def _expectation(near: int) -> str:
    """What to expect from the number of measured points near the contacts."""
    if near < _MIN_NEAR_POINTS:
        return (
            f"Only {near} measured points lie within {NEAR_RADII:g} contact radii of a contact:"
            " such data show bending and stretching, which determine Young's modulus and say next"
            " to nothing about Poisson's ratio."
        )
    return (
        f"{near} measured vectors lie within {NEAR_RADII:g} contact radii of a contact: stiffness"
        " should be identifiable, and so should Poisson's ratio if the vectors' parts along the"
        " surface stand out of the noise."
    )
