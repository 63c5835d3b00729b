"""From a session's pictures to the displacement of its object's vertices."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, closest_points
from palpate.parts import Parts, content_digest
from palpate.pipeline.object_pose import PoseChoice, posed_rig
from palpate.progress import Progress, silent
from palpate.records import (
    DisplacementField,
    Images,
    Rig,
    Session,
    file_sums,
    read_rig,
    session_files,
)
from palpate.shapes import Indices
from palpate.vision import (
    FlowMethod,
    JointFlow,
    LangPaiFlow,
    Outcome,
    Pictures,
    RangeFlow,
    VertexDisplacement,
    measured_vertices,
    read_pictures,
)

# A new method is one file in vision and one line here; its name is what users ask for.
FLOW_METHODS: Mapping[str, Callable[..., FlowMethod]] = {
    "joint": JointFlow,
    "lang-pai": LangPaiFlow,
}
# Texture finer than the pixels makes motions of a fraction of a pixel come out too long: with the
# low-pass filter applied, by 0.1 % for speckles with a sigma of 1.7 px, by 0.5 to 1.2 % for 1 to
# 0.6 px (analytic textures).
SCALE_ERROR = 0.007
# A few points without texture are at outlines or blots; a larger fraction means a surface without
# speckle.
_MAX_TEXTURELESS = 0.1
# An earlier image with more than this many times the motion of the last one is out of order.
_MAX_EARLIER_MOTION = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMotion:
    """Motion of the object from rest, or from the first step, to one later instant.

    Attributes
    ----------
    name : str                      of the step or probing; with suffix _k for an earlier image k
    probing : str or None           the probing it belongs to
    last : bool                     whether at full force; True for every step
    first : (rows, columns) float   the reference camera's first picture [grey levels]
    flow : RangeFlow or None        None where the pictures could not be used
    vertices : VertexDisplacement or None
    failure : str or None           why there is no flow
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
    notes : tuple of str            on conversions, registration and what looks wrong
    """

    rig: Rig
    motions: tuple[MeasuredMotion, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Instant:
    """An instant: name, owner of the pictures, their file pattern, whether at full force."""

    name: str
    whose: str
    pattern: str
    last: bool


# Start of sequences with the same first pictures: posed rig, the reference camera's picture, state
# of the method.
_Start = tuple[Rig, Float[np.ndarray, "_ _"], Any]


def measure_motion(
    session: Session,
    *,
    method: FlowMethod = JointFlow(),
    pose: PoseChoice = "auto",
    progress: Progress = silent,
    parts: Path | None = None,
) -> SessionFlow:
    """Measure how the object's surface moves in the pictures of a session.

    Parameters
    ----------
    session : Session               with steps, or with probings of which some have images
    method : FlowMethod             with its settings; see `FLOW_METHODS`
    pose : "auto", "given" or "register"    how the object's pose is determined: "given" is that of
                                    the rig, "auto" registers only where the pictures contradict it
    progress : callable             called with the current step (text) and the fraction done
    parts : Path or None            folder, made if missing, for finished instants, so that an
                                    interrupted run can be resumed

    Returns
    -------
    SessionFlow                     an instant whose pictures cannot be read is kept as a failure

    Raises
    ------
    InputError                      no images, no rig
    RecordError, CalibrationError   the first pictures or the rig cannot be used
    """
    sequences = _sequences(session)
    if session.rig is None:
        raise InputError(f"{session.path}: has images and no [rig] table; name the camera file")
    progress("cameras", 0.0)
    rig = read_rig(session.rig)
    store = Parts(parts, "" if parts is None else motion_key(session, method, pose))
    total = sum(len(later) for _, _, later in sequences)
    motions: list[MeasuredMotion] = []
    notes: list[str] = []
    starts: dict[str, _Start] = {}
    for probing, first, later in sequences:
        if first.pattern not in starts:
            progress(f"{first.whose}: first pictures and pose", len(motions) / total)
            pictures = _read(session, rig, first)
            posed, remarks = posed_rig(rig, pictures.grey, session.mesh, pose)
            state = method.start(posed, pictures.grey, session.mesh)
            starts[first.pattern] = posed, pictures.grey[posed.reference], state
            rig = rig if len(starts) > 1 else posed
            notes += pictures.notes + remarks
        start = starts[first.pattern]
        for motion, remarks in _followed(session, probing, later, start, method, store):
            motions.append(motion)
            notes += remarks
            progress(f"{motion.name}, {len(motions)} of {total} instants", len(motions) / total)
    notes += _texture_notes(motions) + _order_notes(motions)
    return SessionFlow(rig, tuple(motions), tuple(dict.fromkeys(notes)))


def with_pictures_measured(
    session: Session,
    *,
    pose: PoseChoice = "auto",
    progress: Progress = silent,
    parts: Path | None = None,
) -> Session:
    """The session, with displacements measured in the pictures where it has no file of them.

    Parameters
    ----------
    session : Session
    pose, progress, parts           as in `measure_motion`

    Returns
    -------
    Session                         unchanged if nothing is to be measured; else with the notes of
                                    the measurement after its own

    Raises
    ------
    InputError                      a probing whose pictures could not be used or show no motion
    RecordError, CalibrationError   the first pictures or the rig cannot be used
    """
    unread = tuple(p for p in session.probings if p.displacement is None and p.images)
    if not unread:
        return session
    flow = measure_motion(
        replace(session, probings=unread), pose=pose, progress=progress, parts=parts
    )
    return with_measured_displacement(session, flow)


def with_measured_displacement(session: Session, flow: SessionFlow) -> Session:
    """The session, with the displacements that were measured at full force.

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
    by_probing = {motion.probing: motion for motion in flow.motions if motion.last}
    probings = tuple(
        replace(probing, displacement=_displacement_field(session, by_probing[probing.name]))
        if probing.displacement is None and probing.name in by_probing
        else probing
        for probing in session.probings
    )
    return replace(session, probings=probings, notes=session.notes + flow.notes)


