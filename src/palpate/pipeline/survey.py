"""Survey of a measurement before any fit: counts, signal to noise, and what to expect; cameras and
pictures; displacements measured by another program."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import blake2b

import cv2
import numpy as np
from jaxtyping import Float

from palpate.arrays import known_median
from palpate.bem import LARGEST_DENSE, memory_needed
from palpate.errors import CalibrationError, PalpateError, RecordError, counted
from palpate.geometry import triangle_distances, unit_normals
from palpate.pipeline.model.supports import compliant_supports
from palpate.pipeline.motion.sequences import posed_rig
from palpate.records import (
    DisplacementField,
    Images,
    MeasuredPoints,
    PictureTracks,
    Probing,
    ProgramPoints,
    Rig,
    Session,
    lengths,
    measured_rows,
    observed_rows,
    read_rig,
)
from palpate.threads import map_in_threads
from palpate.vision import (
    JointFlow,
    Outcome,
    RangeFlow,
    cause_counts,
    is_valid,
    measured_vertices,
    median_test,
    project,
    read_pictures,
    triangulate,
)

# Within this many contact radii a push shows as an indentation, farther away only as bending.
NEAR_RADII = 8.0
# Standard deviation of a Poisson's ratio, of which only 0 to 0.5 is known; and of a modulus, over
# its value, whose interval reaches zero.
_ANY_RATIO, _ANY_MODULUS = 0.5 / np.sqrt(12.0), 0.5
_CLEAR_SIGNAL = 3.0
# Meshes with more vertices than the first get a note; the second is the number it suggests.
_LARGE, _USUAL = 3000, 2000
# Number of vertices that a fit of a few probings takes a minute for on two cores: dense matrices
# grow with its square, the compressed operator in proportion (docs/theory/compressed_operator.md).
_DENSE_MINUTE, _COMPRESSED_MINUTE = 2500, 1100
# Texture is lost with a larger fraction of white pixels, or where 99 % are below this grey level.
MOST_SATURATED = 0.02
DARK_LEVEL = 25.0
# Length scale of a picture's texture [px], the standard deviation of grey levels over that of their
# gradient: finer texture biases matches, coarser texture leaves too little of it in a window.
_FINEST, COARSEST_TEXTURE = 0.8, 5.0
# Noise of a typical camera, 1 sigma [grey levels].
_NOISE = 1.5
# With a larger fraction of points without texture, the paint or the lighting is at fault.
_MAX_PLAIN = 0.1
# A displacement is an outlier if it differs from its neighbours by more than so many times their
# own scatter (see `median_test`); for normal errors, ten standard deviations.
_MAX_DIFFERENCE = 4.0


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
    length = lengths(field.displacement[measured])
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
    displacement = np.nan_to_num(field.displacement[measured])
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


def session_outlook(
    session: Session,
    surveys: Sequence[ProbingSurvey],
    precision: Mapping[str, float] | None = None,
) -> str:
    """What to expect of the data, or how displacements are still to be measured, in words.

    Parameters
    ----------
    session : Session
    surveys : sequence of ProbingSurvey     of all its probings; none where there are steps
    precision : mapping or None     `expected_precision`; None: not computed

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
            f"Pictures without displacements: {counted(len(unread), 'probing')}. `palpate flow`"
            " shows what can be read from them, `palpate fit` reads them itself."
        )
    sentences = [] if precision is None else [_expectation(precision)]
    weak = [s.name for s in surveys if s.signal_to_noise < _CLEAR_SIGNAL]
    if weak:
        names = ", ".join(weak[:5]) + (", ..." if len(weak) > 5 else "")
        sentences.append(
            f"Half the vectors or more are below {_CLEAR_SIGNAL:g} sigma in {len(weak)} of"
            f" {counted(len(surveys), 'probing')} ({names}): expect wide intervals from these"
            " alone."
        )
    if not any(np.isfinite(survey.signal_to_noise) for survey in surveys):
        sentences.append("No standard deviations are given; the noise will be estimated.")
    coarse = [survey.name for survey in surveys if survey.elements_per_radius < 1.0]
    if coarse:
        sentences.append(
            f"The contact is smaller than an element in {counted(len(coarse), 'probing')}:"
            " displacements next to it will be inaccurate; refine the mesh there or leave near"
            " points out."
        )
    return " ".join([*sentences, "`palpate fit` decides."])


