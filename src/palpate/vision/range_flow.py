"""Range flow: the 3-D displacement of the surface seen by the reference camera, on a pixel grid."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import map_coordinates

from palpate.geometry import TriangleMesh
from palpate.records import INDEPENDENT, PointCorrelation, Rig, SurfaceAverage
from palpate.shapes import Flags, PointIndices, Points, PointScalars, Triangles, Vertices
from palpate.vision.cameras import SurfaceMap

# Rounding in a sum of four weights.
_ROUNDING = 1e-9


class Outcome(IntEnum):
    """What became of a point of the surface; everything but `VALID` is a reason to reject."""

    VALID = 0
    HIDDEN = 1  # seen at rest by fewer than two cameras
    TEXTURE = 2  # too little contrast to be followed
    OUTSIDE = 3  # left the picture
    LOST = 4  # the search did not converge
    SCORE = 5  # looks different when loaded: covered by the tool, a highlight, a shadow
    REPROJECTION = 6  # the cameras contradict each other
    NEIGHBOURS = 7  # contradicts the motion around it


# Reasons to reject, in the order of `Outcome`.
CAUSES = tuple(outcome for outcome in Outcome if outcome is not Outcome.VALID)


@dataclass(frozen=True, slots=True, eq=False)
class RangeFlow:
    """Displacement with covariance at points of the surface between two instants.

    Attributes
    ----------
    pixel : (n, 2) float [px]           column and row in the reference camera, first instant
    point : (n, 3) float [m]            on the surface at the first instant, object frame
    tangent : (n, 2, 3) float [-]       two orthonormal tangents of the surface there
    displacement : (n, 3) float [m]     NaN where rejected
    gradient : (n, 2, 3) float [-]      derivative of the displacement along each tangent; NaN where
                                        rejected or not measured by the method
    covariance : (n, 3, 3) float [m^2]  of the displacement, noise and bias; NaN where rejected
    bias : (n, 3, 3) float [m^2]        the part of it that neighbouring points share: systematic
                                        error of the cameras' matches; NaN where rejected
    score : (n,) float [-]              lowest normalised cross-correlation over the cameras used
    reprojection : (n,) float [px]      rms distance between the common displacement seen in each
                                        camera and what that camera alone would measure
    cameras : (n,) int                  how many cameras agreed
    outcome : (n,) int                  an `Outcome`
    through_last : (n,) bool            followed through the instant before, because the first
                                        picture has become too different there
    drift : float [m]                   rms difference between the direct displacement and the one
                                        through the instant before, over points followed both ways;
                                        NaN where there is none
    noise : (c,) float [grey levels]    standard deviation of each camera's pixel noise
    subset : int [px]                   side of the window
    step : int [px]                     spacing of the points in the reference camera
    shape : (rows, columns)             of the reference camera's picture
    """

    pixel: Float[np.ndarray, "n 2"]
    point: Points
    tangent: Float[np.ndarray, "n 2 3"]
    displacement: Points
    gradient: Float[np.ndarray, "n 2 3"]
    covariance: Float[np.ndarray, "n 3 3"]
    bias: Float[np.ndarray, "n 3 3"]
    score: PointScalars
    reprojection: PointScalars
    cameras: PointIndices
    outcome: PointIndices
    through_last: Flags
    drift: float
    noise: Float[np.ndarray, " c"]
    subset: int
    step: int
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class VertexDisplacement:
    """Displacement of the vertices of the object's mesh.

    Attributes
    ----------
    displacement : (v, 3) float [m]     NaN where not measured
    covariance : (v, 3, 3) float [m^2]  NaN where not measured
    count : (v,) int                    points of the range flow that it rests on
    correlation : PointCorrelation      of the errors of neighbouring vertices
    average : SurfaceAverage or None    what each displacement is the average of; None: that of the
                                        vertex alone
    """

    displacement: Float[np.ndarray, "v 3"]
    covariance: Float[np.ndarray, "v 3 3"]
    count: Int[np.ndarray, " v"]
    correlation: PointCorrelation = INDEPENDENT
    average: SurfaceAverage | None = None


@runtime_checkable
class FlowMethod(Protocol):
    """A method of measuring range flow: a frozen dataclass whose fields are its settings.

    Its laws, which one test holds every method to: no motion gives no displacement, a rigid motion
    is recovered at points and vertices, the same input gives the same output, and `follow` leaves
    the state that it is given as it was.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def start(
        self, rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]], surface: TriangleMesh
    ) -> Any:
        """Take in the first instant and choose the points to follow.

        Parameters
        ----------
        rig : Rig                       with the object's pose at the first instant
        pictures : sequence of c (rows, columns) float [grey levels]    in the rig's order
        surface : TriangleMesh          of the object at the first instant

        Returns
        -------
        state                           known to the method alone

        Raises
        ------
        InputError, CalibrationError    pictures or cameras that the method cannot use
        """
        ...

    def follow(
        self, state: Any, pictures: Sequence[Float[np.ndarray, "_ _"]]
    ) -> tuple[Any, RangeFlow]:
        """Follow the points to the next instant.

        Parameters
        ----------
        state                           of the instant before
        pictures : sequence of c (rows, columns) float [grey levels]

        Returns
        -------
        state                           of this instant
        flow : RangeFlow                from the first instant to this one

        Raises
        ------
        InputError                      pictures that the method cannot use
        """
        ...

    def vertices(self, flow: RangeFlow, rig: Rig, surface: TriangleMesh) -> VertexDisplacement:
        """Displacement of the mesh's vertices from range flow of any method.

        Parameters
        ----------
        flow : RangeFlow
        rig : Rig                       as given to `start`
        surface : TriangleMesh          as given to `start`

        Returns
        -------
        VertexDisplacement
        """
        ...

    def averaged(
        self, found: VertexDisplacement, flow: RangeFlow, rig: Rig, surface: TriangleMesh
    ) -> VertexDisplacement:
        """The same with what each displacement is the average of, as far as the method knows.

        Parameters
        ----------
        found : VertexDisplacement      from `vertices`
        flow : RangeFlow
        rig : Rig                       as given to `start`
        surface : TriangleMesh          as given to `start`

        Returns
        -------
        VertexDisplacement
        """
        ...


