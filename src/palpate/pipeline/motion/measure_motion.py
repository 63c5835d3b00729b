"""Motion of the object's surface from a session's pictures, one motion at a time."""

import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.parts import Parts, content_digest
from palpate.pipeline.motion.notes import order_notes, texture_notes, typical_motion
from palpate.pipeline.object_pose import PoseChoice, posed_rig
from palpate.progress import Progress, silent
from palpate.records import (
    Images,
    Rig,
    Session,
    file_sums,
    read_rig,
    session_files,
)
from palpate.vision import (
    FlowMethod,
    JointFlow,
    LangPaiFlow,
    Pictures,
    RangeFlow,
    VertexDisplacement,
    read_pictures,
)

# A new method is one file in vision and one line here; its name is what users ask for.
FLOW_METHODS: Mapping[str, Callable[..., FlowMethod]] = {
    "joint": JointFlow,
    "lang-pai": LangPaiFlow,
}


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


def measured_motions(
    session: Session,
    *,
    method: FlowMethod = JointFlow(),
    pose: PoseChoice = "auto",
    progress: Progress = silent,
    parts: Path | None = None,
) -> Iterator[tuple[Rig, MeasuredMotion, tuple[str, ...]]]:
    """Measure the motions of a session one by one; those already yielded are not kept.

    Parameters
    ----------
    session : Session               with steps, or with probings of which some have images
    method : FlowMethod             with its settings; see `FLOW_METHODS`
    pose : "auto", "given" or "register"    how the object's pose is determined: "given" is that of
                                    the rig, "auto" registers only where the pictures contradict it
    progress : callable             called with the current step (text) and the fraction done
    parts : Path or None            folder, made if missing, for finished instants, so that an
                                    interrupted run can be resumed

    Yields
    ------
    rig : Rig                       with the pose that was used, the same for all motions
    motion : MeasuredMotion         in the order of `motion_names`; an instant whose pictures cannot
                                    be read is a failure
    notes : tuple of str            all so far, on conversions, registration and what looks wrong

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
    done, total = 0, sum(len(later) for _, _, later in sequences)
    notes: dict[str, None] = {}
    texture: tuple[str, ...] = ()
    order: tuple[str, ...] = ()
    starts: dict[str, _Start] = {}
    uses = Counter(first.pattern for _, first, _ in sequences)
    for probing, first, later in sequences:
        if first.pattern not in starts:
            progress(f"{first.whose}: first pictures and pose", done / total)
            starts[first.pattern], remarks = _started(session, rig, first, method, pose)
            rig = starts[first.pattern][0] if first is sequences[0][1] else rig
            notes |= dict.fromkeys(remarks)
        start = starts[first.pattern]
        uses[first.pattern] -= 1
        if uses[first.pattern] == 0:
            # It holds pictures, and every probing may have its own.
            del starts[first.pattern]
        sizes: dict[str, float] = {}
        for motion, remarks in _followed(session, probing, later, start, method, store):
            done += 1
            notes |= dict.fromkeys(remarks)
            if motion.flow is not None:
                texture = texture or texture_notes(motion.name, motion.flow)
            if motion.flow is not None and probing is not None:
                sizes[motion.name] = typical_motion(motion.flow)
                order += order_notes(probing, sizes) if motion.last else ()
            progress(f"{motion.name}, {done} of {total} instants", done / total)
            yield rig, motion, tuple(dict.fromkeys(chain(notes, texture, order)))


def measure_motion(
    session: Session,
    *,
    method: FlowMethod = JointFlow(),
    pose: PoseChoice = "auto",
    progress: Progress = silent,
    parts: Path | None = None,
) -> SessionFlow:
    """Measure how the object's surface moves in the pictures of a session; keep all motions.

    Parameters
    ----------
    session, method, pose, progress, parts      as in `measured_motions`

    Returns
    -------
    SessionFlow                     an instant whose pictures cannot be read is kept as a failure

    Raises
    ------
    InputError                      no images, no rig
    RecordError, CalibrationError   the first pictures or the rig cannot be used
    """
    found = measured_motions(session, method=method, pose=pose, progress=progress, parts=parts)
    rigs, motions, notes = zip(*found, strict=True)
    return SessionFlow(rigs[-1], motions, notes[-1])


def motion_names(session: Session) -> list[str]:
    """Names of the motions of a session, in the order in which they are measured.

    Parameters
    ----------
    session : Session               with steps, or with probings of which some have images

    Returns
    -------
    list of str                     of every step but the first, or of every loaded image

    Raises
    ------
    InputError                      no images
    """
    return [instant.name for _, _, later in _sequences(session) for instant in later]


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


def _started(
    session: Session, rig: Rig, first: _Instant, method: FlowMethod, pose: PoseChoice
) -> tuple[_Start, tuple[str, ...]]:
    """Start of the sequences with these first pictures, and notes on pictures and pose."""
    pictures = _read(session, rig, first)
    posed, remarks = posed_rig(rig, pictures.grey, session.mesh, pose)
    state = method.start(posed, pictures.grey, session.mesh)
    return (posed, pictures.grey[posed.reference], state), pictures.notes + remarks


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
    """Digest of everything that all instants depend on: method, pose, mesh, rig, pictures, and what
    the session file says of these; forces, contacts and supports may change."""
    folder = session.path.parent
    files = [file for file in session_files(session.path) if file != session.path]
    try:
        sums = file_sums(files, start=folder)
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read ({error.strerror})") from error
    rig = None if session.rig is None else os.path.relpath(session.rig, folder)
    pictures = [(probing.name, probing.images) for probing in session.probings]
    return content_digest((sums, session.mesh, rig, pictures, session.steps, method, pose))


def _read(session: Session, rig: Rig, instant: _Instant) -> Pictures:
    folder = session.path.parent
    return read_pictures(rig, instant.pattern, folder=folder, what=instant.whose)
