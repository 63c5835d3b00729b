"""Measured motions as displacements of a session's probings, which the estimation takes; and how
they are kept in the result folder for the next fit."""

import io
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from scipy.sparse import bsr_array

from palpate.disk import write_bytes
from palpate.errors import InputError
from palpate.files import stored_arrays
from palpate.geometry import TriangleMesh, closest_points
from palpate.pipeline.motion.measure_motion import (
    MeasuredMotion,
    MotionNotes,
    SessionFlow,
    SessionNotes,
    joined_notes,
    measured_motions,
)
from palpate.pipeline.motion.sequences import PoseChoice, motion_keys
from palpate.progress import Progress, silent
from palpate.records import (
    DisplacementField,
    PointCorrelation,
    Probing,
    Session,
    SurfaceAverage,
    folder_changes,
)
from palpate.shapes import Indices
from palpate.vision import JointFlow, VertexDisplacement, measured_vertices

MOTION_FILE = "motion.npz"
MOTION_FORMAT = "palpate-motion/5"
# Flow method that `palpate fit` uses.
_METHOD = JointFlow()


@dataclass(frozen=True, slots=True, eq=False)
class ProbingMotion:
    """Motion measured from the pictures of one probing; it does not depend on other probings.

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
    missing = tuple(probing for probing in unread if probing.name not in known)
    motions = dict(known)
    if missing:
        session = replace(session, probings=missing)
        notes: list[MotionNotes] = []
        for _, motion, _ in measured_motions(session, pose=pose, progress=progress, parts=parts):
            notes.append(motion.notes)
            if motion.last and motion.probing is not None:
                field = _displacement_field(session, motion)
                motions[motion.probing] = ProbingMotion(field, joined_notes(notes))
                notes = []
    return {probing.name: motions[probing.name] for probing in unread}


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


def keep_motion(
    folder: Path,
    session: Session,
    motions: Mapping[str, ProbingMotion],
    *,
    pose: PoseChoice = "auto",
) -> None:
    """Write what pictures gave, each probing's with a digest of everything that it depends on.

    Parameters
    ----------
    folder : Path                   of the result
    session : Session               as it was read
    motions : mapping of str to ProbingMotion   of probings that have no file of displacements
    pose : PoseChoice               with which they were measured

    Raises
    ------
    InputError                      the rig cannot be read
    RecordError                     the file cannot be written
    """
    keys = kept_motion_keys(session, pose)
    content: dict[str, Any] = {
        "format": np.array(MOTION_FORMAT),
        "pose": np.array(pose),
        # Probings are numbered: what they are called need not suit a file in an archive.
        "keys": np.array([keys[name] for name in motions], dtype=str),
    }
    for k, motion in enumerate(motions.values()):
        content |= _field_parts(motion.field, k)
        content |= {
            f"{part.name} notes {k}": np.array(getattr(motion.notes, part.name), dtype=str)
            for part in fields(MotionNotes)
        }
    packed = io.BytesIO()
    np.savez_compressed(packed, **content)
    write_bytes(folder / MOTION_FILE, packed.getvalue())


def kept_motion(
    session: Session, folder: Path, *, pose: PoseChoice | None = None
) -> dict[str, ProbingMotion]:
    """What the pictures of a session gave in an earlier result, as far as they are the same.

    Parameters
    ----------
    session : Session               as it was read
    folder : Path                   of the earlier result; it need not exist
    pose : PoseChoice or None       with which they must have been measured; None: any

    Returns
    -------
    dict of str to ProbingMotion    without the probings whose pictures, cameras or mesh have
                                    changed; empty where nothing was kept, it was altered, or the
                                    pose's choice or Palpate itself have changed
    """
    path = folder / MOTION_FILE
    if not unread_probings(session):
        return {}
    try:
        _, changed, sums = folder_changes(folder)
        if MOTION_FILE in changed or MOTION_FILE not in sums:
            return {}
        with stored_arrays(path, "") as arrays:
            form, used = (str(arrays[name]) for name in ("format", "pose"))
            if form != MOTION_FORMAT or pose not in (None, used):
                return {}
            places = {str(key): k for k, key in enumerate(arrays["keys"])}
            return {
                name: _kept_probing(session, name, arrays, places[key])
                for name, key in kept_motion_keys(session, cast(PoseChoice, used)).items()
                if key in places
            }
    except InputError:
        # A file that cannot be read means that the motion is measured again.
        return {}


def kept_motion_keys(session: Session, pose: PoseChoice) -> dict[str, str]:
    """Digests of what the motions depend on that `palpate fit` measures and keeps.

    Parameters
    ----------
    session : Session
    pose : PoseChoice               with which they are measured

    Returns
    -------
    dict of str to str              probing -> 64 hexadecimal digits, of the probings whose
                                    displacements are only in their pictures

    Raises
    ------
    InputError                      pictures without a rig
    RecordError, CalibrationError   the rig cannot be read
    """
    unread = unread_probings(session)
    keys = motion_keys(replace(session, probings=unread), _METHOD, pose) if unread else {}
    return {name: key for name, key in keys.items() if name is not None}


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


def _field_parts(field: DisplacementField, k: int) -> dict[str, Any]:
    """Arrays of a displacement field."""
    parts = {
        f"vertex {k}": field.vertex,
        f"displacement {k}": field.displacement,
        f"std {k}": field.std,
        f"pairs {k}": field.correlation.pair,
        f"correlation {k}": field.correlation.value,
        f"covariance {k}": field.covariance,
    }
    average = {} if field.average is None else _average_parts(field.average, k)
    return {name: part for name, part in parts.items() if part is not None} | average


def _average_parts(average: SurfaceAverage, k: int) -> dict[str, np.ndarray]:
    """Arrays of a window average."""
    weights = average.weights
    # As they are: in another order, products with them would have other last digits.
    return {
        f"average points {k}": average.points,
        f"average weights {k}": weights.data,
        f"average columns {k}": weights.indices,
        f"average rows {k}": weights.indptr,
    }


def _kept_average(arrays: dict[str, np.ndarray], k: int) -> SurfaceAverage | None:
    """The window average from the arrays of `_average_parts`, if there are any."""
    if f"average points {k}" not in arrays:
        return None
    points, weights, columns, rows = (
        arrays[f"average {part} {k}"] for part in ("points", "weights", "columns", "rows")
    )
    shape = 3 * (len(rows) - 1), 3 * len(points)
    return SurfaceAverage(points, bsr_array((weights, columns, rows), shape=shape))


def _kept_probing(
    session: Session, name: str, arrays: dict[str, np.ndarray], k: int
) -> ProbingMotion:
    """What the pictures of a probing gave, from the arrays with a number."""
    rows = arrays[f"vertex {k}"]
    points = session.mesh.vertices[rows]
    field = DisplacementField(
        points=points,
        displacement=arrays[f"displacement {k}"],
        std=arrays[f"std {k}"],
        vertex=rows,
        surface=closest_points(session.mesh, points),
        source=f"images of {name}",
        covariance=arrays.get(f"covariance {k}"),
        correlation=PointCorrelation(arrays[f"pairs {k}"], arrays[f"correlation {k}"]),
        average=_kept_average(arrays, k),
    )
    notes = {
        part.name: tuple(str(note) for note in arrays[f"{part.name} notes {k}"])
        for part in fields(MotionNotes)
    }
    return ProbingMotion(field, MotionNotes(**notes))