def _sequences(session: Session) -> Sequence[tuple[str | None, _Instant, list[_Instant]]]:
    """The sequences to measure: probing, if any, first instant, later ones."""
    if session.steps:
        first, *later = (
            _Instant(step.name, f"step '{step.name}'", step.images, True) for step in session.steps
        )
        return [(None, first, later)]
    sequences = [
        (probing.name, *_instants(probing.name, probing.images))
        for probing in session.probings
        if probing.images is not None
    ]
    if not sequences:
        raise InputError(
            f"{session.path}: none of its probings has images; give `images` and a [rig], or"
            " estimate from its displacement files with `palpate fit`"
        )
    return sequences


def _instants(name: str, images: Images) -> tuple[_Instant, list[_Instant]]:
    """A probing at rest, and its later instants, the last of them at full force."""
    whose, count = f"probing '{name}'", len(images.loaded)
    later = [
        _Instant(name if k == count else f"{name}_{k}", whose, pattern, k == count)
        for k, pattern in enumerate(images.loaded, start=1)
    ]
    return _Instant("rest", whose, images.rest, False), later


def _followed(
    session: Session,
    probing: str | None,
    later: Sequence[_Instant],
    start: _Start,
    method: FlowMethod,
    parts: Parts,
) -> Iterator[tuple[MeasuredMotion, tuple[str, ...]]]:
    """Motions of one sequence in temporal order, with notes on their pictures."""
    rig, reference, state = start
    initial = {name: getattr(state, name) for name in getattr(state, "__dataclass_fields__", ())}
    for instant in later:
        head = instant.name, probing, instant.last, reference
        try:
            pictures = _read(session, rig, instant)
        except InputError as error:
            yield MeasuredMotion(*head, None, None, str(error)), ()
            continue
        inputs = initial | {f"picture {c}": grey for c, grey in enumerate(pictures.grey)}
        estimated = instant.last and probing is not None
        follow = partial(_follow, method, state, pictures, rig, session.mesh, estimated)
        state, flow, vertices = parts.load_or_make(f"{probing} {instant.name}", follow, inputs)
        yield MeasuredMotion(*head, flow, vertices, None), pictures.notes


