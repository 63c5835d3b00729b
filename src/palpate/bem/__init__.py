"""Boundary element model of a held elastic object.

Purpose    : how every point of an object moves under a load, for all materials at once.
Takes      : a closed triangle mesh, the triangles of its support, tractions on its free surface.
Gives      : `BoundarySystem` (material-free matrices), `ElasticMap` (one material), right-hand
           sides.
Depends on : errors, geometry.
Read first : `kelvin.py` (what is integrated), `system.py` (what is solved), `elastic_map.py` (what
comes out).
"""

from palpate.bem.body_force import BodyForce, body_force_columns, dilation_factor
from palpate.bem.contact_shape import ContactShape
from palpate.bem.elastic_map import (
    ElasticMap,
    ElasticState,
    load_right_hand,
    load_shape,
    make_elastic_map,
)
from palpate.bem.half_space import PressureDisc
from palpate.bem.interior import InteriorState, interior_state
from palpate.bem.memory import check_memory
from palpate.bem.quadrature import Quadrature
from palpate.bem.right_hand import RightHand, joined, support_columns, traction_column
from palpate.bem.surface import BoundarySurface, SurfaceSettings, make_surface
from palpate.bem.surface_load import SurfaceLoad
from palpate.bem.surface_point import PointEquations, point_equations
from palpate.bem.system import (
    BoundarySystem,
    FactorisedSystem,
    assemble_system,
    factorise,
    solve,
)
from palpate.bem.system_cache import cached_system
from palpate.bem.system_slope import SystemSlope, system_slope

__all__ = [
    "BodyForce",
    "BoundarySurface",
    "BoundarySystem",
    "ContactShape",
    "ElasticMap",
    "ElasticState",
    "FactorisedSystem",
    "InteriorState",
    "PointEquations",
    "PressureDisc",
    "Quadrature",
    "RightHand",
    "SurfaceLoad",
    "SurfaceSettings",
    "SystemSlope",
    "assemble_system",
    "body_force_columns",
    "cached_system",
    "check_memory",
    "dilation_factor",
    "factorise",
    "interior_state",
    "joined",
    "load_right_hand",
    "load_shape",
    "make_elastic_map",
    "make_surface",
    "point_equations",
    "solve",
    "support_columns",
    "system_slope",
    "traction_column",
]
