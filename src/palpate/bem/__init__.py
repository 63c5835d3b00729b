"""Boundary element model of a held elastic object.

Purpose    : compute how every point of an object moves under a load; one assembly serves all
             elastic constants.
Takes      : a closed triangle mesh, the triangles of its support, tractions on its free surface.
Gives      : `BoundarySystem` (equations for all materials, compressed for large bodies),
             right-hand sides, `ElasticMap` (one material), interior displacement and stress.
Depends on : geometry; errors, threads.
Read first : `integrals/kelvin.py`, `system/system.py`, `elastic_map.py`.
"""

from palpate.bem.compressed import (
    CompressedSystem as CompressedSystem,
    Compression as Compression,
    ReducedBasis as ReducedBasis,
    compressed_system as compressed_system,
    held_system as held_system,
    orthogonalised as orthogonalised,
    reduced_basis as reduced_basis,
)
from palpate.bem.elastic_map import (
    ElasticMap as ElasticMap,
    ElasticState as ElasticState,
    load_right_hand as load_right_hand,
    make_elastic_map as make_elastic_map,
)
from palpate.bem.integrals import (
    BoundarySurface as BoundarySurface,
    Quadrature as Quadrature,
    SurfaceSettings as SurfaceSettings,
    integral_weights as integral_weights,
    make_surface as make_surface,
)
from palpate.bem.interior import InteriorState as InteriorState, interior_state as interior_state
from palpate.bem.loads import (
    LOAD_CELLS as LOAD_CELLS,
    BodyForce as BodyForce,
    IndentationCorrection as IndentationCorrection,
    LoadCells as LoadCells,
    PressureDisc as PressureDisc,
    RightHand as RightHand,
    SurfaceLoad as SurfaceLoad,
    body_force_columns as body_force_columns,
    correction_columns as correction_columns,
    dilation_factor as dilation_factor,
    disc_displacement as disc_displacement,
    disc_potentials as disc_potentials,
    face_columns as face_columns,
    indentation_corrections as indentation_corrections,
    joined as joined,
    pressure_column as pressure_column,
    support_columns as support_columns,
    traction_column as traction_column,
)
from palpate.bem.reduced_model import (
    CENTRE as CENTRE,
    DENSE_RESIDUAL as DENSE_RESIDUAL,
    ReducedModel as ReducedModel,
    SolutionModel as SolutionModel,
    make_reduced_model as make_reduced_model,
    make_spring_model as make_spring_model,
)
from palpate.bem.system import (
    LARGEST_DENSE as LARGEST_DENSE,
    BoundarySystem as BoundarySystem,
    CentredSystem as CentredSystem,
    FactorisedSystem as FactorisedSystem,
    PointEquations as PointEquations,
    SpringFactors as SpringFactors,
    Springs as Springs,
    SpringSlope as SpringSlope,
    SpringSystem as SpringSystem,
    SystemSlope as SystemSlope,
    boundary_system as boundary_system,
    check_memory as check_memory,
    factorise as factorise,
    make_spring_factors as make_spring_factors,
    make_spring_system as make_spring_system,
    make_springs as make_springs,
    memory_needed as memory_needed,
    point_equations as point_equations,
    solve as solve,
    spring_columns as spring_columns,
    system_slope as system_slope,
    unrestrained_motions as unrestrained_motions,
)
