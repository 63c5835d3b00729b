"""The cube's session with pictures in the place of its displacements, and what they gave."""

import numpy as np
from flow_samples import rig
from scipy.sparse import bsr_array, dia_array, kron

from palpate.geometry import closest_points
from palpate.pipeline import MotionNotes, ProbingMotion, with_motions
from palpate.records import (
    DisplacementField,
    PointCorrelation,
    SurfaceAverage,
    read_session,
    write_rig,
)


def with_pictures(folder):
    """The session's folder, its probing with (empty) pictures and a rig."""
    file = folder / "session.toml"
    text = file.read_text(encoding="utf-8").replace(
        'displacement = "n01.csv"',
        'images = { rest = "rest_{camera}.png", loaded = ["loaded_{camera}.png"] }',
    )
    head, probe = text.split("[[probe]]")
    file.write_text(f'{head}[rig]\ncameras = "rig.toml"\n[[probe]]{probe}', encoding="utf-8")
    write_rig(folder / "rig.toml", rig())
    for name in ("rest_c0", "rest_c1", "loaded_c0", "loaded_c1"):
        (folder / f"{name}.png").write_bytes(name.encode())
    return folder


def measured_motion(session, probing, *, seed=2, notes=("the pictures are dark",)):
    """Displacements of the upper vertices of a probing, one of them lost, with notes."""
    rows = np.flatnonzero(session.mesh.vertices[:, 2] > 0.035)
    points = session.mesh.vertices[rows]
    moved = 1e-4 * np.random.default_rng(seed).normal(size=points.shape)
    moved[3] = np.nan
    covariance = np.tile(4e-12 * np.array([[1, 0, 0.5], [0, 1, 0], [0.5, 0, 1]]), (len(rows), 1, 1))
    field = DisplacementField(
        points=points, displacement=moved, std=np.full(points.shape, 2e-6), vertex=rows,
        surface=closest_points(session.mesh, points), source=f"images of {probing.name}",
        covariance=covariance,
        correlation=PointCorrelation(np.array([[0, 1], [1, 4]]), np.array([0.6, -0.1])),
        average=_averages(points),
    )  # fmt: skip
    return ProbingMotion(field, MotionNotes(pictures=tuple(notes)))


def measured(session):
    """The session with such displacements of its probing, and a note."""
    (probing,) = session.probings
    return with_motions(session, {probing.name: measured_motion(session, probing)})


def _averages(points):
    """Each point but the last two is the mean of itself and the next two."""
    count = len(points)
    mean = np.array([1 / 3, 1 / 3, 1 / 3])[:, None] * np.ones(count)
    rows = dia_array((mean, [0, 1, 2]), shape=(count - 2, count))
    weights = bsr_array(kron(rows, np.eye(3)), blocksize=(3, 3))
    return SurfaceAverage(points, weights).embedded(np.arange(count - 2), count)


def given_and_measured(folder):
    """Both sessions."""
    session = read_session(with_pictures(folder))
    return session, measured(session)
