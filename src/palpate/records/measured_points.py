"""Displacements measured by other programs: converted to metres, object frame, and the mesh.

The pose of such a program's frame in the object frame comes from a small TOML file.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.arrays import fixed_array
from palpate.errors import InputError, RecordError, quoted
from palpate.geometry import TriangleMesh, bounding_diagonal, closest_points, mesh_quality
from palpate.records.probing import DisplacementField, lengths, measured_rows
from palpate.records.program import ProgramPoints, nearest_rotation
from palpate.records.quantities import LENGTH_UNITS, unit_name
from palpate.records.text.toml_table import TomlTable, read_toml
from palpate.shapes import Flags, Points, PointScalars

# The measured points cover a good part of the object: an extent of three times its size, or of a
# hundredth, means a wrong unit (units differ by factors of 10, 25.4 and 1000).
_MAX_SPAN, _MIN_SPAN = 3.0, 0.01
# A rotation typed with four digits is this far from orthogonal; a larger error is a mistake.
_MAX_TYPED_ERROR = 1e-3
_MAX_ROUNDING_ERROR = 1e-9
# An entry of a rotation matrix that is smaller carries nothing of one component into another.
_NO_PART = 1e-9
_EXAMPLE = 'length_unit = "mm", R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], t = [0, 0, 0]'


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPoints:
    """Points and displacements of another program's result, made by `in_metres`.

    Parameters
    ----------
    points : (n, 3) float [m]       at rest; NaN only for failed points without a position
    displacement : (n, 3) float [m] NaN rows for points that were not measured; never all of them
    std : (n, 3) float [m] or None  one standard deviation of the displacement, > 0 where measured
    source : str                    file they came from, for messages
    notes : tuple of str            what was assumed, converted or left out, in sentences about the
                                    file, without its name
    poorly_correlated : int         number of points rejected for low correlation, NaN rows
    contradicted : int              number of points rejected as contradicting their neighbours, NaN
                                    rows
    """

    points: Points
    displacement: Points
    std: Points | None
    source: str
    notes: tuple[str, ...]
    poorly_correlated: int = 0
    contradicted: int = 0

    def without(self, contradicted: Flags) -> "MeasuredPoints":
        """A copy in which some measured points are rejected as contradicting their neighbours.

        Parameters
        ----------
        contradicted : (n,) bool        measured points to reject

        Returns
        -------
        MeasuredPoints
        """
        row = contradicted[:, None]
        return replace(
            self,
            displacement=np.where(row, np.nan, self.displacement),
            std=None if self.std is None else np.where(row, np.nan, self.std),
            contradicted=self.contradicted + int(contradicted.sum()),
        )


@dataclass(frozen=True, slots=True, eq=False)
class ImportedField:
    """A displacement field from another program, with an account of all its points.

    Parameters
    ----------
    field : DisplacementField       on the mesh; failed points on the surface are NaN rows
    read : int                      number of points in the file
    failed : int                    of these kept as NaN rows, for whatever reason
    poorly_correlated : int         rejected for low correlation
    contradicted : int              rejected as contradicting their neighbours
    without_position : int          failed points left out: without a position, or off the surface
    off_surface : int               measured points left out because they lie off the surface
    median_distance : float [m]     of all measured points from the surface
    notes : tuple of str            sentences about the file
    """

    field: DisplacementField
    read: int
    failed: int
    poorly_correlated: int
    contradicted: int
    without_position: int
    off_surface: int
    median_distance: float
    notes: tuple[str, ...]


def in_metres(
    given: ProgramPoints,
    path: Path,
    *,
    length_unit: str | None,
    default_unit: str | None,
    min_score: float | None = None,
) -> MeasuredPoints:
    """Convert a program's points to metres; points that were not measured become NaN rows.

    A failed point at exactly (0, 0, 0) has no position: programs write zeros where triangulation
    failed. If any measured point lacks a standard deviation, all are dropped, with a note.

    Parameters
    ----------
    given : ProgramPoints           as read from the file
    path : Path                     the file
    length_unit : str or None       as given by the user
    default_unit : str or None      unit that the program uses if its file states none
    min_score : float or None       points with a lower correlation are rejected

    Returns
    -------
    MeasuredPoints                  still in the program's frame

    Raises
    ------
    RecordError                     nothing was measured, nothing moved, no unit or contradictory
                                    units
    """
    metres, unit_notes = _metres(
        path, file_unit=given.unit, given=length_unit, default_unit=default_unit
    )
    moved = np.where(np.isinf(given.displacement), np.nan, given.displacement)
    points = np.where(np.isinf(given.points), np.nan, given.points)
    failed = ~measured_rows(moved) | np.isnan(points).any(axis=1)
    if given.failed is not None:
        failed |= given.failed
    poorly_correlated = np.zeros(len(failed), dtype=bool)
    if given.score is not None and min_score is not None:
        poorly_correlated = ~failed & (given.score < min_score)
    failed |= poorly_correlated
    low_score_text = (
        f"; {poorly_correlated.sum()} correlate by less than {min_score} (--min-score)"
        if poorly_correlated.any()
        else ""
    )
    _check_measured(path, moved, failed, low_score_text)
    without_position = failed & (np.isnan(points).any(axis=1) | ~points.any(axis=1))
    std, notes = given.std, given.notes + unit_notes
    if std is not None:
        without_std = int((~(std[~failed] > 0.0) | np.isinf(std[~failed])).any(axis=1).sum())
        if without_std:
            notes += (
                f"{without_std} measured points have no sigma; that of the others was left out.",
            )
            std = None
    return MeasuredPoints(
        points=metres * np.where(without_position[:, None], np.nan, points),
        displacement=metres * np.where(failed[:, None], np.nan, moved),
        std=None if std is None else metres * np.where(failed[:, None], np.nan, std),
        source=str(path),
        notes=notes,
        poorly_correlated=int(poorly_correlated.sum()),
    )


def _check_measured(path: Path, moved: Points, failed: Flags, low_score_text: str) -> None:
    """Refuse a file in which nothing was measured, or nothing moved."""
    if failed.all():
        raise RecordError(
            f"{path}: not one of its {len(failed)} points was measured (failed or"
            f" NaN{low_score_text}); is it the right file and state? Evaluate it again"
        )
    if not lengths(moved[~failed]).any():
        raise RecordError(
            f"{path}: every displacement is exactly zero: this is the reference state itself;"
            " give the file of the loaded state, or its number with --frame"
        )


def _metres(
    path: Path, *, file_unit: str | None, given: str | None, default_unit: str | None
) -> tuple[float, tuple[str, ...]]:
    """Length of a file's unit [m], and notes on what was assumed.

    The unit stated in the file comes first, then the user's, then the program's default one; an
    unknown unit, a contradiction, or none at all is refused.
    """
    names = " ".join(LENGTH_UNITS)
    stated = unit_name(file_unit) if file_unit else None
    if stated is not None and stated not in LENGTH_UNITS:
        raise RecordError(
            f"{path}: its lengths are in '{file_unit}'; known units are {names}: export it in one"
            " of them (pixels are no lengths: a stereo result is needed)"
        )
    if given is not None and given not in LENGTH_UNITS:
        raise RecordError(f"--length-unit is '{given}'; must be one of {names}")
    if stated is not None and given is not None and stated != given:
        raise RecordError(
            f"{path}: its header says {stated}, --length-unit says {given}; leave the option out"
        )
    if unit := stated or given:
        return LENGTH_UNITS[unit], ()
    if default_unit is None:
        raise RecordError(
            f"{path}: does not say its unit of length; say it with --length-unit ({names})"
        )
    note = f"It does not say its unit of length; {default_unit} was taken (--length-unit)."
    return LENGTH_UNITS[default_unit], (note,)


def in_object_frame(
    measured: MeasuredPoints, T_object_file: Float[np.ndarray, "4 4"]
) -> MeasuredPoints:
    """Transform points and displacements to the object frame.

    The standard deviations are those of the rotated components; the correlation between components
    that the rotation introduces is neglected.

    Parameters
    ----------
    measured : MeasuredPoints           in the program's frame
    T_object_file : (4, 4) float        rigid motion, x_object = T_object_file x_file; translation
                                        in metres

    Returns
    -------
    MeasuredPoints

    Raises
    ------
    RecordError                         displacements in a plane that lies across the axes
    """
    rotation = T_object_file[:3, :3]
    std, moved = measured.std, measured.displacement
    turned = np.nan_to_num(moved) @ rotation.T
    # A component is known where all that it is made of is.
    made_of_unknown = np.isnan(moved).astype(float) @ (np.abs(rotation.T) > _NO_PART)
    displacement = np.where(made_of_unknown > 0.0, np.nan, turned)
    if measured_rows(moved).any() and not measured_rows(displacement).any():
        raise RecordError(
            f"{measured.source}: holds the displacement in a plane alone, which lies across the"
            " axes of the object's frame; turn the mesh so that its axes are those of the picture"
        )
    return replace(
        measured,
        points=measured.points @ rotation.T + T_object_file[:3, 3],
        displacement=displacement,
        std=None if std is None else np.sqrt(std**2 @ (rotation**2).T),
    )


def on_surface(
    measured: MeasuredPoints, mesh: TriangleMesh, *, drop_off_surface: bool = False
) -> ImportedField:
    """Displacement field of the points that lie on the object's surface; all others are counted.

    Parameters
    ----------
    measured : MeasuredPoints       in the object frame
    mesh : TriangleMesh             in metres
    drop_off_surface : bool         leave out measured points off the surface (background, tool,
                                    holder); otherwise they are refused

    Returns
    -------
    ImportedField

    Raises
    ------
    RecordError                     measured points off the surface, without `drop_off_surface` or
                                    more than half of them: then frames or units differ
    """
    is_measured = measured_rows(measured.displacement)
    has_position = ~np.isnan(measured.points).any(axis=1)
    distance = np.full(len(has_position), np.inf)
    distance[has_position] = closest_points(mesh, measured.points[has_position]).distance
    is_near = distance <= surface_limit(mesh)
    off_surface = int((is_measured & ~is_near).sum())
    if off_surface:
        _check_off_surface(measured, mesh, distance[is_measured], may_drop=drop_off_surface)
    rows = np.flatnonzero(is_near)
    std = measured.std
    points = measured.points[rows]
    field = DisplacementField(
        points=points,
        displacement=measured.displacement[rows],
        std=None if std is None else std[rows],
        vertex=None,
        surface=closest_points(mesh, points),
        source=measured.source,
    )
    return ImportedField(
        field=field,
        read=len(has_position),
        failed=int((~is_measured & is_near).sum()),
        poorly_correlated=measured.poorly_correlated,
        contradicted=measured.contradicted,
        without_position=int((~is_measured & ~is_near).sum()),
        off_surface=off_surface,
        median_distance=float(np.median(distance[is_measured])),
        notes=measured.notes + _span_notes(measured, mesh),
    )


def _span(measured: MeasuredPoints) -> float:
    """Diagonal of the measured points' bounding box [m]."""
    return float(
        np.linalg.norm(np.ptp(measured.points[measured_rows(measured.displacement)], axis=0))
    )


