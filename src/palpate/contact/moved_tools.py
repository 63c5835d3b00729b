"""Rigid tools moved into an object, step by step, and the equilibrium after each step.

The object is a set of nodes and their compliance, whoever computed it: finite elements for the
virtual bench, boundary elements for an object that is touched in real time. A step starts from the
contacts before it, and so takes a fraction of a millisecond where the tools move little.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.contact.response import FACES, ROUND, SPHERE, STICKS, Nodal, ToolArrays
from palpate.contact.settle import add_resultants, settle, tool_gaps
from palpate.errors import InputError, NotConvergedError
from palpate.records import RoundTool, Sphere, Tool
from palpate.shapes import Matrix3, Points, PointScalars, Vector3

# Tolerance relative to the largest nodal force, and largest number of rounds to reach it.
_TOLERANCE, _MAX_ROUNDS = 1e-9, 120
# Fewer nodes under a tool do not resolve its contact (with six, its force is 20 % too high).
_FEW_NODES = 10
# Largest deviation of an entry of R R^T from the identity.
_ROTATION_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class PlacedTool:
    """A tool and its pose in the object's frame.

    Parameters
    ----------
    tool : Tool                     convex
    position : (3,) float [m]       of the origin of its frame
    rotation : (3, 3) float         from its frame to the object's; it presses towards its -z

    Raises
    ------
    InputError                      a matrix that is no rotation
    """

    tool: Tool
    position: Vector3
    rotation: Matrix3 = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, dtype=np.float64)
        square = rotation.shape == (3, 3)
        deviation = np.abs(rotation @ rotation.T - np.eye(3)).max() if square else np.inf
        if not deviation <= _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
            raise InputError(f"rotation is {rotation.tolist()}; must be a rotation, (3, 3)")


@dataclass(frozen=True, slots=True, eq=False)
class ContactState:
    """Tools on an object in equilibrium.

    Attributes
    ----------
    tools : tuple of t PlacedTool
    tool_force : (t, 3) float [N]       force on each tool
    torque : (t, 3) float [N m]         on each tool, about its position
    force : (n, 3) float [N]            of the tools on the nodes
    displacement : (n, 3) float [m]     of the nodes
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
        """Nodes under a tool."""
        return np.flatnonzero(self.tool_of >= 0)

    @property
    def resolved(self) -> Bool[np.ndarray, " t"]:
        """Whether each tool touches no node, or at least ten: with fewer, its force depends on
        the mesh and is too high."""
        count = np.bincount(self.tool_of[self.touching], minlength=len(self.tools))
        return (count == 0) | (count >= _FEW_NODES)

    @property
    def sticking(self) -> Int[np.ndarray, " k"]:
        """Touching nodes that stick."""
        return np.flatnonzero((self.tool_of >= 0) & (self.status == STICKS))


def untouched(count: int, tools: Sequence[PlacedTool]) -> ContactState:
    """An object at rest, with tools that do not touch it yet.

    Parameters
    ----------
    count : int                         n, of the object's nodes
    tools : sequence of t PlacedTool

    Returns
    -------
    ContactState
    """
    none, still = np.zeros((count, 3)), np.full(count, -1)
    zero, zeros = np.zeros((len(tools), 3)), 0 * still
    nodal = Nodal(none, none, still, still, zeros, zeros, none, none, none, np.zeros(count))
    return ContactState(tuple(tools), zero, zero, *nodal[:-1], np.zeros((0, 0)), 0)


def move_tools(
    rest: Points,
    compliance: Float[np.ndarray, "c c"],
    tools: Sequence[PlacedTool],
    before: ContactState,
) -> ContactState:
    """Move tools to their present poses, and find the equilibrium.

    Friction depends on the path: move in steps that are small compared with the contact. Without
    friction the result does not depend on the steps.

    Parameters
    ----------
    rest : (n, 3) float [m]             nodes of the object
    compliance : (3 n, 3 n) float [m/N] of these nodes, symmetric
    tools : sequence of t PlacedTool    the same as before, in new poses
    before : ContactState               of the previous step

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
    state = [getattr(before, name).copy() for name in Nodal._fields[:-1]]
    nodal = Nodal._make([*state, np.zeros(len(rest))])
    rounds, response, changes = settle(
        arrays, rest, compliance, before.response, before.changes, nodal, _TOLERANCE, _MAX_ROUNDS
    )
    if not rounds:
        raise NotConvergedError(
            f"the contact does not settle in {_MAX_ROUNDS} rounds; move the tools in smaller steps"
        )
    tool_force, torque = np.zeros((2, len(tools), 3))
    add_resultants(arrays, rest, nodal, tool_force, torque)
    return ContactState(tuple(tools), tool_force, torque, *nodal[:-1], response, changes)


def gaps(placed: PlacedTool, points: Points) -> tuple[PointScalars, Points]:
    """Distance of points from a tool.

    Parameters
    ----------
    placed : PlacedTool
    points : (n, 3) float [m]

    Returns
    -------
    gap : (n,) float [m]                negative inside the tool
    normal : (n, 3) float [-]           outward unit normal of the tool there
    """
    return tool_gaps(tool_arrays([placed], [placed]), points)


def tool_arrays(now: Sequence[PlacedTool], previous: Sequence[PlacedTool]) -> ToolArrays:
    """Tools in the layout of the kernels.

    Parameters
    ----------
    now : sequence of t PlacedTool
    previous : sequence of t PlacedTool     the same tools before

    Returns
    -------
    ToolArrays
    """
    tools = [placed.tool for placed in now]
    faces = [tool.faces for tool in tools]
    return ToolArrays(
        kind=np.array([_kind(tool) for tool in tools]),
        start=np.cumsum([0, *(len(triangles) for triangles in faces)]),
        radius=np.array([tool.radius for tool in tools]),
        reach=np.array([tool.reach for tool in tools]),
        faces=np.concatenate(faces),
        friction=np.array([float(tool.friction) for tool in tools]),
        position=np.array([placed.position for placed in now], dtype=np.float64),
        rotation=np.array([placed.rotation for placed in now], dtype=np.float64),
        previous_position=np.array([placed.position for placed in previous], dtype=np.float64),
        previous_rotation=np.array([placed.rotation for placed in previous], dtype=np.float64),
    )


def _kind(tool: Tool) -> int:
    """What the kernels take a tool for."""
    if isinstance(tool, Sphere):
        return SPHERE
    return ROUND if isinstance(tool, RoundTool) else FACES