@dataclass(frozen=True, slots=True)
class PictureSurvey:
    """Figures of one picture.

    Attributes
    ----------
    size : (columns, rows) [px]
    grey : (float, float)           1st and 99th percentile of the grey levels, 255 is white
    saturated : float [-]           fraction of saturated pixels; NaN if grey levels have no maximum
    digest : bytes                  hash of all grey levels, which noise makes unique
    """

    size: tuple[int, int]
    grey: tuple[float, float]
    saturated: float
    digest: bytes


@dataclass(frozen=True, slots=True)
class CameraSurvey:
    """Figures of a camera and all its pictures.

    Attributes
    ----------
    name : str
    sees : float [-]                fraction of the mesh's vertices that project into the picture;
                                    NaN where its size is not known
    pictures : tuple of PictureSurvey
    """

    name: str
    sees: float
    pictures: tuple[PictureSurvey, ...]


@dataclass(frozen=True, slots=True)
class ViewSurvey:
    """What can be tracked in a session's first pictures.

    Attributes
    ----------
    points : int                    windows of the reference camera on the surface
    followed : int                  those that can be tracked without motion: with texture, and seen
                                    by a second camera
    vertices : int                  vertices of the mesh that would be measured; a tool hides some
    windows : float                 median number of windows that contribute to such a vertex
    structure : tuple of float [px] length scale of the texture on the surface in each camera's
                                    picture
    """

    points: int
    followed: int
    vertices: int
    windows: float
    structure: tuple[float, ...]


def survey_view(session: Session) -> tuple[ViewSurvey | None, tuple[str, ...]]:
    """Process the first pictures as `measure_motion` would, including the object's pose.

    Parameters
    ----------
    session : Session

    Returns
    -------
    survey : ViewSurvey or None     None without pictures
    notes : tuple of str            what makes them hard to track, and the object's pose

    Raises
    ------
    RecordError, CalibrationError   a rig or picture that cannot be read
    InputError                      an unknown unit of length in the rig
    """
    instants = _instants(session)
    if session.rig is None or not instants:
        return None, ()
    pattern, whose = next(iter(instants.items()))
    given = read_rig(session.rig)
    grey = read_pictures(given, pattern, folder=session.path.parent, what=whose).grey
    try:
        rig, remarks = posed_rig(given, grey, session.mesh, "auto")
    except PalpateError as error:
        # The pictures themselves may be the cause, so the survey goes on.
        rig, remarks = given, (f"The rig cannot be checked against the pictures: {error}.",)
    method = JointFlow()
    state = method.start(rig, grey, session.mesh)
    # Match to the same picture with new noise: windows lost here cannot be tracked later, either.
    rng = np.random.default_rng(0)
    noisy = [levels + rng.normal(0.0, _NOISE, levels.shape).astype(np.float32) for levels in grey]
    flow = method.follow(state, noisy)[1]
    vertices = method.vertices(flow, rig, session.mesh)
    measured = measured_vertices(vertices)
    survey = ViewSurvey(
        points=len(flow.point),
        followed=int(is_valid(flow).sum()),
        vertices=int(measured.sum()),
        windows=float(np.median(vertices.count[measured])) if measured.any() else 0.0,
        structure=tuple(map(texture_length, grey, state.scene.interior)),
    )
    names = [camera.name for camera in rig.cameras]
    return survey, (*remarks, *_view_notes(survey, flow, names, whose))


def survey_cameras(session: Session) -> tuple[tuple[CameraSurvey, ...], tuple[str, ...]]:
    """Read the rig and every picture of a session, as `measure_motion` would.

    Parameters
    ----------
    session : Session

    Returns
    -------
    surveys : tuple of CameraSurvey     empty where the session names no rig
    notes : tuple of str                conversions, and what makes the pictures hard to track

    Raises
    ------
    RecordError                     a rig or picture that cannot be read; identical pictures that
                                    cannot be of the same camera and instant
    CalibrationError                an inconsistent rig, a picture of the wrong size
    InputError                      an unknown unit of length in the rig
    """
    if session.rig is None:
        return (), ()
    rig = read_rig(session.rig)
    instants = _instants(session)
    survey = partial(_survey_instant, session, rig)
    surveyed = list(map_in_threads(survey, instants, instants.values()))
    pictures = [instant for instant, _ in surveyed]
    remarks = [text for _, notes in surveyed for text in notes]
    _check_copies(session, rig, instants, pictures)
    surveys = tuple(
        CameraSurvey(
            camera.name,
            _visible_fraction(session, rig, k),
            tuple(instant[k] for instant in pictures),
        )
        for k, camera in enumerate(rig.cameras)
    )
    camera_notes = [
        f"Camera {survey.name}: {text}" for survey in surveys for text in _picture_notes(survey)
    ]
    return surveys, tuple(dict.fromkeys([*remarks, *camera_notes]))


