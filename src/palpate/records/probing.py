"""One probing: where the tool pressed, with what force, and how the surface moved.

A linear model cannot follow a large rigid rotation of the measured points, which is detected here.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import bsr_array, csr_array
from scipy.spatial.transform import Rotation

from palpate.arrays import fix_fields
from palpate.errors import InputError
from palpate.geometry import SurfacePoints, place_text
from palpate.records.contact import RIGID, Contact
from palpate.records.series import Series
from palpate.records.support import RigidMotion
from palpate.shapes import Flags, Indices, PointIndices, Points, PointScalars, Vector3

# Tolerance on the sum of some hundred weights in single precision.
_ROUNDING = 1e-5
# Rotations that cause a warning and a refusal [rad]. A rotation has a spurious linearised strain of
# half its square: 2 % and 12 % here. The refusal is not at less since the free end of a bent beam
# may rotate by 20 degrees, and looks much like a rotated body.
LARGE_ROTATION, _LARGEST_ROTATION = 0.2, 0.5
# A motion counts as a rotation if at most this fraction of it, without its translation, is left
# after the best rotation.
_MAX_UNEXPLAINED = 0.5
# Contacts nearer than so many radii, under forces of about one direction (its cosine), are one.
_NEAR, _ALONG = 0.1, 0.98
# Points closer to a line than this fraction of their extent do not determine the rotation about it.
_COLLINEAR = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class PointCorrelation:
    """Correlation of the errors of pairs of points; points not in any pair are uncorrelated.

    It applies to the same component of both points; different components are uncorrelated.

    Parameters
    ----------
    pair : (m, 2) int           indices of two points, each pair once, lower index first
    value : (m,) float [-]      correlation coefficient, -1 to 1

    Raises
    ------
    InputError                  wrong shape, a pair out of order, a value outside -1 to 1
    """

    pair: Int[np.ndarray, "m 2"]
    value: Float[np.ndarray, " m"]

    def __post_init__(self) -> None:
        fix_fields(self, integer=True, pair=(None, 2))
        fix_fields(self, value=(len(self.pair),))
        if (self.pair[:, 0] < 0).any() or (self.pair[:, 0] >= self.pair[:, 1]).any():
            raise InputError("pairs of correlated points must have the lower number first")
        # Tolerance for rounding in sums of weights.
        if (np.abs(self.value) > 1.0 + 1e-9).any():
            raise InputError(f"a correlation of {np.abs(self.value).max():g} is more than 1")

    def subset(self, rows: Indices, count: int) -> "PointCorrelation":
        """Restrict to a subset of the points, renumbered by their position in `rows`.

        Parameters
        ----------
        rows : (k,) int         points that are kept, distinct
        count : int             number of points before
        """
        number = np.full(count, -1)
        number[rows] = np.arange(len(rows))
        pair = number[self.pair]
        complete = (pair >= 0).all(axis=1)
        return PointCorrelation(np.sort(pair[complete], axis=1), self.value[complete])


INDEPENDENT = PointCorrelation(np.zeros((0, 2), dtype=np.int64), np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceAverage:
    """Displacements measured as local averages over the surface, as subsets of finite size do.

    The measured displacement of point i is sum_j weights[3i:3i+3, 3j:3j+3] @ u(points[j]); for a
    point without weights it is the displacement of the point itself.

    Parameters
    ----------
    points : (s, 3) float [m]       sampling points on the surface at rest
    weights : (3 n, 3 s) sparse [-] 3 x 3 blocks that sum to the identity along every block row, or
                                    to zero; stored as blocks, in single precision

    Raises
    ------
    InputError                      inconsistent shapes or indices, blocks with another sum
    """

    points: Points
    weights: bsr_array

    def __post_init__(self) -> None:
        fix_fields(self, points=(None, 3))
        try:
            # A product with an index out of range, as of a damaged file, would end the process.
            self.weights.check_format(full_check=True)
            # As blocks: else half of what a session keeps of pictures would be indices.
            blocks = bsr_array(self.weights, dtype=np.float32, blocksize=(3, 3))
            places = (index.astype(np.int32) for index in (blocks.indices, blocks.indptr))
            weights = bsr_array((blocks.data, *places), shape=blocks.shape)
        except ValueError as error:
            raise InputError(f"weights are no matrix of 3 x 3 blocks: {error}") from error
        object.__setattr__(self, "weights", weights)
        rows, columns = self.weights.shape
        if columns != 3 * len(self.points):
            raise InputError(
                f"weights are {rows} x {columns}; must have three columns for each of the"
                f" {len(self.points)} points"
            )
        total = self._total()
        off = np.abs(total - np.eye(3) * self.has_weights[:, None, None])
        wrong = off.max(axis=(1, 2), initial=0.0)
        if (wrong > _ROUNDING).any():
            row = int(wrong.argmax())
            raise InputError(f"weights of displacement {row} add up to {total[row].tolist()}")

    @property
    def has_weights(self) -> Flags:
        """True for the displacements that have weights, (n,) bool."""
        return np.diff(self.weights.indptr) > 0

    def _total(self) -> Float[np.ndarray, "n 3 3"]:
        return (self.weights @ np.tile(np.eye(3), (len(self.points), 1))).reshape(-1, 3, 3)

    def averaging_matrix(self) -> csr_array:
        """Matrix from displacements of the n measured points, then of the s sampling points, to the
        averaged displacements; (3 n, 3 (n + s)) sparse."""
        alone, counts = ~self.has_weights, np.diff(self.weights.indptr)
        # A row holds its weights, or a one at the point itself.
        is_one = np.repeat(alone, np.where(alone, 1, counts))
        data = np.tile(np.eye(3), (is_one.size, 1, 1))
        indices = np.empty(is_one.size, self.weights.indices.dtype)
        data[~is_one] = self.weights.data
        indices[~is_one] = len(alone) + self.weights.indices
        indices[is_one] = np.flatnonzero(alone)
        ends = np.append(0, np.cumsum(np.where(alone, 1, counts)))
        shape = 3 * len(alone), 3 * len(alone) + self.weights.shape[1]
        return bsr_array((data, indices, ends), shape=shape).tocsr()

    def subset(self, rows: Indices) -> "SurfaceAverage":
        """Restrict to a subset of the measured displacements.

        Parameters
        ----------
        rows : (k,) int         displacements that are kept
        """
        starts, counts = self.weights.indptr[rows], np.diff(self.weights.indptr)[rows]
        ends = np.append(0, np.cumsum(counts))
        chosen = np.arange(ends[-1]) + np.repeat(starts - ends[:-1], counts)
        content = self.weights.data[chosen], self.weights.indices[chosen], ends
        shape = 3 * len(rows), self.weights.shape[1]
        return SurfaceAverage(self.points, bsr_array(content, shape=shape))

    def embedded(self, rows: Indices, count: int) -> "SurfaceAverage":
        """Embed into a longer list of displacements, of which the others have no weights.

        Parameters
        ----------
        rows : (n,) int         new indices of these displacements, increasing
        count : int             new number of displacements
        """
        entries = np.zeros(count, dtype=np.int64)
        entries[rows] = np.diff(self.weights.indptr)
        starts = np.append(0, np.cumsum(entries))
        content = self.weights.data, self.weights.indices, starts
        shape = 3 * count, self.weights.shape[1]
        return SurfaceAverage(self.points, bsr_array(content, shape=shape))


@dataclass(frozen=True, slots=True, eq=False)
class DisplacementField:
    """Displacement of surface points between rest and load; NaN rows were not measured.

    Parameters
    ----------
    points : (n, 3) float [m]       at rest, as observed
    displacement : (n, 3) float [m] a row with any NaN is stored as a row of NaN: not measured
    std : (n, 3) float [m] or None  one standard deviation per component, > 0 where measured
    vertex : (n,) int or None       index of the mesh vertex, if the points are vertices
    surface : SurfacePoints         closest positions on the mesh
    source : str                    file they came from, for messages
    covariance : (n, 3, 3) float [m^2] or None    of each point's displacement, with the squares of
                                    `std` on its diagonal; None: components are uncorrelated
    correlation : PointCorrelation  of the errors of neighbouring points, where known
    average : SurfaceAverage or None    local averages that the displacements are; None: they belong
                                    to the points themselves

    Raises
    ------
    InputError                      inconsistent shapes, a standard deviation that is not positive
    """

    points: Points
    displacement: Points
    std: Points | None
    vertex: PointIndices | None
    surface: SurfacePoints
    source: str
    covariance: Float[np.ndarray, "n 3 3"] | None = None
    correlation: PointCorrelation = INDEPENDENT
    average: SurfaceAverage | None = None

    def __post_init__(self) -> None:
        fix_fields(self, points=(None, 3))
        n = len(self.points)
        fix_fields(self, nan_allowed=True, displacement=(n, 3))
        fix_fields(self, nan_allowed=True, none_allowed=True, std=(n, 3), covariance=(n, 3, 3))
        fix_fields(self, integer=True, none_allowed=True, vertex=(n,))
        is_measured = measured_rows(self.displacement)
        moved = np.where(is_measured[:, None], self.displacement, np.nan)
        moved.setflags(write=False)
        object.__setattr__(self, "displacement", moved)
        if self.std is not None:
            known = (self.std > 0.0) | np.isnan(self.displacement)
            bad = np.flatnonzero(is_measured & ~known.all(axis=1))
            if len(bad):
                raise InputError(
                    f"std of {len(bad)} measured points is not positive, the first: row {bad[0]},"
                    f" {self.std[bad[0]].tolist()}; give one standard deviation in each component"
                )
        if len(self.surface.triangle) != n:
            raise InputError(f"surface has {len(self.surface.triangle)} points; must be {n}")
        if self.average is not None and self.average.weights.shape[0] != 3 * n:
            raise InputError(f"average has {self.average.weights.shape[0]} rows; must be {3 * n}")
        if (last := self.correlation.pair.max(initial=-1)) >= n:
            raise InputError(f"correlation names point {last}; must be 0 to {n - 1}")

    def __repr__(self) -> str:
        measured = observed_rows(self)
        length = lengths(self.displacement[measured])
        median = f", median {1e3 * np.median(length):.3g} mm" if len(length) else ""
        return f"DisplacementField: {len(measured)} points, {measured.sum()} measured{median}"


def measured_rows(displacement: Points) -> Flags:
    """True for the points that were measured, (n,) bool: no component is NaN that any other point
    has. One camera sees no depth: a component that no point has is not missing anywhere.

    Parameters
    ----------
    displacement : (n, 3) float [m] NaN where not measured

    Returns
    -------
    (n,) bool
    """
    missing = np.isnan(displacement)
    seen = ~missing.all(axis=0)
    return np.asarray(~missing[:, seen].any(axis=1) & seen.any())


def lengths(displacement: Points) -> PointScalars:
    """Lengths of displacements by the components that were measured, (n,) float [m].

    Parameters
    ----------
    displacement : (n, 3) float [m] NaN where not measured
    """
    return np.asarray(np.linalg.norm(np.nan_to_num(displacement), axis=1))


def observed_rows(field: DisplacementField) -> Flags:
    """True for the points of a field that were measured, (n,) bool.

    Parameters
    ----------
    field : DisplacementField

    Returns
    -------
    (n,) bool
    """
    return measured_rows(field.displacement)


@dataclass(frozen=True, slots=True)
class Images:
    """File patterns of one probing's pictures, with `{camera}` in place of the camera's name.

    Parameters
    ----------
    rest : str                      before the push
    loaded : tuple of str           under the push, in order of time; the last at full force
    """

    rest: str
    loaded: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """An additional load, besides the tool's, that is known exactly.

    Parameters
    ----------
    contact : Contact               any profile but `RIGID`
    force : (3,) float [N] or None  total force on the object
    pressure : float [Pa] or None   normal pressure, > 0 pushes; over triangles only

    Raises
    ------
    InputError                      neither or both of force and pressure, a zero one, a pressure
                                    on a round patch
    """

    contact: Contact
    force: Vector3 | None = None
    pressure: float | None = None

    def __post_init__(self) -> None:
        if (self.force is None) == (self.pressure is None):
            raise InputError("a load needs either a force or a pressure; give one of the two")
        if self.contact.profile == RIGID:
            raise InputError(
                "a load that acts besides the tool cannot be on a support; give the force on a"
                " support as the contact and force of the probing itself"
            )
        if self.pressure is not None and self.contact.triangles is None:
            raise InputError("pressure acts over triangles; name them in the contact of the load")
        fix_fields(self, none_allowed=True, force=(3,))
        size = self.pressure if self.force is None else self.force
        if not np.any(size):
            raise InputError("the load is zero; leave it out")


@dataclass(frozen=True, slots=True, eq=False)
class Probing:
    """One push of the tool with a known force, or other known loads, and what was observed.

    Parameters
    ----------
    name : str                      unique within its session; files are named after it
    contact : Contact
    force : (3,) float [N]          total force of the tool on the object; zero only with `loads`
    force_std : (3,) float [N] or None              one standard deviation, >= 0
    tip_displacement : (3,) float [m] or None       of the contact point
    tip_displacement_std : (3,) float [m] or None   one standard deviation, > 0
    displacement : DisplacementField or None
    images : Images or None
    loads : tuple of Load           additional loads, known exactly
    support_displacement : DisplacementField or None    measured on the supports whose motion is
                                                        given
    support_motion : RigidMotion or None                that motion, given as a rigid motion instead
    force_sensor : str              name of the sensor that read the force, or of the weights that
                                    were the force; empty where a session has one sensor only
    series : Series or None         force and motion over time, from before the contact

    Raises
    ------
    InputError                      zero force without other loads; a motion given in both ways; a
                                    negative standard deviation, or one without its value; a wrong
                                    shape; displacements that are mostly a large rigid rotation
    """

    name: str
    contact: Contact
    force: Vector3
    force_std: Vector3 | None
    tip_displacement: Vector3 | None
    tip_displacement_std: Vector3 | None
    displacement: DisplacementField | None
    images: Images | None
    loads: tuple[Load, ...] = ()
    support_displacement: DisplacementField | None = None
    support_motion: RigidMotion | None = None
    force_sensor: str = ""
    series: Series | None = None

    def __post_init__(self) -> None:
        fix_fields(self, force=(3,))
        fix_fields(
            self, none_allowed=True, force_std=(3,), tip_displacement=(3,),
            tip_displacement_std=(3,),
        )  # fmt: skip
        if not np.any(self.force) and not self.loads:
            raise InputError(
                "force is zero; an unloaded object says nothing about its stiffness:"
                " give the total force of the tool on the object, in newtons"
            )
        if self.support_displacement is not None and self.support_motion is not None:
            raise InputError(
                "support_displacement and support_motion are both given; give one of the two"
            )
        for field in (self.displacement, self.support_displacement):
            if field is not None:
                measured = observed_rows(field)
                check_rotation(field.points[measured], field.displacement[measured], field.source)
        if self.force_std is not None and np.any(self.force_std < 0.0):
            raise InputError(f"force_std is {self.force_std.tolist()}; must not be negative")
        std = self.tip_displacement_std
        if std is not None and self.tip_displacement is None:
            raise InputError(
                "tip_displacement_std is given without tip_displacement; give both or none"
            )
        if std is not None and not np.all(std > 0.0):
            raise InputError(f"tip_displacement_std is {std.tolist()}; must be positive")

    def repeats(self, other: "Probing") -> bool:
        """Whether the tool pressed at the place of another probing and in its direction, with
        whatever force."""
        size = float(np.linalg.norm(self.force) * np.linalg.norm(other.force))
        here, there = self.contact, other.contact
        if here.triangles is not None and there.triangles is not None:
            at_one_place = np.array_equal(here.triangles, there.triangles)
        else:
            apart = float(np.linalg.norm(here.start - there.start))
            at_one_place = apart <= _NEAR * max(here.reach, there.reach)
        return at_one_place and float(self.force @ other.force) > _ALONG * size

    def __repr__(self) -> str:
        force = ", ".join(f"{x:.3g}" for x in self.force)
        observed = "not measured yet" if self.displacement is None else repr(self.displacement)
        return f"Probing {self.name!r}: ({force}) N at {place_text(self.contact.point)}; {observed}"


def check_rotation(
    points: Float[np.ndarray, "n 3"], displacement: Float[np.ndarray, "n 3"], source: str
) -> None:
    """Refuse displacements that are mostly a large rigid rotation.

    Parameters
    ----------
    points : (n, 3) float [m]           at rest
    displacement : (n, 3) float [m]     of each
    source : str                        file or pictures they come from, for the message

    Raises
    ------
    InputError                          a rotation of more than 0.5 rad; the text gives its angle
    """
    angle = rigid_rotation_angle(points, displacement)
    if angle > _LARGEST_ROTATION:
        raise InputError(
            f"{source}: the measured points turned by {np.degrees(angle):.0f} degrees as a whole"
            " between rest and load; displacements must be small, turns"
            f" {np.degrees(_LARGEST_ROTATION):.0f} degrees at most: did the object or the cameras"
            " move in between? Bring the loaded points back onto the resting ones by what did not"
            " deform (the support), or measure again with the object held"
        )


def rigid_rotation_angle(
    points: Float[np.ndarray, "n 3"], displacement: Float[np.ndarray, "n 3"]
) -> float:
    """Angle of the best-fitting rigid rotation of the points, if that explains most of the motion.

    Parameters
    ----------
    points : (n, 3) float [m]           at rest
    displacement : (n, 3) float [m]

    Returns
    -------
    float [rad]                         0 to pi; 0 if the motion is not mainly a rotation, or the
                                        points are too few or collinear, or seen by one camera

    Source
    ------
    Kabsch, Acta Cryst. A 32 (1976) 922, in scipy.
    """
    if len(points) < 3 or np.isnan(displacement).any():
        return 0.0
    before = points - points.mean(axis=0)
    after = before + displacement - displacement.mean(axis=0)
    spread = np.linalg.svd(before, compute_uv=False)
    if not spread[1] > _COLLINEAR * spread[0]:
        return 0.0
    rotation, residual = Rotation.align_vectors(after, before)
    moved = float(np.linalg.norm(after - before))
    return float(rotation.magnitude()) if residual < _MAX_UNEXPLAINED * moved else 0.0
