"""From a session's pictures to the displacement of its object's vertices."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.geometry import closest_points, refined_surface
from palpate.pipeline.object_pose import PoseChoice, posed_rig
from palpate.progress import Progress, silent
from palpate.records import DisplacementField, Probing, Rig, Session, read_rig
from palpate.vision import (
    JointSettings,
    LangPaiSettings,
    Outcome,
    Pictures,
    RangeFlow,
    Scene,
    VertexDisplacement,
    joint_flow,
    lang_pai_flow,
    lang_pai_vertices,
    make_scene,
    read_pictures,
    vertex_displacement,
)

# Motions of a fraction of a pixel are measured too long by structure finer than the pixels. With
# the low-pass that is applied: by 0.1 % where speckles have a sigma of 1.7 px, 0.5 to 1.2 % where
# it is 1 to 0.6 px (analytic textures).
SCALE_ERROR = 0.007
# Points without texture are an outline or a blot; this share of them is a surface without paint.
_MUCH = 0.1
Grey = tuple[Float[np.ndarray, "_ _"], ...]


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """How motion is measured from pictures.

    Parameters
    ----------
    method : "joint" or "lang-pai"  all cameras jointly, to a hundredth of a pixel; or the paper's
                                    whole-pixel correlation with a vote
    pose : "auto", "given" or "register"    whether the rig's pose of the object is believed: "auto"
                                    registers only where the pictures contradict it
    joint : JointSettings
    lang_pai : LangPaiSettings
    """

    method: Literal["joint", "lang-pai"] = "joint"
    pose: PoseChoice = "auto"
    joint: JointSettings = field(default_factory=JointSettings)
    lang_pai: LangPaiSettings = field(default_factory=LangPaiSettings)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMotion:
    """Motion of the object from rest, or from the first step, to one later instant.

    Attributes
    ----------
    name : str                      of the step or probing; an earlier image k of a probing has _k
    probing : str or None           the probing it belongs to
    last : bool                     the instant of the full force; True for every step
    first : (rows, columns) float   the reference camera's first picture [grey levels]
    flow : RangeFlow or None        None where the pictures could not be used
    vertices : VertexDisplacement or None
    failure : str or None           why there is none
    """

    name: str
    probing: str | None
    last: bool
    first: Float[np.ndarray, "_ _"]
    flow: RangeFlow | None
    vertices: VertexDisplacement | None
    failure: str | None


@dataclass(frozen=True, slots=True, eq=False)
class SessionFlow:
    """All motions of a session.

    Attributes
    ----------
    rig : Rig                       with the pose that was used
    motions : tuple of MeasuredMotion
    notes : tuple of str            what was converted, registered or looks wrong, in sentences
    """

    rig: Rig
    motions: tuple[MeasuredMotion, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Instant:
    """A later instant: its name, its file pattern, and whether the force is all there."""

    name: str
    pattern: str
    last: bool


@dataclass(frozen=True, slots=True)
class _Sequence:
    """Pictures in time after one first instant."""

    what: str
    probing: str | None
    first: str
    later: tuple[_Instant, ...]


def measure_motion(
    session: Session,
    *,
    probes: Sequence[str] | None = None,
    settings: MotionSettings = MotionSettings(),
    progress: Progress | None = None,
) -> SessionFlow:
    """Measure how the object's surface moves in the pictures of a session.

    Parameters
    ----------
    session : Session               with steps, or with probings that have images
    probes : sequence of str        probings to measure; all that have images unless told
    settings : MotionSettings
    progress : callable             told what is done (text) and how far it is (0 to 1)

    Returns
    -------
    SessionFlow                     an instant whose pictures cannot be read is kept as a failure

    Raises
    ------
    InputError                      no images, unknown probing
    RecordError, CalibrationError   the first pictures or the rig cannot be used
    """
    say = progress or silent
    sequences = _sequences(session, probes)
    if session.rig is None:
        raise InputError(f"{session.path}: has images and no [rig] table; name the camera file")
    say("cameras", 0.0)
    rig = read_rig(session.rig)
    total = sum(len(sequence.later) for sequence in sequences)
    motions: list[MeasuredMotion] = []
    notes: tuple[str, ...] = ()
    firsts: dict[str, _First] = {}
    for sequence in sequences:
        if sequence.first not in firsts:
            say(f"{sequence.what}: first pictures and pose", len(motions) / total)
            begun = _first_instant(session, rig, sequence, settings)
            rig = begun.rig if not firsts else rig
            firsts[sequence.first] = begun
            notes += begun.notes
        for motion, remarks in _motions(session, sequence, firsts[sequence.first], settings):
            motions.append(motion)
            notes += remarks
            say(f"{motion.name}, {len(motions)} of {total} instants", len(motions) / total)
    notes += _texture_notes(motions) + _order_notes(motions)
    return SessionFlow(rig, tuple(motions), tuple(dict.fromkeys(notes)))


def with_measured_displacement(session: Session, flow: SessionFlow) -> Session:
    """The session with the displacements that were measured at full force.

    Parameters
    ----------
    session : Session
    flow : SessionFlow              of probings of this session

    Returns
    -------
    Session                         probings that have a displacement file keep it

    Raises
    ------
    InputError                      a probing whose pictures could not be used or show no motion
    """
    found = {motion.probing: motion for motion in flow.motions if motion.last}
    probings = []
    for probing in session.probings:
        if probing.displacement is None and probing.name in found:
            measured = _displacement_field(session, found[probing.name])
            probing = replace(probing, displacement=measured)
        probings.append(probing)
    return replace(session, probings=tuple(probings), notes=session.notes + flow.notes)


@dataclass(frozen=True, slots=True, eq=False)
class _First:
    """The first instant of sequences, read and ready."""

    rig: Rig
    grey: Grey
    scene: Scene | None
    notes: tuple[str, ...]


def _sequences(session: Session, probes: Sequence[str] | None) -> list[_Sequence]:
    """What there is to measure."""
    if session.steps:
        later = tuple(_Instant(step.name, step.images, True) for step in session.steps[1:])
        return [_Sequence(f"step '{session.steps[0].name}'", None, session.steps[0].images, later)]
    known = {probing.name: probing for probing in session.probings}
    missing = [name for name in probes or () if name not in known]
    if missing:
        raise InputError(
            f"there is no probing named {', '.join(map(repr, missing))} in {session.path};"
            f" it has {', '.join(known)}"
        )
    chosen = [known[name] for name in dict.fromkeys(probes)] if probes else list(known.values())
    seen = [probing for probing in chosen if probing.images is not None]
    if not seen:
        raise InputError(
            f"{session.path}: none of its probings has images; give `images` and a [rig], or"
            " estimate from its displacement files with `palpate fit`"
        )
    return [_probing_sequence(probing) for probing in seen]


def _probing_sequence(probing: Probing) -> _Sequence:
    images = probing.images
    if images is None:
        raise InputError(f"probing '{probing.name}' has no images")
    count = len(images.loaded)
    later = tuple(
        _Instant(
            probing.name if k == count else f"{probing.name}_{k}", images.loaded[k - 1], k == count
        )
        for k in range(1, count + 1)
    )
    return _Sequence(f"probing '{probing.name}'", probing.name, images.rest, later)


def _first_instant(
    session: Session, rig: Rig, sequence: _Sequence, settings: MotionSettings
) -> _First:
    """Read the first pictures, settle the pose, and choose the points to follow."""
    pictures = _read(session, rig, sequence.first, sequence.what)
    mesh = session.mesh
    posed, notes = posed_rig(rig, pictures.grey, mesh, settings.pose)
    scene = None
    if settings.method == "joint":
        # The smooth surface that the estimate will take the mesh for, not its facets.
        scene = make_scene(posed, pictures.grey, *refined_surface(mesh), settings=settings.joint)
    return _First(posed, pictures.grey, scene, pictures.notes + notes)


def _read(session: Session, rig: Rig, pattern: str, what: str) -> Pictures:
    return read_pictures(rig, pattern, folder=session.path.parent, what=what)


def _motions(
    session: Session, sequence: _Sequence, first: _First, settings: MotionSettings
) -> Iterator[tuple[MeasuredMotion, tuple[str, ...]]]:
    """Motions of one sequence, in time; pictures are read when their turn has come."""
    waiting: list[_Instant] = []
    failures: list[tuple[_Instant, str]] = []
    remarks: list[str] = []

    def readable() -> Iterator[Grey]:
        for instant in sequence.later:
            try:
                what = f"step '{instant.name}'" if sequence.probing is None else sequence.what
                pictures = _read(session, first.rig, instant.pattern, what)
            except InputError as error:
                failures.append((instant, str(error)))
                continue
            remarks.extend(pictures.notes)
            waiting.append(instant)
            yield pictures.grey

    reference = first.grey[first.rig.reference]
    for flow, vertices in _measured(session, first, readable(), settings):
        for instant, failure in failures:
            yield _failed(instant, sequence, reference, failure), ()
        failures.clear()
        instant = waiting.pop(0)
        yield (
            MeasuredMotion(
                instant.name, sequence.probing, instant.last, reference, flow, vertices, None
            ),
            tuple(remarks),
        )
        remarks.clear()
    for instant, failure in failures:
        yield _failed(instant, sequence, reference, failure), ()


def _failed(
    instant: _Instant, sequence: _Sequence, first: Float[np.ndarray, "_ _"], failure: str
) -> MeasuredMotion:
    return MeasuredMotion(instant.name, sequence.probing, instant.last, first, None, None, failure)


def _measured(
    session: Session, first: _First, later: Iterator[Grey], settings: MotionSettings
) -> Iterator[tuple[RangeFlow, VertexDisplacement]]:
    """Range flow and vertex displacement of each later instant by the chosen method."""
    mesh = session.mesh
    if first.scene is not None:
        camera = first.rig.cameras[first.rig.reference]
        for flow in joint_flow(first.scene, later, settings=settings.joint):
            yield flow, vertex_displacement(flow, camera, mesh.vertices, mesh.triangles)
        return
    flows = lang_pai_flow(
        first.rig,
        [first.grey, *later],
        mesh.vertices,
        mesh.triangles,
        settings=settings.lang_pai,
    )
    for flow in flows:
        found = lang_pai_vertices(flow, mesh.vertices, mesh.triangles, settings=settings.lang_pai)
        yield flow, found


def _displacement_field(session: Session, motion: MeasuredMotion) -> DisplacementField:
    """Measured vertices of one motion as the estimate takes them."""
    if motion.vertices is None:
        raise InputError(f"probing '{motion.name}': {motion.failure}")
    found = motion.vertices
    looked = np.flatnonzero((found.count > 0) | np.isfinite(found.displacement).all(axis=1))
    if not np.isfinite(found.displacement).any():
        raise InputError(
            f"probing '{motion.name}' in {session.path}: no vertex of the mesh could be followed"
            " in its pictures; `palpate flow` shows why, point by point"
        )
    points = session.mesh.vertices[looked]
    std = np.sqrt(np.einsum("nii->ni", found.covariance[looked]))
    return DisplacementField(
        points=points,
        displacement=found.displacement[looked],
        std=std,
        vertex=looked,
        surface=closest_points(session.mesh, points),
        source=f"images of {motion.name}",
        scale_error=SCALE_ERROR,
    )


def _order_notes(motions: Sequence[MeasuredMotion]) -> tuple[str, ...]:
    """A remark where an earlier image of a probing shows more motion than the last one."""
    notes = []
    for last in motions:
        if not last.last or last.probing is None or last.flow is None:
            continue
        full = _typical_motion(last.flow)
        for earlier in motions:
            if earlier.probing != last.probing or earlier.last or earlier.flow is None:
                continue
            if _typical_motion(earlier.flow) > 1.2 * full:
                notes.append(
                    f"probing '{last.name}': image '{earlier.name}' shows more motion"
                    f" ({1e3 * _typical_motion(earlier.flow):.3g} mm) than the last one"
                    f" ({1e3 * full:.3g} mm), which must be the one at full force; is their order"
                    " right?"
                )
    return tuple(notes)


def _texture_notes(motions: Sequence[MeasuredMotion]) -> tuple[str, ...]:
    """Where the surface has too little texture to be followed, and how much it needs."""
    for motion in motions:
        if motion.flow is None:
            continue
        poor = motion.flow.outcome == Outcome.TEXTURE
        if len(poor) > 0 and poor.mean() > _MUCH:
            column, row = np.median(motion.flow.pixel[poor], axis=0)
            needed = 3.0 * float(np.max(motion.flow.noise))
            return (
                (
                    f"'{motion.name}': {100 * poor.mean():.0f} % of the points have too little"
                    f" texture to be followed (around column {column:.0f}, row {row:.0f} of the"
                    f" reference camera); a window of {motion.flow.subset} px needs grey levels"
                    f" that vary by {needed:.1f} or more (1 sigma): speckle the surface, or light"
                    " it better"
                ),
            )
    return ()


def _typical_motion(flow: RangeFlow) -> float:
    """Root mean square of the displacement [m]."""
    square = np.nansum(flow.displacement**2, axis=1)[np.isfinite(flow.displacement[:, 0])]
    return float(np.sqrt(square.mean())) if len(square) else 0.0
