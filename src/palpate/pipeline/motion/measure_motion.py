"""Motion of the object's surface from a session's pictures, one motion at a time, with notes on
what looks wrong in it."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.checkpoints import Checkpoints
from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.pipeline.motion.sequences import (
    Instant,
    PictureSequence,
    PoseChoice,
    motion_keys,
    picture_sequences,
    posed_rig,
    session_rig,
)
from palpate.progress import Progress, silent
from palpate.records import Rig, Session
from palpate.vision import (
    FlowMethod,
    JointFlow,
    LangPaiFlow,
    Outcome,
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
# A few points without texture are at outlines or blots; a larger fraction means a surface without
# speckle.
_MAX_TEXTURELESS = 0.1
# An earlier image with more than this many times the motion of the last one is out of order.
_MAX_EARLIER_MOTION = 1.2


@dataclass(frozen=True, slots=True)
class MotionNotes:
    """Notes on one motion, or on all motions of one probing.

    Attributes
    ----------
    start : tuple of str            on the first pictures and the object's pose in them
    pictures : tuple of str         on the later pictures
    texture : tuple of str          on too little texture
    order : tuple of str            on images that seem to be out of order
    """

    start: tuple[str, ...] = ()
    pictures: tuple[str, ...] = ()
    texture: tuple[str, ...] = ()
    order: tuple[str, ...] = ()

    def mapped(self, change: Callable[[str], str]) -> "MotionNotes":
        """Notes with a function applied to each.

        Parameters
        ----------
        change : callable           takes a note, gives the changed one

        Returns
        -------
        MotionNotes
        """
        every = (self.start, self.pictures, self.texture, self.order)
        return MotionNotes(*(tuple(map(change, notes)) for notes in every))


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
    InputError                      no images, no rig, a window larger than the pictures
    RecordError, CalibrationError   the first pictures or the rig cannot be used
    """
    sequences = picture_sequences(session)
    progress("cameras", 0.0)
    rig = session_rig(session)
    shortest = min(
        (side for camera in rig.cameras for side in camera.size or ()), default=method.subset
    )
    if method.subset > shortest:
        raise InputError(
            f"subset is {method.subset} px; the smallest pictures are {shortest} px high or wide,"
            " and a window must lie within: choose one as wide as a few dots of the texture"
        )
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
        store = Checkpoints(parts, keys.get(sequence.probing, ""))
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
    measured = measured_motions(session, method=method, pose=pose, progress=progress, parts=parts)
    rigs, motions, notes = zip(*measured, strict=True)
    return SessionFlow(rigs[-1], motions, notes[-1])


@dataclass(frozen=True, slots=True)
class SessionNotes:
    """Notes on the motions of a session so far.

    Attributes
    ----------
    pictures : tuple of str         on pictures and the object's pose, each once
    texture : tuple of str          of the first motion with too little
    order : tuple of str            on images that seem to be out of order
    started : frozenset of str      patterns of the first pictures whose notes are among these
    """

    pictures: tuple[str, ...] = ()
    texture: tuple[str, ...] = ()
    order: tuple[str, ...] = ()
    started: frozenset[str] = frozenset()

    @property
    def all(self) -> tuple[str, ...]:
        """All notes, each once."""
        return _each_once(self.pictures, self.texture, self.order)

    def extended(self, first: str, notes: MotionNotes) -> "SessionNotes":
        """Notes with those on one more motion or probing.

        Parameters
        ----------
        first : str                 pattern of the first pictures; notes on these are taken once,
                                    from the first of the probings that share them
        notes : MotionNotes

        Returns
        -------
        SessionNotes
        """
        start = () if first in self.started else notes.start
        return SessionNotes(
            pictures=_each_once(self.pictures, start, notes.pictures),
            texture=self.texture or notes.texture,
            order=_each_once(self.order, notes.order),
            started=self.started | {first},
        )


def joined_notes(notes: Iterable[MotionNotes]) -> MotionNotes:
    """Notes on all motions of one probing.

    Parameters
    ----------
    notes : iterable of MotionNotes     on each motion, in temporal order

    Returns
    -------
    MotionNotes                     each once; of those on texture the first motion's that has any
    """
    every = list(notes)
    return MotionNotes(
        start=_each_once(*(motion_notes.start for motion_notes in every)),
        pictures=_each_once(*(motion_notes.pictures for motion_notes in every)),
        texture=next((motion_notes.texture for motion_notes in every if motion_notes.texture), ()),
        order=_each_once(*(motion_notes.order for motion_notes in every)),
    )


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
        prefix = f"{self.whose}, "
        return tuple(
            f"{whose}, {note.removeprefix(prefix)}" if note.startswith(prefix) else note
            for note in self.notes
        )


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
    session: Session,
    sequence: PictureSequence,
    start: _Start,
    method: FlowMethod,
    checkpoints: Checkpoints,
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
        state, flow, vertices = checkpoints.load_or_make(
            f"{probing} {instant.name}", follow, inputs
        )
        order: tuple[str, ...] = ()
        if probing is not None:
            sizes[instant.name] = _typical_motion(flow)
            order = _order_notes(probing, sizes) if instant.last else ()
        remarks = replace(
            notes, pictures=pictures.notes, texture=_texture_notes(instant.name, flow), order=order
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


def _each_once(*notes: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(chain.from_iterable(notes)))


def _texture_notes(name: str, flow: RangeFlow) -> tuple[str, ...]:
    """A note on where the surface has too little texture to be tracked, and how much it needs.

    Parameters
    ----------
    name : str                      of the motion
    flow : RangeFlow

    Returns
    -------
    tuple of str                    empty if hardly any points lack texture
    """
    poor = flow.outcome == Outcome.TEXTURE
    if len(poor) == 0 or poor.mean() <= _MAX_TEXTURELESS:
        return ()
    column, row = np.median(flow.pixel[poor], axis=0)
    needed = 3.0 * float(np.max(flow.noise))
    note = (
        f"'{name}': {100 * poor.mean():.0f} % of the points have too little texture to be followed"
        f" (around column {column:.0f}, row {row:.0f} of the reference camera); a window of"
        f" {flow.subset} px needs grey levels that vary by {needed:.1f} or more (1 sigma): speckle"
        " the surface, or light it better"
    )
    return (note,)


def _order_notes(probing: str, sizes: Mapping[str, float]) -> tuple[str, ...]:
    """Notes where an earlier image of a probing shows more motion than the last one.

    Parameters
    ----------
    probing : str                   its name
    sizes : mapping of str to float [m]     name of every motion of the probing, the last at full
                                    force, to its `_typical_motion`

    Returns
    -------
    tuple of str
    """
    *earlier, (_, last) = sizes.items()
    return tuple(
        f"probing '{probing}': image '{name}' shows more motion"
        f" ({1e3 * size:.3g} mm) than the last one ({1e3 * last:.3g} mm), which must be"
        " the one at full force; is their order right?"
        for name, size in earlier
        if size > _MAX_EARLIER_MOTION * last
    )


def _typical_motion(flow: RangeFlow) -> float:
    """Root mean square of the displacement over the valid points.

    Parameters
    ----------
    flow : RangeFlow

    Returns
    -------
    float [m]                       0 if no point is valid
    """
    square = np.nansum(flow.displacement**2, axis=1)[np.isfinite(flow.displacement[:, 0])]
    return float(np.sqrt(square.mean())) if len(square) else 0.0
