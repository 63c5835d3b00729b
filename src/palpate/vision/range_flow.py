"""Range flow: the 3-D displacement of the surface seen by the reference camera, on a pixel grid;
and the contract of a method that measures it.
"""

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
from palpate.vision.surface_map import SurfaceMap

# Tolerance for rounding in a sum of four interpolation weights.
_ROUNDING = 1e-9


class Outcome(IntEnum):
    """Outcome of matching a surface point; every value but `VALID` is a reason for rejection."""

    VALID = 0
    HIDDEN = 1  # seen at rest by fewer than two cameras
    TEXTURE = 2  # too little contrast to be tracked
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
    covariance : (n, 3, 3) float [m^2]  of the displacement, noise plus bias; NaN where rejected
    bias : (n, 3, 3) float [m^2]        the part of the covariance that neighbouring points share:
                                        systematic matching error; NaN where rejected
    score : (n,) float [-]              lowest normalised cross-correlation over the cameras used
    reprojection : (n,) float [px]      rms difference between the common displacement as projected
                                        into each camera and the one that camera alone measures
    cameras : (n,) int                  number of cameras that agreed
    outcome : (n,) int                  an `Outcome`
    through_last : (n,) bool            matched via the previous instant, because the picture has
                                        become too different from the first one there
    drift : float [m]                   rms difference between the direct displacement and the one
                                        via the previous instant, over points matched both ways;
                                        NaN where there are none
    noise : (c,) float [grey levels]    standard deviation of each camera's pixel noise
    subset : int [px]                   side of the window (subset)
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
    count : (v,) int                    number of range-flow points used for each vertex
    correlation : PointCorrelation      of the errors of neighbouring vertices
    average : SurfaceAverage or None    the weighted average of the surface's displacement that each
                                        value represents; None: the vertex's own displacement
    """

    displacement: Float[np.ndarray, "v 3"]
    covariance: Float[np.ndarray, "v 3 3"]
    count: Int[np.ndarray, " v"]
    correlation: PointCorrelation = INDEPENDENT
    average: SurfaceAverage | None = None


@runtime_checkable
class FlowMethod(Protocol):
    """A method of measuring range flow: a frozen dataclass whose fields are its settings.

    Every method must satisfy the following, and one test checks them all: no motion gives zero
    displacement, a rigid motion is recovered at points and vertices, the same input gives the same
    output, and `follow` does not modify the state passed to it.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def subset(self) -> int:
        """Side of the window that is matched [px]."""
        ...

    def start(
        self, rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]], surface: TriangleMesh
    ) -> Any:
        """Process the first instant and choose the points to track.

        Parameters
        ----------
        rig : Rig                       with the object's pose at the first instant
        pictures : sequence of c (rows, columns) float [grey levels]    in the rig's order
        surface : TriangleMesh          of the object at the first instant

        Returns
        -------
        state                           opaque; its type is the method's own

        Raises
        ------
        InputError, CalibrationError    pictures or cameras that the method cannot use
        """
        ...

    def follow(
        self, state: Any, pictures: Sequence[Float[np.ndarray, "_ _"]]
    ) -> tuple[Any, RangeFlow]:
        """Track the points to the next instant.

        Parameters
        ----------
        state                           of the previous instant
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
        self, displacement: VertexDisplacement, flow: RangeFlow, rig: Rig, surface: TriangleMesh
    ) -> VertexDisplacement:
        """Add the averaging of the surface's displacement by the windows, if the method knows it.

        Parameters
        ----------
        displacement : VertexDisplacement      from `vertices`
        flow : RangeFlow
        rig : Rig                       as given to `start`
        surface : TriangleMesh          as given to `start`

        Returns
        -------
        VertexDisplacement              `displacement` with its `average` set, or unchanged
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
    """Number of points rejected for each cause.

    Parameters
    ----------
    flow : RangeFlow

    Returns
    -------
    dict of str to int              keyed by the cause's lower-case name, in the order of `Outcome`;
                                    causes with count zero are included
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
    """Surface points seen at the pixels of a regular grid.

    Parameters
    ----------
    surface : SurfaceMap                the surface point behind each pixel of the camera
    shown : (rows, columns) bool        pixels that may be used
    vertices, triangles : (v, 3) float [m], (m, 3) int
    step : int [px]                     spacing of the grid; its first row and column are step // 2

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
    """Triangulate points on a pixel grid: two triangles for every cell with all four corners.

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

    Both are interpolated bilinearly between the four surrounding points. These are about a quarter
    of a window apart, so their errors are strongly correlated and interpolation does not reduce the
    standard deviation.

    Parameters
    ----------
    flow : RangeFlow

    Returns
    -------
    displacement : (rows, columns, 3) float32 [m]   NaN where one of the four points was rejected
    sigma : (rows, columns) float32 [m]             square root of the covariance's trace
    """
    rows, columns = flow.shape
    maps = np.full((5, rows, columns), np.nan)
    valid = is_valid(flow)
    if valid.any():
        offset = flow.pixel[valid][0] % flow.step
        cell = np.rint((flow.pixel[valid] - offset) / flow.step).astype(int)
        low, high = cell.min(axis=0), cell.max(axis=0)
        # The last plane is the weight of valid points: 1 where every point of non-zero weight is.
        grid = np.zeros((5, *(high - low + 1)[::-1]))
        sigma = np.sqrt(np.trace(flow.covariance[valid], axis1=1, axis2=2))
        values = np.vstack([flow.displacement[valid].T, sigma, np.ones(len(sigma))])
        grid[:, cell[:, 1] - low[1], cell[:, 0] - low[0]] = values
        start = np.rint(offset + flow.step * low).astype(int)
        stop = np.minimum(start + flow.step * (high - low) + 1, [columns, rows])
        row, column = np.mgrid[start[1] : stop[1], start[0] : stop[0]]
        position = [(row - start[1]) / flow.step, (column - start[0]) / flow.step]
        maps[:, row, column] = [
            map_coordinates(plane, position, order=1, mode="nearest") for plane in grid
        ]
        maps[:, maps[4] < 1.0 - _ROUNDING] = np.nan
    return np.moveaxis(maps[:3], 0, -1).astype(np.float32), maps[3].astype(np.float32)
