"""Solids of finite elements, and the rigid tips that are pressed into them.

Purpose    : solve the contact of a rigid tip with a supported body, to a depth or to a force.
Takes      : a closed surface, held triangles, elastic constants, a tip with a depth or a force.
Gives      : nodal forces and displacements, and their values at points of the surface.
Depends on : `contact`, `geometry`, `records`; scikit-fem for the elements.
Read first : `finite_elements.py`, `contact.py`, then `tips.py`, `tetrahedra.py`.
"""

from palpate.solids.contact import (
    Press as Press,
    press as press,
    press_to_force as press_to_force,
)
from palpate.solids.finite_contact import (
    FinitePress as FinitePress,
    Sag as Sag,
    press_finite as press_finite,
    press_slopes as press_slopes,
)
from palpate.solids.finite_elements import (
    Body as Body,
    half_space_compliance as half_space_compliance,
    held_nodes as held_nodes,
    inner_points as inner_points,
    linear_displacement as linear_displacement,
    make_body as make_body,
    nodal_volumes as nodal_volumes,
    pressure_load as pressure_load,
    solve_load as solve_load,
    surface_values as surface_values,
)
from palpate.solids.finite_strain import (
    Law as Law,
    LawOf as LawOf,
    NeoHookean as NeoHookean,
    SplitNeoHookean as SplitNeoHookean,
    dilation_slope as dilation_slope,
    load_slopes as load_slopes,
    solve_finite as solve_finite,
    yeoh as yeoh,
)
from palpate.solids.graded_body import (
    GradedBody as GradedBody,
    GradedStiffness as GradedStiffness,
    make_graded_body as make_graded_body,
    with_moduli as with_moduli,
)
from palpate.solids.sizes import (
    body_memory as body_memory,
    check_solid_size as check_solid_size,
    node_count as node_count,
)
from palpate.solids.tetrahedra import (
    Solid as Solid,
    boundary_surface as boundary_surface,
    make_solid as make_solid,
    quadratic_solid as quadratic_solid,
)
from palpate.solids.tips import (
    Tip as Tip,
)
