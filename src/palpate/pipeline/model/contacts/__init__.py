"""Contacts of tools: as wide as they touch, with their sideways pressure, and what differs.

Purpose    : what a tool does to the surface, for some elastic constants, and what its contact may
             be off by: its place, its radius, the mesh about it.
Takes      : a `Session`, a `BoundarySystem`, `ContactPatch`.
Gives      : sessions with touched circles, columns of right-hand sides.
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
