"""bodies."""

from palpate.lab.bodies.contact import (
    Press as Press,
    Tip as Tip,
    press as press,
    press_to_force as press_to_force,
)
from palpate.lab.bodies.finite_elements import (
    Body as Body,
    held_nodes as held_nodes,
    make_body as make_body,
    surface_values as surface_values,
)
from palpate.lab.bodies.neo_hookean import solve_finite as solve_finite
from palpate.lab.bodies.specimens import (
    SHAPES as SHAPES,
    cylinder as cylinder,
    half_ball as half_ball,
    rod as rod,
)
from palpate.lab.bodies.tetrahedra import make_solid as make_solid