def _follow(
    method: FlowMethod,
    state: Any,
    pictures: Pictures,
    rig: Rig,
    mesh: TriangleMesh,
    estimated: bool,
) -> tuple[Any, RangeFlow, VertexDisplacement]:
    """Measure one instant: the method's state, the range flow and the vertices' displacement, with
    its window average where constants are estimated from it."""
    after, flow = method.follow(state, pictures.grey)
    moved = method.vertices(flow, rig, mesh)
    return after, flow, method.averaged(moved, flow, rig, mesh) if estimated else moved


def motion_key(session: Session, method: FlowMethod, pose: PoseChoice) -> str:
    """Digest of everything that all instants depend on: the session's files, method and pose."""
    try:
        sums = file_sums(session_files(session.path), start=session.path.parent)
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read ({error.strerror})") from error
    return content_digest((sums, [p.name for p in session.probings], method, pose))


def _read(session: Session, rig: Rig, instant: _Instant) -> Pictures:
    folder = session.path.parent
    return read_pictures(rig, instant.pattern, folder=folder, what=instant.whose)


def vertex_field(
    mesh: TriangleMesh, vertices: VertexDisplacement, rows: Indices, source: str
) -> DisplacementField:
    """Displacement field of some vertices, as if read from a displacement file.

    Parameters
    ----------
    mesh : TriangleMesh
    vertices : VertexDisplacement   of all v vertices of the mesh
    rows : (k,) int                 observed vertices, measured or not
    source : str                    where it comes from, for messages

    Returns
    -------
    DisplacementField               k rows; NaN where nothing was measured
    """
    points = mesh.vertices[rows]
    return DisplacementField(
        points=points,
        displacement=vertices.displacement[rows],
        std=np.sqrt(np.einsum("vaa->va", vertices.covariance[rows])),
        vertex=rows,
        surface=closest_points(mesh, points),
        source=source,
        scale_error=SCALE_ERROR,
        covariance=vertices.covariance[rows],
        correlation=vertices.correlation.subset(rows, len(mesh.vertices)),
        average=None if vertices.average is None else vertices.average.subset(rows),
    )


def _displacement_field(session: Session, motion: MeasuredMotion) -> DisplacementField:
    """Displacement field of one motion, as the estimation takes it."""
    if motion.vertices is None:
        raise InputError(f"probing '{motion.name}': {motion.failure}")
    measured = measured_vertices(motion.vertices)
    if not measured.any():
        raise InputError(
            f"probing '{motion.name}' in {session.path}: no vertex of the mesh could be followed"
            " in its pictures; `palpate flow` shows why, point by point"
        )
    rows = np.flatnonzero((motion.vertices.count > 0) | measured)
    return vertex_field(session.mesh, motion.vertices, rows, f"images of {motion.name}")


def _order_notes(motions: Sequence[MeasuredMotion]) -> tuple[str, ...]:
    """Notes where an earlier image of a probing shows more motion than the last one."""
    full = {
        motion.probing: _typical_motion(motion.flow)
        for motion in motions
        if motion.last and motion.probing is not None and motion.flow is not None
    }
    notes = []
    for motion in motions:
        if motion.last or motion.flow is None or motion.probing not in full:
            continue
        size, last = _typical_motion(motion.flow), full[motion.probing]
        if size > _MAX_EARLIER_MOTION * last:
            notes.append(
                f"probing '{motion.probing}': image '{motion.name}' shows more motion"
                f" ({1e3 * size:.3g} mm) than the last one ({1e3 * last:.3g} mm), which must be"
                " the one at full force; is their order right?"
            )
    return tuple(notes)


def _texture_notes(motions: Sequence[MeasuredMotion]) -> tuple[str, ...]:
    """A note on where the surface has too little texture to be tracked, and how much it needs."""
    for motion in motions:
        if motion.flow is None:
            continue
        poor = motion.flow.outcome == Outcome.TEXTURE
        if len(poor) > 0 and poor.mean() > _MAX_TEXTURELESS:
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
