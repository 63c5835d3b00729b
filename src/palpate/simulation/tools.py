"""Rigid tools that move freely, and their poses.

The tips of the virtual facility move along one axis; a haptic tool also rotates and approaches from
any side. Any convex shape can be given as planes, by `convex_tool`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, convex_planes
from palpate.shapes import Matrix3, Vector3
from palpate.simulation.kernels.state import FACES, SPHERE, ToolArrays

# Sides of the prism that approximates a round punch.
_SIDES = 48
# Largest deviation of an entry of R R^T from the identity.
_ROTATION_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball about the origin of its frame.

    Parameters
    ----------
    radius : float [m]              > 0

    Raises
    ------
    InputError                      a radius that is not positive
    """

    radius: float

    def __post_init__(self) -> None:
        _check_length("radius of the sphere", self.radius)

    @property
    def kind(self) -> int:
        """Kind of tool for the kernels: `SPHERE`."""
        return SPHERE

    @property
    def bounding_radius(self) -> float:
        """Its radius [m]."""
        return self.radius

    @property
    def planes(self) -> Float[np.ndarray, "p 4"]:
        """No planes, (0, 4)."""
        return np.zeros((0, 4))


@dataclass(frozen=True, slots=True, eq=False)
class ConvexTool:
    """The convex body bounded by planes.

    Parameters
    ----------
    planes : (p, 4) float           outward unit normals, and the offset along each [m]
    bounding_radius : float [m]     of a ball about the origin that contains the body
    """

    planes: Float[np.ndarray, "p 4"]
    bounding_radius: float

    @property
    def kind(self) -> int:
        """Kind of tool for the kernels: `FACES`."""
        return FACES

    @property
    def radius(self) -> float:
        """Zero: only a sphere has one."""
        return 0.0


def flat_punch(radius: float, length: float) -> ConvexTool:
    """A round rod with a flat end at the origin, along +z; it presses towards -z.

    Parameters
    ----------
    radius : float [m]              > 0; of the circumscribed circle of a prism of 48 sides
    length : float [m]              > 0

    Returns
    -------
    ConvexTool

    Raises
    ------
    InputError                      a length that is not positive
    """
    _check_length("radius of the punch", radius)
    _check_length("length of the punch", length)
    angle = 2 * np.pi * (np.arange(_SIDES) + 0.5) / _SIDES
    across = radius * np.cos(np.pi / _SIDES)
    sides = np.column_stack(
        [np.cos(angle), np.sin(angle), np.zeros(_SIDES), np.full(_SIDES, across)]
    )
    ends = np.array([[0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 1.0, length]])
    return ConvexTool(np.concatenate([ends, sides]), float(np.hypot(radius, length)))


def convex_tool(mesh: TriangleMesh) -> ConvexTool:
    """A tool of the shape of a convex mesh, in the mesh's own frame.

    Parameters
    ----------
    mesh : TriangleMesh             closed, convex

    Returns
    -------
    ConvexTool                      coplanar triangles are one face

    Raises
    ------
    InputError                      a mesh that is flat, open or not convex
    """
    planes = convex_planes(mesh)
    return ConvexTool(planes, float(np.linalg.norm(mesh.vertices, axis=1).max()))


@dataclass(frozen=True, slots=True, eq=False)
class PlacedTool:
    """A tool and its pose in the object's frame.

    Parameters
    ----------
    tool : Sphere or ConvexTool
    position : (3,) float [m]       of the origin of its frame
    rotation : (3, 3) float         from its frame to the object's
    friction : float                Coulomb coefficient; 0: slides freely, infinite: sticks

    Raises
    ------
    InputError                      a matrix that is no rotation, a negative coefficient
    """

    tool: Sphere | ConvexTool
    position: Vector3
    rotation: Matrix3 = field(default_factory=lambda: np.eye(3))
    friction: float = 0.0

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, dtype=np.float64)
        square = rotation.shape == (3, 3)
        deviation = np.abs(rotation @ rotation.T - np.eye(3)).max() if square else np.inf
        if not deviation <= _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
            raise InputError(f"rotation is {rotation.tolist()}; must be a rotation, (3, 3)")
        if not self.friction >= 0.0:
            raise InputError(
                f"friction is {self.friction}; must be 0 (slides), a coefficient, or infinite"
                " (sticks)"
            )


def tool_arrays(now: Sequence[PlacedTool], previous: Sequence[PlacedTool]) -> ToolArrays:
    """Tools in the layout of the kernels.

    Parameters
    ----------
    now : sequence of t PlacedTool
    previous : sequence of t PlacedTool     the same tools at the previous tick

    Returns
    -------
    ToolArrays
    """
    tools = [one.tool for one in now]
    start = np.cumsum([0, *(len(tool.planes) for tool in tools)])
    return ToolArrays(
        kind=np.array([tool.kind for tool in tools]),
        start=start,
        radius=np.array([tool.radius for tool in tools]),
        bounding_radius=np.array([tool.bounding_radius for tool in tools]),
        planes=np.concatenate([np.zeros((0, 4)), *(tool.planes for tool in tools)]),
        friction=np.array([float(one.friction) for one in now]),
        position=np.array([one.position for one in now], dtype=np.float64),
        rotation=np.array([one.rotation for one in now], dtype=np.float64),
        previous_position=np.array([one.position for one in previous], dtype=np.float64),
        previous_rotation=np.array([one.rotation for one in previous], dtype=np.float64),
    )


def _check_length(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0.0):
        raise InputError(f"{name} is {value}; must be positive, in metres")
