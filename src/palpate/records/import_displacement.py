"""Displacements measured by other programs: read, put into the object frame, tied to the mesh."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np
from jaxtyping import Float

from palpate.errors import RecordError
from palpate.geometry import TriangleMesh, bounding_diagonal, closest_points, mesh_quality
from palpate.records.probing import DisplacementField
from palpate.records.programs import (
    MeasuredPoints,
    measured_rows,
    read_dice,
    read_matchid,
    read_multidic,
    read_opencorr,
    read_pyvale,
    read_vic3d,
    read_vtu,
)
from palpate.shapes import Flags

# A view of the object shows much of it: points that span three times as much, or a hundredth, are
# in another unit (the units differ by factors of 10, 25.4 and 1000).
_TOO_WIDE, _TOO_NARROW = 3.0, 0.01


class _Reader(Protocol):
    def __call__(
        self, path: Path, *, length_unit: str | None = None, frame: int | None = None
    ) -> MeasuredPoints: ...


IMPORT_KINDS: Mapping[str, _Reader] = MappingProxyType(
    {
        "dice": read_dice,
        "vic3d": read_vic3d,
        "matchid": read_matchid,
        "pyvale": read_pyvale,
        "opencorr": read_opencorr,
        "multidic": read_multidic,
        "duodic": read_multidic,
        "vtu": read_vtu,
    }
)


@dataclass(frozen=True, slots=True, eq=False)
class ImportedField:
    """A displacement field from another program, and where each of its points went.

    Parameters
    ----------
    field : DisplacementField       on the mesh; failed points that have a place are rows of NaN
    read : int                      points in the file
    failed : int                    of them kept as rows of NaN
    nowhere : int                   failed points left out: without a place, or one off the surface
    off_surface : int               measured points left out as they lie off the surface
    median_distance : float [m]     of all measured points from the surface
    notes : tuple of str            about the file
    """

    field: DisplacementField
    read: int
    failed: int
    nowhere: int
    off_surface: int
    median_distance: float
    notes: tuple[str, ...]


def read_measured(
    kind: str, path: Path | str, *, length_unit: str | None = None, frame: int | None = None
) -> MeasuredPoints:
    """Points and displacements of one result file, in metres, in the program's own frame.

    Parameters
    ----------
    kind : str                      dice, vic3d, matchid, pyvale, opencorr, multidic, duodic or vtu
    path : path
    length_unit : str or None       um, mm, cm, m or in, where the file does not tell
    frame : int or None             state, from 0, in files of several; None: the last one

    Raises
    ------
    RecordError                     unknown kind; not there, damaged, 2-D, nothing measured
    """
    if kind not in IMPORT_KINDS:
        raise RecordError(f"kind is '{kind}'; must be one of {', '.join(IMPORT_KINDS)}")
    return IMPORT_KINDS[kind](Path(path), length_unit=length_unit, frame=frame)


def on_object(measured: MeasuredPoints, T_object_file: Float[np.ndarray, "4 4"]) -> MeasuredPoints:
    """The same points in the object frame.

    The standard deviations are those of the turned components; that the turned errors of two
    components go together is lost.

    Parameters
    ----------
    measured : MeasuredPoints
    T_object_file : (4, 4) float [m]    a rigid motion, x_object = T_object_file x_file
    """
    rotation = T_object_file[:3, :3]
    std = measured.std
    return MeasuredPoints(
        points=measured.points @ rotation.T + T_object_file[:3, 3],
        displacement=measured.displacement @ rotation.T,
        std=None if std is None else np.sqrt(std**2 @ (rotation**2).T),
        kind=measured.kind,
        source=measured.source,
        notes=measured.notes,
    )


def on_surface(
    measured: MeasuredPoints, mesh: TriangleMesh, *, drop_off_surface: bool = False
) -> ImportedField:
    """Displacement field of the points that lie on an object, everything else counted.

    Parameters
    ----------
    measured : MeasuredPoints       in the object frame
    mesh : TriangleMesh             in metres
    drop_off_surface : bool         leave measured points out that lie off the surface (background,
                                    tool, holder); otherwise they are refused

    Raises
    ------
    RecordError                     measured points off the surface that may not be left out, or
                                    half of them: then the frames or units differ
    """
    is_measured = measured_rows(measured)
    has_place = ~np.isnan(measured.points).any(axis=1)
    distance = np.full(len(has_place), np.inf)
    distance[has_place] = closest_points(mesh, measured.points[has_place]).distance
    is_near = distance <= _surface_limit(mesh)
    off = int((is_measured & ~is_near).sum())
    if off:
        _check_off_surface(measured, mesh, distance, drop_off_surface=drop_off_surface)
    kept = np.flatnonzero(is_near)
    std = measured.std
    points = measured.points[kept]
    field = DisplacementField(
        points=points,
        displacement=measured.displacement[kept],
        std=None if std is None else std[kept],
        vertex=None,
        surface=closest_points(mesh, points),
        source=measured.source,
    )
    return ImportedField(
        field=field,
        read=len(has_place),
        failed=int((~is_measured & is_near).sum()),
        nowhere=int((~is_measured & ~is_near).sum()),
        off_surface=off,
        median_distance=float(np.median(distance[is_measured])),
        notes=measured.notes + _span_notes(measured, mesh),
    )


def _span(measured: MeasuredPoints) -> float:
    """Diagonal of the box round the measured points [m]."""
    return float(np.linalg.norm(np.ptp(measured.points[measured_rows(measured)], axis=0)))


def _span_notes(measured: MeasuredPoints, mesh: TriangleMesh) -> tuple[str, ...]:
    """Points in too small a unit may all lie on the surface, where the frame's origin does."""
    span, size = _span(measured), bounding_diagonal(mesh)
    if span >= _TOO_NARROW * size:
        return ()
    note = (
        f"The points span {span:.3g} m of an object of {size:.3g} m, implausibly little: is their"
        " unit right (--length-unit)?"
    )
    return (note,)


def _surface_limit(mesh: TriangleMesh) -> float:
    """Distance from the surface beyond which `read_displacement` refuses a point [m]."""
    return max(0.02 * bounding_diagonal(mesh), 0.5 * mesh_quality(mesh).edge_mean)


def _check_off_surface(
    measured: MeasuredPoints,
    mesh: TriangleMesh,
    distance: Float[np.ndarray, " n"],
    *,
    drop_off_surface: bool,
) -> None:
    """Refuse points off the surface, unless they are the minority and may be left out."""
    is_measured: Flags = measured_rows(measured)
    found, limit = distance[is_measured], _surface_limit(mesh)
    off, middle = int((found > limit).sum()), float(np.median(found))
    if drop_off_surface and middle <= limit:
        return
    size = bounding_diagonal(mesh)
    span = _span(measured)
    what = (
        f"{measured.source}: {off} of {len(found)} measured points lie farther than {limit:.3g} m"
        f" off the surface (median {middle:.3g} m, worst {found.max():.3g} m)"
    )
    if not _TOO_NARROW * size <= span <= _TOO_WIDE * size:
        raise RecordError(
            f"{what}; they span {span:.3g} m and the mesh {size:.3g} m: check --length-unit, and"
            " length_unit of the session"
        )
    pose = "--to-object FILE, a TOML file with length_unit, R and t, where x_object = R x_file + t"
    if middle > limit:
        raise RecordError(
            f"{what}: the frame of the program is not the object's; say where it lies with {pose}"
        )
    raise RecordError(
        f"{what}; where they are background, tool or holder, leave them out with"
        f" --drop-off-surface; otherwise the pose is not right: {pose}"
    )
