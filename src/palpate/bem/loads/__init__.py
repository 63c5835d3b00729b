"""Right-hand sides of the system.

Purpose    : integrate contact pressures, prescribed tractions, support displacements and gravity.
Takes      : a `BoundarySystem` and a `SurfaceLoad`, a traction, a displacement or a force density.
Gives      : `RightHand`, quadratic in Poisson's ratio; the local indentation around a contact.
Depends on : `bem.integrals`, `bem.system`, `geometry`.
Read first : `right_hand.py`, `surface_load.py`.
"""
