"""The motion measured in a session's pictures, kept in the result folder for the next fit."""

import io
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.sparse import csr_array

from palpate.disk import write_bytes
from palpate.errors import InputError
from palpate.files import stored_arrays
from palpate.geometry import closest_points
from palpate.pipeline.motion.displacement import ProbingMotion, unread_probings
from palpate.pipeline.motion.notes import MotionNotes
from palpate.pipeline.motion.sequences import motion_keys
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
MOTION_FORMAT = "palpate-motion/5"
# Flow method that `palpate fit` uses.
_METHOD = JointFlow()


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
        with stored_arrays(path, "") as kept:
            form, used = (str(kept[name]) for name in ("format", "pose"))
            if form != MOTION_FORMAT or pose not in (None, used):
                return {}
            places = {str(key): k for k, key in enumerate(kept["keys"])}
            return {
                name: _kept_probing(session, name, kept, places[key])
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


def _kept_average(kept: dict[str, np.ndarray], k: int) -> SurfaceAverage | None:
    """The window average from the arrays of `_average_parts`, if there are any."""
    if f"average points {k}" not in kept:
        return None
    points, weights, columns, rows = (
        kept[f"average {part} {k}"] for part in ("points", "weights", "columns", "rows")
    )
    shape = len(rows) - 1, 3 * len(points)
    return SurfaceAverage(points, csr_array((weights, columns, rows), shape=shape))


def _kept_probing(
    session: Session, name: str, kept: dict[str, np.ndarray], k: int
) -> ProbingMotion:
    """What the pictures of a probing gave, from the arrays with a number."""
    rows = kept[f"vertex {k}"]
    points = session.mesh.vertices[rows]
    field = DisplacementField(
        points=points,
        displacement=kept[f"displacement {k}"],
        std=kept[f"std {k}"],
        vertex=rows,
        surface=closest_points(session.mesh, points),
        source=f"images of {name}",
        covariance=kept.get(f"covariance {k}"),
        correlation=PointCorrelation(kept[f"pairs {k}"], kept[f"correlation {k}"]),
        average=_kept_average(kept, k),
    )
    notes = {
        part.name: tuple(str(note) for note in kept[f"{part.name} notes {k}"])
        for part in fields(MotionNotes)
    }
    return ProbingMotion(field, MotionNotes(**notes))