def _span_notes(measured: MeasuredPoints, mesh: TriangleMesh) -> tuple[str, ...]:
    """A note if the points span too little of the object: with too small a unit all of them may
    still lie on the surface, near the origin of the frame."""
    span, size = _span(measured), bounding_diagonal(mesh)
    if span >= _MIN_SPAN * size:
        return ()
    note = (
        f"The points span {span:.3g} m of an object of {size:.3g} m, implausibly little: is their"
        " unit right (--length-unit)?"
    )
    return (note,)


def surface_limit(mesh: TriangleMesh) -> float:
    """Distance from the surface beyond which a point cannot belong to it [m].

    Parameters
    ----------
    mesh : TriangleMesh             in metres

    Returns
    -------
    float [m]                       the larger of 2 % of the diagonal and half a mean edge
    """
    return max(0.02 * bounding_diagonal(mesh), 0.5 * mesh_quality(mesh).edge_mean)


def _check_off_surface(
    measured: MeasuredPoints, mesh: TriangleMesh, distances: PointScalars, *, may_drop: bool
) -> None:
    """Refuse measured points off the surface, unless they are a minority and may be left out."""
    limit, median = surface_limit(mesh), float(np.median(distances))
    if may_drop and median <= limit:
        return
    size, span, off_surface = bounding_diagonal(mesh), _span(measured), (distances > limit).sum()
    what = (
        f"{measured.source}: {off_surface} of {len(distances)} measured points lie farther than"
        f" {limit:.3g} m off the surface (median {median:.3g} m, worst {distances.max():.3g} m)"
    )
    if not _MIN_SPAN * size <= span <= _MAX_SPAN * size:
        raise RecordError(
            f"{what}; they span {span:.3g} m and the mesh {size:.3g} m: check --length-unit, and"
            " length_unit of the session"
        )
    pose = "--to-object FILE, a TOML file with length_unit, R and t, where x_object = R x_file + t"
    if median > limit:
        raise RecordError(
            f"{what}: the frame of the program is not the object's; say where it lies with {pose}"
        )
    raise RecordError(
        f"{what}; where they are background, tool or holder, leave them out with"
        f" --drop-off-surface; otherwise the pose is not right: {pose}"
    )


