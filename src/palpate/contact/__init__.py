"""Contact of rigid tools with an object whose compliance is known: no penetration, no adhesion,
friction.

Purpose    : take tools from one place to the next, and find the equilibrium of the touching nodes.
Takes      : nodes at rest, their compliance, and tools in their poses.
Gives      : `ContactState`: forces and displacements of the nodes, and what touches which tool.
Depends on : `records`, `shapes`, `errors`.
Read first : `moved_tools.py`, then `settle.py`, `friction.py`, `response.py`.
"""

from palpate.contact.moved_tools import (
    ContactState as ContactState,
    PlacedTool as PlacedTool,
    gaps as gaps,
    move_tools as move_tools,
    untouched as untouched,
)
from palpate.contact.response import move_surface as move_surface
