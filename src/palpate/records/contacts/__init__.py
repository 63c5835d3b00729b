"""Contacts of tools.

Purpose    : what presses, where, and how its pressure is distributed.
Takes      : shapes and sizes of tools, points, radii.
Gives      : `Contact`, `Tool`, `PressureMap`, pressure profiles.
Depends on : `geometry`, `arrays`, `shapes`, `errors`.
Read first : `contact.py`.
"""

from palpate.records.contacts.contact import (
    CONE as CONE,
    CYLINDER as CYLINDER,
    FLAT as FLAT,
    FRICTIONS as FRICTIONS,
    MESH as MESH,
    SLIDES as SLIDES,
    SPHERE as SPHERE,
    STICKS as STICKS,
    TOOL_SHAPES as TOOL_SHAPES,
    Contact as Contact,
    Tool as Tool,
    mesh_tool as mesh_tool,
)
from palpate.records.contacts.pressure import (
    PRESSURES as PRESSURES,
    RIGID as RIGID,
    UNIFORM as UNIFORM,
    VERTEX as VERTEX,
    Pressure as Pressure,
    PressureMap as PressureMap,
    cone_pressure as cone_pressure,
    contact_profiles as contact_profiles,
    smooth_pressure as smooth_pressure,
)