def read_import_pose(path: Path | str) -> tuple[Float[np.ndarray, "4 4"], tuple[str, ...]]:
    """Rigid motion that maps the points of a file to the object frame.

    The file has `length_unit` (of t), and either `R` (3 x 3, rows) and `t`, with
    x_object = R x_file + t, or `T`, the same as one 4 x 4 matrix.

    Parameters
    ----------
    path : path                     a TOML file

    Returns
    -------
    T_object_file : (4, 4) float    translation in metres
    notes : tuple of str            that R was made orthogonal, if so

    Raises
    ------
    RecordError                     missing file, not TOML, a missing or unknown key, R not a
                                    rotation
    """
    table = read_toml(Path(path))
    table.check_keys(("length_unit", "R", "t", "T"))
    unit = LENGTH_UNITS[table.choice("length_unit", tuple(LENGTH_UNITS))]
    if ("T" in table.values) == ("R" in table.values or "t" in table.values):
        table.fail("", f"must have either R and t, or T; for example: {_EXAMPLE}")
    if "T" in table.values:
        pose = _matrix(table, "T", 4).copy()
        if not np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]):
            table.fail("T", f"has the last row {pose[3].tolist()}; must be [0, 0, 0, 1]")
    else:
        pose = np.eye(4)
        pose[:3, :3] = _matrix(table, "R", 3)
        pose[:3, 3] = table.vector("t")
    rotation, error = _rotation(table, pose[:3, :3])
    pose[:3, :3] = rotation
    pose[:3, 3] *= unit
    if error < _MAX_ROUNDING_ERROR:
        return pose, ()
    return pose, (
        f"{path}: R was made orthogonal; it was {error:.1g} off (typed with few digits?).",
    )


def _matrix(table: TomlTable, key: str, size: int) -> np.ndarray:
    """A square matrix of finite numbers."""
    value = table.get(key)
    try:
        return fixed_array(value, name=key, shape=(size, size))
    except InputError:
        table.fail(key, f"is {quoted(value)}; must be {size} rows of {size} finite numbers")


def _rotation(table: TomlTable, given: np.ndarray) -> tuple[np.ndarray, float]:
    """The rotation nearest to an almost orthogonal matrix, and the error of that matrix."""
    error = float(np.abs(given @ given.T - np.eye(3)).max())
    determinant = float(np.linalg.det(given))
    if error > _MAX_TYPED_ERROR:
        table.fail(
            "R", f"is no rotation: R R^T is {error:.2g} off the identity; check its rows and digits"
        )
    if determinant < 0.0:
        table.fail(
            "R",
            "is a mirror image (determinant -1); both frames are right-handed: swap two axes, or"
            " the sign of one",
        )
    return nearest_rotation(given), error
