"""Range flow: the 3-D displacement of the surface seen by the reference camera."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int

from palpate.shapes import Flags, PointIndices, Points, PointScalars


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
    bias : (n, 3, 3) float [m^2]        the part of it that points side by side share: systematic
                                        error of the cameras' matches; NaN where rejected
    score : (n,) float [-]              lowest normalised cross-correlation over the cameras used
    reprojection : (n,) float [px]      rms distance between the common displacement seen in each
                                        camera and what that camera alone would say
    cameras : (n,) int                  how many cameras agreed
    outcome : (n,) int                  an `Outcome`
    through_last : (n,) bool            followed through the instant before, because the first
                                        picture has become too different there
    drift : float [m]                   rms difference between the two ways, where both were gone;
                                        NaN where none was
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


def is_valid(flow: RangeFlow) -> Flags:
    """True for the points whose displacement was accepted, (n,) bool."""
    return flow.outcome == Outcome.VALID


@dataclass(frozen=True, slots=True, eq=False)
class VertexDisplacement:
    """Displacement of the vertices of the object's mesh.

    Attributes
    ----------
    displacement : (v, 3) float [m]     NaN where not measured
    covariance : (v, 3, 3) float [m^2]  NaN where not measured
    count : (v,) int                    points of the range flow that it rests on
    """

    displacement: Float[np.ndarray, "v 3"]
    covariance: Float[np.ndarray, "v 3 3"]
    count: Int[np.ndarray, " v"]


def cause_counts(flow: RangeFlow) -> dict[str, int]:
    """How many points were rejected for each cause, by its name in lower case; zeros included."""
    return {cause.name.lower(): int((flow.outcome == cause).sum()) for cause in CAUSES}


def measured_vertices(vertices: VertexDisplacement) -> Flags:
    """True for vertices that have a displacement, (v,) bool."""
    return np.isfinite(vertices.displacement).all(axis=1)
