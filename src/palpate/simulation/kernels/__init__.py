"""Kernels of rigid contact on Green's functions: what a tick of a haptic loop does.

Purpose    : find the forces of tools on an object in a fraction of a millisecond.
Takes      : `ToolArrays`, compliance between the nodes, `Nodal` of the tick before.
Gives      : `Nodal` at rest, changed in place; displacement of the surface.
Depends on : nothing but the ground floor.
Read first : `state.py`, `settle.py`, then `friction.py`, `nodes.py`.
"""

from palpate.simulation.kernels.linear import move_surface as move_surface
from palpate.simulation.kernels.nodes import tool_gap as tool_gap
from palpate.simulation.kernels.settle import add_resultants as add_resultants, settle as settle
from palpate.simulation.kernels.state import (
    FACES as FACES,
    OPEN as OPEN,
    SPHERE as SPHERE,
    STICKS as STICKS,
    Nodal as Nodal,
    ToolArrays as ToolArrays,
)
