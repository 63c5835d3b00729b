"""Contacts of tools: their place, their radius, their outward traction, and their errors.

Purpose    : loads of a tool's contact for given elastic constants, and the errors of the contact:
             its position, its radius, the mesh about it.
Takes      : a `Session`, a `BoundarySystem`, `ContactPatch`.
Gives      : sessions with the places and radii of their tools' contacts, columns of right-hand
             sides.
Depends on : `solids`, `bem`, `estimation`, `probe`, `records`, `geometry`.
Read first : `perturbations.py`, then `outward.py`.
"""

from palpate.pipeline.model.contacts.contact_errors import (
    contact_error as contact_error,
    tool_slip as tool_slip,
)
from palpate.pipeline.model.contacts.contact_radii import (
    has_tools as has_tools,
    largest_change as largest_change,
    settled_contact as settled_contact,
    with_contact_radii as with_contact_radii,
)
from palpate.pipeline.model.contacts.outward import (
    OUTWARD_ERROR as OUTWARD_ERROR,
    has_outward_traction as has_outward_traction,
    outward_load as outward_load,
    outward_perturbations as outward_perturbations,
    outward_pushes as outward_pushes,
)
from palpate.pipeline.model.contacts.perturbations import (
    DIP_ERROR as DIP_ERROR,
    RADIUS_ERROR as RADIUS_ERROR,
    ContactPerturbation as ContactPerturbation,
    contact_perturbations as contact_perturbations,
    dip_perturbations as dip_perturbations,
    named_tangents as named_tangents,
    surface_load as surface_load,
)
from palpate.pipeline.model.contacts.sideways import displaced_contacts as displaced_contacts
