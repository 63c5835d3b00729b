"""Motion of the object's surface from a session's pictures, one motion at a time."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.parts import Parts
from palpate.pipeline.motion.notes import (
    MotionNotes,
    SessionNotes,
    order_notes,
    texture_notes,
    typical_motion,
)
from palpate.pipeline.motion.sequences import (
    Instant,
    PictureSequence,
    motion_keys,
    picture_sequences,
    session_rig,
)
from palpate.pipeline.object_pose import PoseChoice, posed_rig
from palpate.progress import Progress, silent
from palpate.records import Rig, Session
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
    notes : MotionNotes             on its pictures and those it starts from
    """

    name: str
    probing: str | None
    last: bool
    first: Float[np.ndarray, "_ _"]
    flow: RangeFlow | None
    vertices: VertexDisplacement | None
    failure: str | None
    notes: MotionNotes = field(default_factory=MotionNotes)


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


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """Start of the sequences with the same first pictures.

    Attributes
    ----------
    rig : Rig                       with the pose that was used
    reference : (rows, columns) float   the reference camera's picture [grey levels]
    state : Any                     of the method
    whose : str                     sequence whose pictures they are, as the notes call it
    notes : tuple of str            on the pictures and the pose
    """

    rig: Rig
    reference: Float[np.ndarray, "_ _"]
    state: Any
    whose: str
    notes: tuple[str, ...]

    def notes_of(self, whose: str) -> tuple[str, ...]:
        """The notes as another sequence with these pictures would have them."""
        place = f"{self.whose}, "
        return tuple(
            f"{whose}, {note.removeprefix(place)}" if note.startswith(place) else note
            for note in self.notes
        )


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
    sequences = picture_sequences(session)
    progress("cameras", 0.0)
    rig = session_rig(session)
    keys = {} if parts is None else motion_keys(session, method, pose)
    done, total = 0, sum(len(sequence.later) for sequence in sequences)
    notes = SessionNotes()
    starts: dict[str, _Start] = {}
    uses = Counter(sequence.first.pattern for sequence in sequences)
    for sequence in sequences:
        first = sequence.first
        if first.pattern not in starts:
            progress(f"{first.whose}: first pictures and pose", done / total)
            starts[first.pattern] = _started(session, rig, first, method, pose)
            rig = starts[first.pattern].rig if sequence is sequences[0] else rig
        start = starts[first.pattern]
        uses[first.pattern] -= 1
        if uses[first.pattern] == 0:
            # It holds pictures, and every probing may have its own.
            del starts[first.pattern]
        store = Parts(parts, keys.get(sequence.probing, ""))
        for motion in _followed(session, sequence, start, method, store):
            done += 1
            notes = notes.extended(first.pattern, motion.notes)
            progress(f"{motion.name}, {done} of {total} instants", done / total)
            yield rig, motion, notes.all


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


def _started(
    session: Session, rig: Rig, first: Instant, method: FlowMethod, pose: PoseChoice
) -> _Start:
    """Start of the sequences with these first pictures."""
    pictures = _read(session, rig, first)
    posed, remarks = posed_rig(rig, pictures.grey, session.mesh, pose)
    state = method.start(posed, pictures.grey, session.mesh)
    reference = pictures.grey[posed.reference]
    return _Start(posed, reference, state, first.whose, pictures.notes + remarks)


def _followed(
    session: Session, sequence: PictureSequence, start: _Start, method: FlowMethod, parts: Parts
) -> Iterator[MeasuredMotion]:
    """Motions of one sequence in temporal order."""
    rig, state, probing = start.rig, start.state, sequence.probing
    initial = {name: getattr(state, name) for name in getattr(state, "__dataclass_fields__", ())}
    notes = MotionNotes(start=start.notes_of(sequence.first.whose))
    sizes: dict[str, float] = {}
    for instant in sequence.later:
        head = instant.name, probing, instant.last, start.reference
        try:
            pictures = _read(session, rig, instant)
        except InputError as error:
            yield MeasuredMotion(*head, None, None, str(error), notes)
            continue
        inputs = initial | {f"picture {c}": grey for c, grey in enumerate(pictures.grey)}
        estimated = instant.last and probing is not None
        follow = partial(_follow, method, state, pictures, rig, session.mesh, estimated)
        state, flow, vertices = parts.load_or_make(f"{probing} {instant.name}", follow, inputs)
        order: tuple[str, ...] = ()
        if probing is not None:
            sizes[instant.name] = typical_motion(flow)
            order = order_notes(probing, sizes) if instant.last else ()
        remarks = replace(
            notes, pictures=pictures.notes, texture=texture_notes(instant.name, flow), order=order
        )
        yield MeasuredMotion(*head, flow, vertices, None, remarks)


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


def _read(session: Session, rig: Rig, instant: Instant) -> Pictures:
    folder = session.path.parent
    return read_pictures(rig, instant.pattern, folder=folder, what=instant.whose)
