"""Contacts of tools: as wide as they touch, with their sideways pressure, and what differs.

Purpose    : loads of a tool's contact for given elastic constants, and the errors of the contact:
             its position, its radius, the mesh about it.
Takes      : a `Session`, a `BoundarySystem`, `ContactPatch`.
Gives      : sessions with the contact radii of their tools, columns of right-hand sides.
Depends on : `lab`, `bem`, `estimation`, `probe`, `records`, `geometry`.
Read first : `changes.py`, then `outward.py`.
"""

from palpate.pipeline.model.contacts.changes import (
    CHANGE_CELLS as CHANGE_CELLS,
    DIP_SHARE as DIP_SHARE,
    ContactChange as ContactChange,
    change_columns as change_columns,
    contact_changes as contact_changes,
    dip_changes as dip_changes,
    dip_columns as dip_columns,
    dipped_columns as dipped_columns,
    surface_load as surface_load,
)
from palpate.pipeline.model.contacts.outward import (
    leans_outward as leans_outward,
    outward_columns as outward_columns,
    outward_load as outward_load,
)
from palpate.pipeline.model.contacts.touched import (
    has_tools as has_tools,
    largest_change as largest_change,
    touched_session as touched_session,
)
