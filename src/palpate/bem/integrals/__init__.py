"""integrals."""

from palpate.bem.integrals.assembly import (
    Collocation as Collocation,
    FieldBlocks as FieldBlocks,
    assemble as assemble,
    with_rigid_body_sum as with_rigid_body_sum,
)
from palpate.bem.integrals.element_integrals import surface_point as surface_point
from palpate.bem.integrals.kelvin import (
    DISPLACEMENT_FIELDS as DISPLACEMENT_FIELDS,
    LANES as LANES,
    TRACTION_FIELDS as TRACTION_FIELDS,
    check_material as check_material,
    displacement_fields as displacement_fields,
)
from palpate.bem.integrals.quadrature import (
    ELEMENT_NODES as ELEMENT_NODES,
    Quadrature as Quadrature,
    element_points as element_points,
    element_spheres as element_spheres,
    quadratic_shapes as quadratic_shapes,
    quadratic_slopes as quadratic_slopes,
    triangle_rule as triangle_rule,
    unit_gauss as unit_gauss,
)
from palpate.bem.integrals.surface import (
    BoundarySurface as BoundarySurface,
    SurfaceSettings as SurfaceSettings,
    integral_weights as integral_weights,
    make_surface as make_surface,
)
