"""Rigid tools pressed into an estimated object, tick by tick, fast enough for touch.

A tick takes a state and the tools' new poses to the next state (`contact`).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from palpate.contact import (
    ContactState,
    PlacedTool,
    gaps,
    move_surface,
    move_tools,
    untouched,
)
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, inside
from palpate.shapes import Vertices
from palpate.simulation.green_functions import GreenFunctions


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
    for number, placed in enumerate(tools, start=1):
        depth = _depth(green.mesh, placed)
        if depth > 0.0:
            raise InputError(
                f"tool {number} is inside the object, {1e3 * depth:.3g} mm deep, before it is"
                " pressed in: nobody could say which way it came; start it outside and move it in"
            )
    return untouched(len(green.nodes), tools)


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
    rest = green.mesh.vertices[green.nodes]
    return move_tools(rest, green.compliance.reshape(rest.size, rest.size), tools, before)


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
        for forces, force_change in zip(by_compliance, change.T, strict=True):
            np.subtract.at(forces, state.tool_of[nodes], force_change.reshape(-1, 3))
    by_ratio, *by_map = by_compliance
    slopes = np.stack([state.tool_force / green.material.shear_modulus, by_ratio], axis=2)
    covariance = slopes @ green.material.covariance @ slopes.transpose(0, 2, 1)
    return covariance + sum(derivative[:, :, None] * derivative[:, None] for derivative in by_map)


def _directions(
    state: ContactState,
) -> tuple[Float[np.ndarray, "c m"], Float[np.ndarray, "c m"]]:
    """Prescribed directions of the touching nodes' displacement, and directions in which their
    forces may change."""
    rows, along = [], []
    for i, sticks in zip(state.touching, np.isin(state.touching, state.sticking), strict=True):
        normal, friction = state.normal[i], state.tools[state.tool_of[i]].tool.friction
        rows.append(np.eye(3) if sticks else normal[:, None])
        pull = friction * state.slide[i] if state.slide[i].any() else np.zeros(3)
        along.append(np.eye(3) if sticks else (normal - pull)[:, None])
    return block_diag(*rows), block_diag(*along)


def _depth(mesh: TriangleMesh, placed: PlacedTool) -> float:
    """Depth of a tool in an object at rest [m]; negative outside."""
    deepest = -float(gaps(placed, mesh.vertices)[0].min())
    if inside(mesh, np.asarray(placed.position, dtype=np.float64)[None])[0]:
        return max(deepest, placed.tool.reach)
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
