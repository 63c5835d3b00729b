"""Integrals of Kelvin's solution over the surface, for every collocation point and every node.

Purpose    : compute the material-independent matrices of the boundary element method.
Takes      : a mesh and its held triangles, collocation points, the quadrature tolerance.
Gives      : `BoundarySurface`, `KernelIntegrals`; the layout and meaning of a kernel's fields.
Depends on : geometry; errors, threads.
Read first : `kelvin.py`, `assembly.py`.
"""

from palpate.bem.integrals.assembly import (
    Collocation as Collocation,
    FieldBlocks as FieldBlocks,
    KernelIntegrals as KernelIntegrals,
    add_rigid_body_sum as add_rigid_body_sum,
    all_rules as all_rules,
    kernel_integrals as kernel_integrals,
    lanes_of as lanes_of,
    point_blocks as point_blocks,
)
from palpate.bem.integrals.element_integrals import (
    next_part as next_part,
    part_point as part_point,
    whole_triangle as whole_triangle,
)
from palpate.bem.integrals.kelvin import (
    DISPLACEMENT as DISPLACEMENT,
    LANES as LANES,
    TRACTION as TRACTION,
    FieldLayout as FieldLayout,
    add_point_fields as add_point_fields,
    check_material as check_material,
    displacement_parts as displacement_parts,
    lane_fields as lane_fields,
    traction_parts as traction_parts,
)
from palpate.bem.integrals.quadrature import (
    Quadrature as Quadrature,
    triangle_rule as triangle_rule,
    unit_gauss as unit_gauss,
)
from palpate.bem.integrals.surface import (
    BoundarySurface as BoundarySurface,
    SurfaceSettings as SurfaceSettings,
    integral_weights as integral_weights,
    make_surface as make_surface,
)
