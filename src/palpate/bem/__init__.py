"""Boundary element model of a held elastic object.

Purpose    : compute how every point of an object moves under a load; one assembly serves all
             elastic constants.
Takes      : a closed triangle mesh, the triangles of its support, tractions on its free surface.
Gives      : `BoundarySystem` (equations for all materials, compressed for large bodies), right-hand
             sides, its `Solver`, `ElasticMap` (one material), interior displacement and stress.
Depends on : geometry; errors, threads.
Read first : `integrals/kelvin.py`, `system/system.py`, `elastic_map.py`.
"""

from palpate.bem.compressed.system import (
    LARGEST_DENSE as LARGEST_DENSE,
    CompressedSystem as CompressedSystem,
    check_memory as check_memory,
    held_system as held_system,
    memory_needed as memory_needed,
)
from palpate.bem.elastic_map import (
    ElasticMap as ElasticMap,
    make_elastic_map as make_elastic_map,
)
from palpate.bem.integrals.surface import (
    BoundarySurface as BoundarySurface,
    integral_weights as integral_weights,
    make_surface as make_surface,
)
from palpate.bem.interior import (
    InteriorState as InteriorState,
    interior_state as interior_state,
)
from palpate.bem.loads.half_space import (
    PressureDisc as PressureDisc,
    disc_displacement as disc_displacement,
    disc_potentials as disc_potentials,
)
from palpate.bem.loads.local_indentation import (
    IndentationCorrection as IndentationCorrection,
    correction_columns as correction_columns,
    indentation_corrections as indentation_corrections,
    load_right_hand as load_right_hand,
    missed_indentation as missed_indentation,
)
from palpate.bem.loads.right_hand import (
    BodyForce as BodyForce,
    RightHand as RightHand,
    body_force_columns as body_force_columns,
    dilation_factor as dilation_factor,
    face_columns as face_columns,
    pressure_column as pressure_column,
    support_columns as support_columns,
)
from palpate.bem.loads.surface_load import (
    LoadCells as LoadCells,
    SurfaceLoad as SurfaceLoad,
)
from palpate.bem.reduced_model import (
    CENTRE as CENTRE,
    DENSE_RESIDUAL as DENSE_RESIDUAL,
    SolutionModel as SolutionModel,
    make_reduced_model as make_reduced_model,
    make_spring_model as make_spring_model,
)
from palpate.bem.solver import (
    Solver as Solver,
    make_solver as make_solver,
)
from palpate.bem.system.factors import (
    CentredSystem as CentredSystem,
    FactorisedSystem as FactorisedSystem,
    factorise as factorise,
    solve as solve,
    unrestrained_motions as unrestrained_motions,
)
from palpate.bem.system.springs import (
    Springs as Springs,
    make_spring_factors as make_spring_factors,
    make_spring_system as make_spring_system,
    make_springs as make_springs,
)
from palpate.bem.system.system import (
    BoundarySystem as BoundarySystem,
    boundary_system as boundary_system,
)
