"""Measured motions as displacements of a session's probings, which the estimation takes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, closest_points
from palpate.pipeline.motion.measure_motion import MeasuredMotion, SessionFlow, measured_motions
from palpate.pipeline.motion.notes import MotionNotes, SessionNotes, joined_notes
from palpate.pipeline.object_pose import PoseChoice
from palpate.progress import Progress, silent
from palpate.records import DisplacementField, Probing, Session
from palpate.shapes import Indices
from palpate.vision import VertexDisplacement, measured_vertices


@dataclass(frozen=True, slots=True, eq=False)
class ProbingMotion:
    """What the pictures of one probing gave, whatever was measured along with it.

    Attributes
    ----------
    field : DisplacementField       at full force
    notes : MotionNotes             on all its pictures
    """

    field: DisplacementField
    notes: MotionNotes


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
    return with_motions(
        session, measure_pictures(session, pose=pose, progress=progress, parts=parts)
    )


def measure_pictures(
    session: Session,
    *,
    known: Mapping[str, ProbingMotion] = MappingProxyType({}),
    pose: PoseChoice = "auto",
    progress: Progress = silent,
    parts: Path | None = None,
) -> dict[str, ProbingMotion]:
    """Measure the motion in the pictures of the probings that have no file of displacements.

    Parameters
    ----------
    session : Session
    known : mapping of str to ProbingMotion     probings that need not be measured, with their
                                    motions
    pose, progress, parts           as in `measure_motion`

    Returns
    -------
    dict of str to ProbingMotion    of all these probings, in the session's order, known or
                                    measured; each is the same to the last bit whether measured
                                    alone or along with others

    Raises
    ------
    InputError                      a probing whose pictures could not be used or show no motion
    RecordError, CalibrationError   the first pictures or the rig cannot be used
    """
    unread = unread_probings(session)
    wanted = tuple(probing for probing in unread if probing.name not in known)
    found = dict(known)
    if wanted:
        session = replace(session, probings=wanted)
        notes: list[MotionNotes] = []
        for _, motion, _ in measured_motions(session, pose=pose, progress=progress, parts=parts):
            notes.append(motion.notes)
            if motion.last and motion.probing is not None:
                field = _displacement_field(session, motion)
                found[motion.probing] = ProbingMotion(field, joined_notes(notes))
                notes = []
    return {probing.name: found[probing.name] for probing in unread}


def with_motions(session: Session, motions: Mapping[str, ProbingMotion]) -> Session:
    """The session, with the displacements of some probings.

    Parameters
    ----------
    session : Session
    motions : mapping of str to ProbingMotion   by probing

    Returns
    -------
    Session                         with the notes on these after its own; unchanged if there are
                                    none
    """
    if not motions:
        return session
    notes, probings = SessionNotes(), []
    for probing in session.probings:
        if probing.name in motions:
            motion = motions[probing.name]
            first = probing.name if probing.images is None else probing.images.rest
            notes = notes.extended(first, motion.notes)
            probing = replace(probing, displacement=motion.field)
        probings.append(probing)
    return replace(session, probings=tuple(probings), notes=session.notes + notes.all)


def unread_probings(session: Session) -> tuple[Probing, ...]:
    """Probings whose displacements are only in their pictures.

    Parameters
    ----------
    session : Session

    Returns
    -------
    tuple of Probing                those with images and no displacement
    """
    return tuple(p for p in session.probings if p.displacement is None and p.images is not None)


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