def without_contradicted(measured: MeasuredPoints) -> MeasuredPoints:
    """The points without those whose displacements contradict their neighbours.

    Parameters
    ----------
    measured : MeasuredPoints

    Returns
    -------
    MeasuredPoints                  outliers are rows of NaN, and counted
    """
    valid = measured_rows(measured.displacement)
    ratio = median_test(measured.points, np.nan_to_num(measured.displacement), valid)
    return measured.without(ratio > _MAX_DIFFERENCE)


def triangulated(tracks: PictureTracks, rig: Rig) -> ProgramPoints:
    """Triangulate matches in pictures.

    Parameters
    ----------
    tracks : PictureTracks
    rig : Rig                       with the cameras of the tracks, by name; or the same number

    Returns
    -------
    ProgramPoints                   in metres, in the frame of the rig

    Raises
    ------
    CalibrationError                the rig has neither those cameras nor the same number
    """
    names = [camera.name for camera in rig.cameras]
    if set(tracks.cameras) <= set(names) and len(tracks.cameras) == len(tracks.rest):
        chosen = [names.index(name) for name in tracks.cameras]
    elif len(names) == len(tracks.rest):
        chosen = list(range(len(names)))
    else:
        raise CalibrationError(
            f"{rig.source}: has the cameras {', '.join(names)}; must have the {len(tracks.rest)} of"
            f" the matches ({', '.join(tracks.cameras) or 'of any name'})"
        )
    pair = Rig(tuple(rig.cameras[i] for i in chosen), 0, rig.source)
    # Equal pixel noise for all matches; its size does not affect the points.
    rest, loaded = (triangulate(pair, pixels, 1.0).point for pixels in (tracks.rest, tracks.loaded))
    return ProgramPoints(rest, loaded - rest, unit="m", notes=tracks.notes, score=tracks.score)


def _expectation(precision: Mapping[str, float]) -> str:
    """What to expect of the constants at best."""
    young, ratio = precision["young_modulus"], precision["poisson_ratio"]
    stiffness = (
        f"Young's modulus to about {100 * young:.2g} %" if young < _ANY_MODULUS
        else "next to nothing about Young's modulus"
    )  # fmt: skip
    other = (
        f"Poisson's ratio to about {ratio:.1g}" if ratio < _ANY_RATIO
        else "next to nothing about Poisson's ratio"
    )  # fmt: skip
    return f"These data tell (1 sigma, Cramer-Rao bound on this mesh) {stiffness}, {other}."


def texture_length(
    grey: Float[np.ndarray, "rows columns"], inner: Float[np.ndarray, "rows columns"]
) -> float:
    """How fine a texture is: the standard deviation of its grey levels over that of their gradient.

    Parameters
    ----------
    grey : (rows, columns) float    grey levels, 0 to 255
    inner : (rows, columns) float   weights, above 0 where the surface is in the picture

    Returns
    -------
    float [px]                      NaN where the surface is not in the picture
    """
    shown = inner > 0.0
    if not shown.any():
        return np.nan
    levels = np.asarray(grey, dtype=np.float64)
    slope = np.stack(list(np.gradient(levels)))[:, shown]
    # Subtract the local mean over the surface alone: shading and background are no texture.
    share, local = (
        cv2.GaussianBlur(x, (0, 0), JointFlow().subset) for x in (inner, levels * inner)
    )
    off = levels[shown] - local[shown] / share[shown]
    return float(np.sqrt(np.mean(off**2) / max(float(np.mean(slope**2)), 1e-12)))