def is_valid(flow: RangeFlow) -> Flags:
    """True for the points whose displacement was accepted.

    Parameters
    ----------
    flow : RangeFlow                of n points

    Returns
    -------
    (n,) bool
    """
    return flow.outcome == Outcome.VALID


def cause_counts(flow: RangeFlow) -> dict[str, int]:
    """How many points were rejected for each cause.

    Parameters
    ----------
    flow : RangeFlow

    Returns
    -------
    dict of str to int              by the cause's name in lower case, in the order of `Outcome`;
                                    zeros included
    """
    return {cause.name.lower(): int((flow.outcome == cause).sum()) for cause in CAUSES}


def measured_vertices(vertices: VertexDisplacement) -> Flags:
    """True for vertices that have a displacement.

    Parameters
    ----------
    vertices : VertexDisplacement   of v vertices

    Returns
    -------
    (v,) bool
    """
    return np.isfinite(vertices.displacement).all(axis=1)


def grid_points(
    surface: SurfaceMap,
    shown: Bool[np.ndarray, "rows columns"],
    vertices: Vertices,
    triangles: Triangles,
    step: int,
) -> tuple[Int[np.ndarray, "n 2"], Points, Float[np.ndarray, "n 2 3"]]:
    """Points of a surface behind the pixels of a grid.

    Parameters
    ----------
    surface : SurfaceMap                what the camera sees of the surface
    shown : (rows, columns) bool        pixels that may be used
    vertices, triangles : (v, 3) float [m], (m, 3) int
    step : int [px]                     spacing of the grid, which begins at half of it

    Returns
    -------
    pixel : (n, 2) int [px]             column and row
    point : (n, 3) float [m]
    tangent : (n, 2, 3) float           two orthonormal tangents
    """
    begin = step // 2
    row, column = np.nonzero(shown[begin::step, begin::step])
    row, column = begin + step * row, begin + step * column
    corner = vertices[triangles[surface.triangle[row, column]]]
    along = corner[:, 1] - corner[:, 0]
    along = along / np.linalg.norm(along, axis=1)[:, None]
    normal = np.cross(along, corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    point = np.ascontiguousarray(surface.point[row, column], dtype=np.float64)
    tangent = np.stack([along, np.cross(normal, along)], axis=1)
    return np.stack([column, row], axis=1), point, tangent


def grid_triangles(pixel: Float[np.ndarray, "n 2"], step: int) -> Triangles:
    """Triangles between points on a pixel grid: two for every cell that has all four corners.

    Parameters
    ----------
    pixel : (n, 2) float [px]       column, row
    step : int [px]                 spacing of the grid

    Returns
    -------
    (m, 3) int
    """
    if len(pixel) == 0:
        return np.zeros((0, 3), dtype=np.int64)
    cell = np.rint((pixel - pixel.min(axis=0)) / step).astype(np.int64)
    number = np.full(cell.max(axis=0) + 2, -1)
    number[cell[:, 0], cell[:, 1]] = np.arange(len(pixel))
    corner = np.stack([number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]])
    whole = corner[:, (corner >= 0).all(axis=0)]
    return np.concatenate([whole[[0, 2, 1]].T, whole[[1, 2, 3]].T])


def dense_maps(
    flow: RangeFlow,
) -> tuple[Float[np.ndarray, "rows columns 3"], Float[np.ndarray, "rows columns"]]:
    """Displacement and its standard deviation at the pixels of the reference camera.

    Bilinear between the four points around a pixel: they are a quarter of a window apart, so their
    errors are nearly the same and the error of a pixel is no smaller than theirs.

    Parameters
    ----------
    flow : RangeFlow

    Returns
    -------
    displacement : (rows, columns, 3) float32 [m]   NaN where one of the four points was rejected
    sigma : (rows, columns) float32 [m]             root of the covariance's trace
    """
    rows, columns = flow.shape
    maps = np.full((5, rows, columns), np.nan)
    valid = is_valid(flow)
    if valid.any():
        offset = flow.pixel[valid][0] % flow.step
        cell = np.rint((flow.pixel[valid] - offset) / flow.step).astype(int)
        low, high = cell.min(axis=0), cell.max(axis=0)
        # The last plane tells where all four are there: a missing one of no weight does no harm.
        grid = np.zeros((5, *(high - low + 1)[::-1]))
        sigma = np.sqrt(np.trace(flow.covariance[valid], axis1=1, axis2=2))
        values = np.vstack([flow.displacement[valid].T, sigma, np.ones(len(sigma))])
        grid[:, cell[:, 1] - low[1], cell[:, 0] - low[0]] = values
        start = np.rint(offset + flow.step * low).astype(int)
        stop = np.minimum(start + flow.step * (high - low) + 1, [columns, rows])
        row, column = np.mgrid[start[1] : stop[1], start[0] : stop[0]]
        place = [(row - start[1]) / flow.step, (column - start[0]) / flow.step]
        maps[:, row, column] = [
            map_coordinates(plane, place, order=1, mode="nearest") for plane in grid
        ]
        maps[:, maps[4] < 1.0 - _ROUNDING] = np.nan
    return np.moveaxis(maps[:3], 0, -1).astype(np.float32), maps[3].astype(np.float32)
