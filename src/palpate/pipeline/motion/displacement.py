"""Measured motions as displacements of a session's probings, which the estimation takes."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, closest_points
from palpate.pipeline.motion.measure_motion import MeasuredMotion, SessionFlow, measure_motion
from palpate.pipeline.object_pose import PoseChoice
from palpate.progress import Progress, silent
from palpate.records import DisplacementField, Session
from palpate.shapes import Indices
from palpate.vision import VertexDisplacement, measured_vertices

# Texture finer than the pixels makes motions of a fraction of a pixel come out too long: with the
# low-pass filter applied, by 0.1 % for speckles with a sigma of 1.7 px, by 0.5 to 1.2 % for 1 to
# 0.6 px (analytic textures).
SCALE_ERROR = 0.007


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
