"""Range flow: the 3-D displacement of the surface seen by the reference camera, on a pixel grid.

With the contract of a method that measures it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from palpate.geometry import TriangleMesh
from palpate.records import INDEPENDENT, PointCorrelation, Rig, SurfaceAverage
from palpate.shapes import Flags, PointIndices, Points, PointScalars


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
        self, found: VertexDisplacement, flow: RangeFlow, rig: Rig, surface: TriangleMesh
    ) -> VertexDisplacement:
        """Add the averaging of the surface's displacement by the windows, if the method knows it.

        Parameters
        ----------
        found : VertexDisplacement      from `vertices`
        flow : RangeFlow
        rig : Rig                       as given to `start`
        surface : TriangleMesh          as given to `start`

        Returns
        -------
        VertexDisplacement              `found` with its `average` set, or unchanged
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