def _view_notes(survey: ViewSurvey, flow: RangeFlow, names: list[str], whose: str) -> list[str]:
    """Defects of the first pictures, and what to do about them."""
    texts = []
    if survey.vertices == 0:
        causes = ", ".join(f"{count} {cause}" for cause, count in cause_counts(flow).items())
        texts.append(
            f"No vertex could be measured in the pictures of {whose} ({survey.points} windows:"
            f" {causes or 'none on the surface'})."
        )
    plain = int((flow.outcome == Outcome.TEXTURE).sum())
    if plain > _MAX_PLAIN * max(survey.points, 1):
        texts.append(
            f"{100 * plain / survey.points:.0f} % of the windows have too little texture to be"
            " followed: speckle the surface, or light it better."
        )
    for name, length in zip(names, survey.structure, strict=True):
        if length > COARSEST_TEXTURE:
            texts.append(
                f"Camera {name}: structure of {length:.1f} px is coarse or out of focus; a sharp"
                " speckle of 3 to 5 px across has 1 to 3."
            )
        elif length < _FINEST:
            texts.append(
                f"Camera {name}: structure of {length:.1f} px is finer than the pixels show:"
                " motions come out too long by some per cent; paint a coarser speckle."
            )
    return texts


def _instants(session: Session) -> dict[str, str]:
    """Every file pattern of pictures, with the step or probing that it belongs to."""
    whose = {step.images: f"step '{step.name}'" for step in session.steps}
    for probing in session.probings:
        images = probing.images or Images("", ())
        for pattern in filter(None, (images.rest, *images.loaded)):
            whose.setdefault(pattern, f"probing '{probing.name}'")
    return whose


def _survey_instant(
    session: Session, rig: Rig, pattern: str, whose: str
) -> tuple[list[PictureSurvey], tuple[str, ...]]:
    """Figures of all cameras' pictures at one instant, and notes about them."""
    read = read_pictures(rig, pattern, folder=session.path.parent, what=whose)
    pictures = []
    for grey, saturated in zip(read.grey, read.saturated, strict=True):
        low, high = np.percentile(grey[::4, ::4], (1.0, 99.0))
        digest = blake2b(grey.tobytes(), digest_size=16).digest()
        size = grey.shape[1], grey.shape[0]
        pictures.append(PictureSurvey(size, (float(low), float(high)), saturated, digest))
    return pictures, read.notes


def _check_copies(
    session: Session, rig: Rig, instants: dict[str, str], pictures: list[list[PictureSurvey]]
) -> None:
    """Refuse identical pictures, unless both show the object at rest from the same camera."""
    at_rest = {probing.images.rest for probing in session.probings if probing.images}
    first: dict[bytes, tuple[str, str]] = {}
    for (pattern, whose), cameras in zip(instants.items(), pictures, strict=True):
        for camera, picture in zip(rig.cameras, cameras, strict=True):
            file = pattern.replace("{camera}", camera.name)
            twin, name = first.setdefault(picture.digest, (pattern, camera.name))
            if twin == pattern and name == camera.name:
                continue
            if name != camera.name or not {twin, pattern} <= at_rest:
                raise RecordError(
                    f"{session.path}: {whose}: '{file}' and '{twin.replace('{camera}', name)}' are"
                    " the same picture, pixel by pixel; noise makes any two differ: was a file"
                    " copied under a wrong name?"
                )


def _visible_fraction(session: Session, rig: Rig, k: int) -> float:
    """Fraction of the mesh's vertices in a camera's picture; NaN where its size is not known."""
    camera = rig.cameras[k]
    if camera.size is None:
        return np.nan
    pixel = project(camera, session.mesh.vertices)
    return float(((pixel >= 0) & (pixel < camera.size)).all(axis=1).mean())


def _picture_notes(survey: CameraSurvey) -> list[str]:
    """What makes a camera's pictures hard to track."""
    texts = []
    if survey.sees == 0.0:
        texts.append(
            "no vertex of the mesh lies inside its picture, as the rig stands; check R, t and"
            " length_unit of the rig, and that the mesh is in the object's frame."
        )
    white = max((picture.saturated for picture in survey.pictures), default=0.0)
    if white > MOST_SATURATED:
        texts.append(
            f"up to {100 * white:.0f} % of the pixels are white, where no texture can be followed;"
            " take the pictures again with less light or a shorter exposure."
        )
    dark = sum(picture.grey[1] < DARK_LEVEL for picture in survey.pictures)
    if dark:
        texts.append(
            f"{dark} of {len(survey.pictures)} pictures are dark (99 % of the pixels below"
            f" {DARK_LEVEL:g} of 255); take them again with more light or a longer exposure."
        )
    return texts
