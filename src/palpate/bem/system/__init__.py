"""system."""

from palpate.bem.system.cache import cached_system as cached_system
from palpate.bem.system.memory import check_memory as check_memory
from palpate.bem.system.slope import SystemSlope as SystemSlope, system_slope as system_slope
from palpate.bem.system.surface_point import (
    PointEquations as PointEquations,
    point_equations as point_equations,
)
from palpate.bem.system.system import (
    PAIRS as PAIRS,
    BoundarySystem as BoundarySystem,
    FactorisedSystem as FactorisedSystem,
    assemble_system as assemble_system,
    factorise as factorise,
    restrict_collocation as restrict_collocation,
    solve as solve,
)
