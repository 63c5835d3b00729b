"""Rigid tools pressed into an object, tick by tick: no penetration, no adhesion, friction.

A tick takes a state and the tools' new poses to the next state. It starts from the contacts of the
tick before, and so takes a fraction of a millisecond.

The tips of the virtual facility move along one axis; a haptic tool also rotates and approaches from
any side. Any convex shape can be given as planes, by `convex_tool`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import block_diag

from palpate.errors import InputError, NotConvergedError
from palpate.geometry import TriangleMesh, convex_planes, inside
from palpate.shapes import Matrix3, Vector3, Vertices
from palpate.simulation.contact_response import (
    FACES,
    SPHERE,
    STICKS,
    Nodal,
    ToolArrays,
    move_surface,
)
from palpate.simulation.green_functions import GreenFunctions
from palpate.simulation.settle import add_resultants, settle, tool_gap

# Tolerance relative to the largest nodal force, and largest number of rounds to reach it.
_TOLERANCE, _MAX_ROUNDS = 1e-9, 120
# Fewer nodes under a tool do not resolve its contact (with six, its force is 20 % too high).
FEW_NODES = 10
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


@dataclass(frozen=True, slots=True, eq=False)
class ContactState:
    """Tools on an object in equilibrium.

    Attributes
    ----------
    tools : tuple of t PlacedTool
    tool_force : (t, 3) float [N]       force on each tool
    torque : (t, 3) float [N m]         on each tool, about its position
    force : (n, 3) float [N]            of the tools on the nodes of the Green's functions
    displacement : (n, 3) float [m]     of these nodes
    tool_of : (n,) int                  tool that each node touches; -1: none
    face : (n,) int                     face of the tool through which the node entered
    status : (n,) int                   1: it slides, 2: it sticks
    given : (n,) int                    what `response` takes of the node: 0: nothing, 1: its force,
                                        2: its displacement
    anchor : (n, 3) float [m]           point of the tool, in its frame, at which it sticks or was
                                        last
    normal : (n, 3) float               of the tool there
    slide : (n, 3) float                direction in which it slides under friction; else zero
    response : (c, c) float             of the nodes of which something is given: displacement [m]
                                        for force [N], or force for displacement
    changes : int                       of the touching nodes since `response` was built anew
    """

    tools: tuple[PlacedTool, ...]
    tool_force: Float[np.ndarray, "t 3"]
    torque: Float[np.ndarray, "t 3"]
    force: Float[np.ndarray, "n 3"]
    displacement: Float[np.ndarray, "n 3"]
    tool_of: Int[np.ndarray, " n"]
    face: Int[np.ndarray, " n"]
    status: Int[np.ndarray, " n"]
    given: Int[np.ndarray, " n"]
    anchor: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    slide: Float[np.ndarray, "n 3"]
    response: Float[np.ndarray, "c c"]
    changes: int

    @property
    def touching(self) -> Int[np.ndarray, " k"]:
        """Nodes under a tool, among those of the Green's functions."""
        return np.flatnonzero(self.tool_of >= 0)

    @property
    def resolved(self) -> Bool[np.ndarray, " t"]:
        """Whether each tool touches no node, or at least `FEW_NODES`: with fewer, its force depends
        on the mesh and is too high."""
        count = np.bincount(self.tool_of[self.touching], minlength=len(self.tools))
        return (count == 0) | (count >= FEW_NODES)

    @property
    def sticking(self) -> Int[np.ndarray, " k"]:
        """Touching nodes that stick."""
        return np.flatnonzero((self.tool_of >= 0) & (self.status == STICKS))


def start_contact(green: GreenFunctions, tools: Sequence[PlacedTool]) -> ContactState:
    """The object at rest with tools that do not touch it yet.

    Parameters
    ----------
    green : GreenFunctions
    tools : sequence of t PlacedTool    outside the object

    Returns
    -------
    ContactState

    Raises
    ------
    InputError                          no tools, or one that is inside the object
    """
    if not tools:
        raise InputError("there is no tool; give at least one")
    arrays = tool_arrays(tools, tools)
    for t in range(len(tools)):
        depth = _depth(green.mesh, arrays, t)
        if depth > 0.0:
            raise InputError(
                f"tool {t + 1} is inside the object, {1e3 * depth:.3g} mm deep, before it is"
                " pressed in: nobody could say which way it came; start it outside and move it in"
            )
    count = len(green.nodes)
    none = np.zeros((count, 3))
    still = np.full(count, -1)
    zero = np.zeros((len(tools), 3))
    zeros = 0 * still
    nodal = Nodal(none, none, still, still, zeros, zeros, none, none, none, np.zeros(count))
    return ContactState(tuple(tools), zero, zero, *nodal[:-1], np.zeros((0, 0)), 0)


