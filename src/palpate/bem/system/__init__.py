"""The linear system of a held object.

Purpose    : set up and solve the boundary integral equations for the unknowns of an object.
Takes      : a `BoundarySurface`.
Gives      : `BoundarySystem`, its matrix, factorisation and derivative with respect to Poisson's
             ratio, equations at further surface points, compliant supports.
Depends on : `bem.integrals`, `geometry`.
Read first : `system.py`, `boundary.py`.
"""

from palpate.bem.system.boundary import (
    Unknowns as Unknowns,
    find_unknowns as find_unknowns,
    place_collocation as place_collocation,
)
from palpate.bem.system.centred_system import CentredSystem as CentredSystem
from palpate.bem.system.factors import (
    FactorisedSystem as FactorisedSystem,
    factorise as factorise,
    solve as solve,
)
from palpate.bem.system.matrix import (
    held_columns as held_columns,
    matrix_and_slope as matrix_and_slope,
    system_matrix as system_matrix,
)
from palpate.bem.system.memory import (
    LARGEST_DENSE as LARGEST_DENSE,
    check_memory as check_memory,
    memory_needed as memory_needed,
)
from palpate.bem.system.rollers import unrestrained_motions as unrestrained_motions
from palpate.bem.system.slope import SystemSlope as SystemSlope, system_slope as system_slope
from palpate.bem.system.springs import (
    SpringFactors as SpringFactors,
    Springs as Springs,
    SpringSlope as SpringSlope,
    SpringSystem as SpringSystem,
    make_spring_factors as make_spring_factors,
    make_spring_system as make_spring_system,
    make_springs as make_springs,
    spring_columns as spring_columns,
)
from palpate.bem.system.surface_point import (
    PointEquations as PointEquations,
    point_equations as point_equations,
)
from palpate.bem.system.system import (
    BoundarySystem as BoundarySystem,
    boundary_system as boundary_system,
    equations_at as equations_at,
    for_each_block as for_each_block,
    restricted_nodes as restricted_nodes,
)
