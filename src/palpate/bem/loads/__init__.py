"""Right-hand sides of the system.

Purpose    : integrate contact pressures, prescribed tractions, support displacements and gravity.
Takes      : a `BoundarySystem` and a `SurfaceLoad`, a traction, a displacement or a force density.
Gives      : `RightHand`, quadratic in Poisson's ratio; the local indentation around a contact.
Depends on : `bem.compressed`, `bem.integrals`, `bem.system`, `geometry`.
Read first : `right_hand.py`, `surface_load.py`, `load_integrals.py`.
"""

from palpate.bem.loads.body_force import (
    BodyForce as BodyForce,
    body_force_columns as body_force_columns,
    dilation_factor as dilation_factor,
)
from palpate.bem.loads.half_space import (
    PressureDisc as PressureDisc,
    disc_displacement as disc_displacement,
    disc_potentials as disc_potentials,
)
from palpate.bem.loads.load_integrals import integrate_load as integrate_load
from palpate.bem.loads.local_indentation import (
    IndentationCorrection as IndentationCorrection,
    correction_columns as correction_columns,
    indentation_corrections as indentation_corrections,
)
from palpate.bem.loads.right_hand import (
    RightHand as RightHand,
    face_columns as face_columns,
    joined as joined,
    load_columns as load_columns,
    pressure_column as pressure_column,
    support_columns as support_columns,
    traction_column as traction_column,
)
from palpate.bem.loads.surface_load import (
    LOAD_CELLS as LOAD_CELLS,
    LoadCells as LoadCells,
    SurfaceLoad as SurfaceLoad,
    load_points as load_points,
)
