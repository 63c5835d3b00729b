"""The motion measured in a session's pictures, kept in the result folder for the next fit."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.sparse import bsr_array, csr_array

from palpate.disk import write_bytes
from palpate.errors import InputError
from palpate.files import stored_arrays
from palpate.geometry import closest_points
from palpate.pipeline.motion import SCALE_ERROR, motion_key
from palpate.pipeline.object_pose import PoseChoice
from palpate.records import (
    DisplacementField,
    PointCorrelation,
    Session,
    SurfaceAverage,
    folder_changes,
)
from palpate.vision import JointFlow

MOTION_FILE = "motion.npz"
MOTION_FORMAT = "palpate-motion/4"
# Flow method that `palpate fit` uses.
_METHOD = JointFlow()


def keep_motion(
    folder: Path, given: Session, measured: Session, *, pose: PoseChoice = "auto"
) -> None:
    """Write the displacements measured in pictures, with a digest of everything they depend on.

    Parameters
    ----------
    folder : Path                   of the result
    given : Session                 as it was read
    measured : Session              the same, with the measured displacements
    pose : PoseChoice               with which they were measured

    Raises
    ------
    InputError                      a file of the session cannot be read
    RecordError                     the file cannot be written
    """
    content: dict[str, Any] = {
        "format": np.array(MOTION_FORMAT),
        "key": np.array(motion_key(given, _METHOD, pose)),
        "pose": np.array(pose),
        "notes": np.array(measured.notes[len(given.notes) :], dtype=str),
    }
    for before, probing in zip(given.probings, measured.probings, strict=True):
        field = probing.displacement
        if before.displacement is None and field is not None and field.vertex is not None:
            content[f"vertex {probing.name}"] = field.vertex
            content[f"displacement {probing.name}"] = field.displacement
            content[f"std {probing.name}"] = field.std
            content[f"pairs {probing.name}"] = field.correlation.pair
            content[f"correlation {probing.name}"] = field.correlation.value
            if field.covariance is not None:
                content[f"covariance {probing.name}"] = field.covariance
            if field.average is not None:
                content |= _average_parts(field.average, probing.name)
    packed = io.BytesIO()
    np.savez_compressed(packed, **content)
    write_bytes(folder / MOTION_FILE, packed.getvalue())


def with_kept_motion(
    session: Session, folder: Path, *, pose: PoseChoice | None = None
) -> Session | None:
    """The session with the displacements of its pictures from an earlier result.

    Parameters
    ----------
    session : Session               as it was read
    folder : Path                   of the earlier result; it need not exist
    pose : PoseChoice or None       with which they must have been measured; None: any

    Returns
    -------
    Session or None                 None: nothing was kept, it was altered, or the session's files,
                                    its probings, the pose's choice or Palpate itself have changed
    """
    path = folder / MOTION_FILE
    try:
        _, changed, sums = folder_changes(folder)
        if MOTION_FILE in changed or MOTION_FILE not in sums:
            return None
        with stored_arrays(path, "") as kept:
            form, key, used = (str(kept[name]) for name in ("format", "key", "pose"))
            if form != MOTION_FORMAT or pose not in (None, used):
                return None
            if key != motion_key(session, _METHOD, cast(PoseChoice, used)):
                return None
            return _with_fields(session, kept)
    except InputError:
        # A file that cannot be read means that the motion is measured again.
        return None


def _average_parts(average: SurfaceAverage, name: str) -> dict[str, np.ndarray]:
    """Arrays of a window average, with its weights in 3 x 3 blocks."""
    blocks = bsr_array(average.weights, blocksize=(3, 3))
    return {
        f"average points {name}": average.points,
        f"average blocks {name}": blocks.data,
        f"average columns {name}": blocks.indices,
        f"average rows {name}": blocks.indptr,
    }


def _kept_average(kept: dict[str, np.ndarray], name: str) -> SurfaceAverage | None:
    """The window average from the arrays of `_average_parts`, if there are any."""
    if f"average points {name}" not in kept:
        return None
    points, blocks, columns, rows = (
        kept[f"average {part} {name}"] for part in ("points", "blocks", "columns", "rows")
    )
    shape = 3 * (len(rows) - 1), 3 * len(points)
    weights = bsr_array((blocks, columns, rows), shape=shape)
    return SurfaceAverage(points, csr_array(weights))


def _with_fields(session: Session, kept: dict[str, np.ndarray]) -> Session:
    probings = []
    for probing in session.probings:
        if probing.displacement is None and probing.images:
            rows = kept[f"vertex {probing.name}"]
            points = session.mesh.vertices[rows]
            field = DisplacementField(
                points=points,
                displacement=kept[f"displacement {probing.name}"],
                std=kept[f"std {probing.name}"],
                vertex=rows,
                surface=closest_points(session.mesh, points),
                source=f"images of {probing.name}",
                scale_error=SCALE_ERROR,
                covariance=kept.get(f"covariance {probing.name}"),
                correlation=PointCorrelation(
                    kept[f"pairs {probing.name}"], kept[f"correlation {probing.name}"]
                ),
                average=_kept_average(kept, probing.name),
            )
            probing = replace(probing, displacement=field)
        probings.append(probing)
    notes = session.notes + tuple(str(note) for note in kept["notes"])
    return replace(session, probings=tuple(probings), notes=notes)