def touch(green: GreenFunctions, tools: Sequence[PlacedTool], before: ContactState) -> ContactState:
    """Move the tools to their present poses, and find the equilibrium.

    Friction depends on the path: move in steps that are small compared with the contact. Without
    friction the result does not depend on the steps.

    Parameters
    ----------
    green : GreenFunctions
    tools : sequence of t PlacedTool    the same as before, in new poses
    before : ContactState               of the previous tick

    Returns
    -------
    ContactState

    Raises
    ------
    InputError                          other tools than before
    NotConvergedError                   no equilibrium is found in 120 rounds
    """
    if len(tools) != len(before.tools) or any(
        a.tool is not b.tool for a, b in zip(tools, before.tools, strict=True)
    ):
        raise InputError("the tools are others than before; begin anew with start_contact")
    arrays = tool_arrays(tools, before.tools)
    rest = green.mesh.vertices[green.nodes]
    kept = [getattr(before, name).copy() for name in Nodal._fields[:-1]]
    nodal = Nodal._make([*kept, np.zeros(len(rest))])
    square = green.compliance.reshape(rest.size, rest.size)
    rounds, response, changes = settle(
        arrays, rest, square, before.response, before.changes, nodal, _TOLERANCE, _MAX_ROUNDS
    )
    if not rounds:
        raise NotConvergedError(
            f"the contact does not settle in {_MAX_ROUNDS} rounds; move the tools in smaller steps"
        )
    tool_force, torque = np.zeros((2, len(tools), 3))
    add_resultants(arrays, rest, nodal, tool_force, torque)
    return ContactState(tuple(tools), tool_force, torque, *nodal[:-1], response, changes)


def force_covariance(green: GreenFunctions, state: ContactState) -> Float[np.ndarray, "t 3 3"]:
    """Covariance of the force on each tool, from that of the elastic constants and of where the
    modulus differs.

    The poses are exact. Forces are proportional to the shear modulus. Their derivatives with
    respect to all else follow from the equations of the touching nodes, with the set of these nodes
    and the directions of their forces kept.

    Parameters
    ----------
    green : GreenFunctions
    state : ContactState

    Returns
    -------
    (t, 3, 3) float [N^2]
    """
    # Of the compliance, by Poisson's ratio and by where the modulus differs.
    derivatives = [green.slope, *green.changes]
    by_compliance = np.zeros((len(derivatives), *state.tool_force.shape))
    nodes = state.touching
    if nodes.size:
        rows, along = _directions(state)
        block, *parts = (
            part[nodes][:, :, nodes].reshape(3 * len(nodes), -1)
            for part in (green.compliance, *derivatives)
        )
        force = state.force[nodes].ravel()
        extra = np.stack([rows.T @ part @ force for part in parts], axis=1)
        change = along @ np.linalg.solve(rows.T @ block @ along, -extra)
        for forces, each in zip(by_compliance, change.T, strict=True):
            np.subtract.at(forces, state.tool_of[nodes], each.reshape(-1, 3))
    by_ratio, *by_map = by_compliance
    slopes = np.stack([state.tool_force / green.material.shear_modulus, by_ratio], axis=2)
    covariance = slopes @ green.material.covariance @ slopes.transpose(0, 2, 1)
    return covariance + sum(each[:, :, None] * each[:, None] for each in by_map)


def _directions(
    state: ContactState,
) -> tuple[Float[np.ndarray, "c m"], Float[np.ndarray, "c m"]]:
    """Prescribed directions of the touching nodes' displacement, and directions in which their
    forces may change."""
    rows, along = [], []
    for i in state.touching:
        normal, friction = state.normal[i], state.tools[state.tool_of[i]].friction
        sticks = state.status[i] == STICKS
        rows.append(np.eye(3) if sticks else normal[:, None])
        pull = friction * state.slide[i] if state.slide[i].any() else np.zeros(3)
        along.append(np.eye(3) if sticks else (normal - pull)[:, None])
    return block_diag(*rows), block_diag(*along)


def _depth(mesh: TriangleMesh, arrays: ToolArrays, t: int) -> float:
    """Depth of a tool in an object at rest [m]; negative outside."""
    normal = np.empty(3)
    local = (mesh.vertices - arrays.position[t]) @ arrays.rotation[t]
    deepest = -min(tool_gap(arrays, t, -1, point, normal)[0] for point in local)
    if inside(mesh, arrays.position[t][None])[0]:
        return max(deepest, float(arrays.bounding_radius[t]))
    return deepest


def surface_displacement(green: GreenFunctions, state: ContactState) -> Vertices:
    """Displacement of the whole surface under tools.

    Parameters
    ----------
    green : GreenFunctions
    state : ContactState

    Returns
    -------
    (v, 3) float [m]
    """
    count, _, vertices, _ = green.surface.shape
    out = np.empty(3 * vertices)
    surface = green.surface.reshape(count, 3, 3 * vertices)
    move_surface(surface, state.touching, state.force, out)
    return out.reshape(vertices, 3)


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
