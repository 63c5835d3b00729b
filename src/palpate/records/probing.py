"""One probing: where the tool pressed, with what force, and how the surface moved."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, diags_array, kron

from palpate.arrays import fixed_array
from palpate.errors import InputError
from palpate.geometry import SurfacePoints
from palpate.records.contact import RIGID, Contact, RigidMotion
from palpate.records.large_turn import check_turn
from palpate.shapes import Flags, Indices, PointIndices, Points, Vector3

# Of a sum of some hundred weights.
_ROUNDING = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class PointCorrelation:
    """Correlation of the errors of pairs of points; points of no pair err independently.

    The same component of two points is correlated so, different ones are not.

    Parameters
    ----------
    pair : (m, 2) int           two points, each pair once and the lower number first
    value : (m,) float [-]      between -1 and 1

    Raises
    ------
    InputError                  another shape, a pair out of order, a value beyond one
    """

    pair: Int[np.ndarray, "m 2"]
    value: Float[np.ndarray, " m"]

    def __post_init__(self) -> None:
        pair = fixed_array(self.pair, name="pair", shape=(None, 2), integer=True)
        value = fixed_array(self.value, name="value", shape=(len(pair),))
        if (pair[:, 0] < 0).any() or (pair[:, 0] >= pair[:, 1]).any():
            raise InputError("pairs of correlated points must have the lower number first")
        # Sums of shares may leave rounding.
        if (np.abs(value) > 1.0 + 1e-9).any():
            raise InputError(f"a correlation of {np.abs(value).max():g} is more than 1")
        object.__setattr__(self, "pair", pair)
        object.__setattr__(self, "value", value)

    def among(self, rows: Indices, count: int) -> "PointCorrelation":
        """The same of some of `count` points, by their numbers among these.

        Parameters
        ----------
        rows : (k,) int         points that are kept, each once
        count : int
        """
        number = np.full(count, -1)
        number[rows] = np.arange(len(rows))
        pair = number[self.pair]
        kept = (pair >= 0).all(axis=1)
        return PointCorrelation(np.sort(pair[kept], axis=1), self.value[kept])

    def scaled(self, share: Float[np.ndarray, " n"]) -> "PointCorrelation":
        """The same where the correlated errors are a part of all errors.

        Parameters
        ----------
        share : (n,) float [-]  of each point's variance, 0 to 1
        """
        root = np.sqrt(share[self.pair].prod(axis=1))
        return PointCorrelation(self.pair, self.value * root)


INDEPENDENT = PointCorrelation(np.zeros((0, 2), dtype=np.int64), np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceAverage:
    """Displacements that are averages over the surface around, as windows of finite size see it.

    The displacement of point i is sum_j weights[3i:3i+3, 3j:3j+3] @ displacement of points[j];
    where a point has no weights it is that of the point itself.

    Parameters
    ----------
    points : (s, 3) float [m]       of the surface at rest
    weights : (3 n, 3 s) sparse [-] 3 x 3 blocks that add up to the unit matrix along every row, or
                                    to zero; kept in single precision

    Raises
    ------
    InputError                      shapes that differ, blocks that add up to something else
    """

    points: Points
    weights: csr_array

    def __post_init__(self) -> None:
        points = fixed_array(self.points, name="points", shape=(None, 3))
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "weights", csr_array(self.weights, dtype=np.float32))
        rows, columns = self.weights.shape
        if columns != 3 * len(points) or rows % 3:
            raise InputError(
                f"weights are {rows} x {columns}; must have three columns for each of the"
                f" {len(points)} points, and three rows for each displacement"
            )
        total = self._total()
        wrong = np.abs(total - np.eye(3) * self.given[:, None, None]).max(axis=(1, 2), initial=0.0)
        if (wrong > _ROUNDING).any():
            row = int(wrong.argmax())
            raise InputError(f"weights of displacement {row} add up to {total[row].tolist()}")

    @property
    def given(self) -> Flags:
        """True for the displacements that have weights, (n,) bool."""
        return np.diff(self.weights.indptr)[::3] > 0

    def _total(self) -> Float[np.ndarray, "n 3 3"]:
        return (self.weights @ np.tile(np.eye(3), (len(self.points), 1))).reshape(-1, 3, 3)

    def of(self, alone: csr_array, around: csr_array) -> csr_array:
        """The averages from the displacements of nodes, (3 n, 3 v) sparse.

        Parameters
        ----------
        alone : (n, v) sparse   each displacement's own point from the nodes
        around : (s, v) sparse  `points` from the nodes
        """
        unit = np.eye(3)
        left = diags_array((~self.given).astype(np.float64)) @ alone
        return csr_array(self.weights @ kron(around, unit) + kron(left, unit))

    def among(self, rows: Indices) -> "SurfaceAverage":
        """The same of some displacements.

        Parameters
        ----------
        rows : (k,) int
        """
        chosen = (3 * rows[:, None] + np.arange(3)).ravel()
        return SurfaceAverage(self.points, csr_array(self.weights[chosen]))

    def spread(self, rows: Indices, count: int) -> "SurfaceAverage":
        """The same as some of `count` displacements, the others without weights.

        Parameters
        ----------
        rows : (n,) int         where these go, rising
        count : int
        """
        entries = np.zeros(3 * count, dtype=np.int64)
        entries[(3 * rows[:, None] + np.arange(3)).ravel()] = np.diff(self.weights.indptr)
        starts = np.concatenate([[0], np.cumsum(entries)])
        content = self.weights.data, self.weights.indices, starts
        shape = 3 * count, self.weights.shape[1]
        return SurfaceAverage(self.points, csr_array(content, shape=shape))


@dataclass(frozen=True, slots=True, eq=False)
class DisplacementField:
    """Displacement of surface points between rest and load; NaN rows were not measured.

    Parameters
    ----------
    points : (n, 3) float [m]       at rest, as they were observed
    displacement : (n, 3) float [m] a row with any NaN is kept as a row of NaN: not measured
    std : (n, 3) float [m] or None  one standard deviation per component, > 0 where measured
    vertex : (n,) int or None       index of the mesh vertex, where the points are vertices
    surface : SurfacePoints         where the points sit on the mesh
    source : str                    file they came from, for messages
    scale_error : float [-]         relative standard deviation of all displacements together, which
                                    no single one shows; 0 where unknown
    covariance : (n, 3, 3) float [m^2] or None    of each point's displacement, with the squares of
                                    `std` on its diagonal; None: its components err independently
    correlation : PointCorrelation  of the errors of neighbouring points, where it is known
    average : SurfaceAverage or None    what each displacement is the average of; None: each is that
                                    of its point alone

    Raises
    ------
    InputError                      shapes that differ, a standard deviation that is not positive
    """

    points: Points
    displacement: Points
    std: Points | None
    vertex: PointIndices | None
    surface: SurfacePoints
    source: str
    scale_error: float = 0.0
    covariance: Float[np.ndarray, "n 3 3"] | None = None
    correlation: PointCorrelation = INDEPENDENT
    average: SurfaceAverage | None = None

    def __post_init__(self) -> None:
        points = fixed_array(self.points, name="points", shape=(None, 3))
        n = len(points)
        moved = np.array(
            fixed_array(self.displacement, name="displacement", shape=(n, 3), nan_allowed=True)
        )
        missing = ~measured_rows(moved)
        moved[missing] = np.nan
        moved.setflags(write=False)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "displacement", moved)
        if self.std is not None:
            std = fixed_array(self.std, name="std", shape=(n, 3), nan_allowed=True)
            bad = np.flatnonzero(~missing & ~(std > 0.0).all(axis=1))
            if len(bad):
                raise InputError(
                    f"std of {len(bad)} measured points is not positive, the first: row {bad[0]},"
                    f" {std[bad[0]].tolist()}; give one standard deviation in each component"
                )
            object.__setattr__(self, "std", std)
        if self.covariance is not None:
            covariance = fixed_array(
                self.covariance, name="covariance", shape=(n, 3, 3), nan_allowed=True
            )
            object.__setattr__(self, "covariance", covariance)
        if self.vertex is not None:
            vertex = fixed_array(self.vertex, name="vertex", shape=(n,), integer=True)
            object.__setattr__(self, "vertex", vertex)
        if len(self.surface.triangle) != n:
            raise InputError(f"surface has {len(self.surface.triangle)} points; must be {n}")
        if self.average is not None and self.average.weights.shape[0] != 3 * n:
            raise InputError(f"average has {self.average.weights.shape[0]} rows; must be {3 * n}")

    def __repr__(self) -> str:
        seen = observed_rows(self)
        length = np.linalg.norm(self.displacement[seen], axis=1)
        median = f", median {1e3 * np.median(length):.3g} mm" if len(length) else ""
        return f"DisplacementField: {len(seen)} points, {seen.sum()} measured{median}"


def measured_rows(displacement: Points) -> Flags:
    """True for the points that were measured, (n,) bool: no component is NaN.

    Parameters
    ----------
    displacement : (n, 3) float [m] NaN where not measured

    Returns
    -------
    (n,) bool
    """
    return ~np.isnan(displacement).any(axis=1)


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
    rest : str
    loaded : tuple of str           in time; the last one is at the full force
    """

    rest: str
    loaded: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """A load that acts besides the tool and is known exactly.

    Parameters
    ----------
    contact : Contact               not rigid
    force : (3,) float [N] or None  total force on the object
    pressure : float [Pa] or None   against the surface, > 0 pushes; over triangles only

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
        if self.force is not None:
            object.__setattr__(self, "force", fixed_array(self.force, name="force", shape=(3,)))
        size = self.pressure if self.force is None else self.force
        if not np.any(size):
            raise InputError("the load is zero; leave it out")


@dataclass(frozen=True, slots=True, eq=False)
class Probing:
    """One push of the tool with a known force, or other known loads, and what was observed.

    Parameters
    ----------
    name : str                      unique within its session
    contact : Contact
    force : (3,) float [N]          total force that the tool exerts on the object, not zero
    force_std : (3,) float [N] or None              one standard deviation, >= 0
    tip_displacement : (3,) float [m] or None       of the contact point
    tip_displacement_std : (3,) float [m] or None   one standard deviation, > 0
    displacement : DisplacementField or None
    images : Images or None
    loads : tuple of Load           that act besides, known exactly; with them the force may be zero
    support_displacement : DisplacementField or None    measured on the supports whose motion is
                                                        given
    support_motion : RigidMotion or None                the same as a rigid motion

    Raises
    ------
    InputError                      zero force and no other load, both ways to give a motion, a
                                    negative standard deviation, or one of nothing,
                                    wrong shape; measured points that turned far as a whole
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

    def __post_init__(self) -> None:
        for name in ("force", "force_std", "tip_displacement", "tip_displacement_std"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, fixed_array(value, name=name, shape=(3,)))
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
                seen = observed_rows(field)
                check_turn(field.points[seen], field.displacement[seen], field.source)
        if self.force_std is not None and np.any(self.force_std < 0.0):
            raise InputError(f"force_std is {self.force_std.tolist()}; must not be negative")
        std = self.tip_displacement_std
        if std is not None and self.tip_displacement is None:
            raise InputError(
                "tip_displacement_std is given without tip_displacement; give both or none"
            )
        if std is not None and not np.all(std > 0.0):
            raise InputError(f"tip_displacement_std is {std.tolist()}; must be positive")

    def __repr__(self) -> str:
        force = ", ".join(f"{x:.3g}" for x in self.force)
        point = ", ".join(f"{1e3 * x:.4g}" for x in self.contact.point)
        seen = "not measured yet" if self.displacement is None else repr(self.displacement)
        return f"Probing {self.name!r}: ({force}) N at ({point}) mm; {seen}"
