"""The boundary integral equations of large bodies: an operator in place of the dense matrices.

Purpose    : solve bodies of tens of thousands of vertices in memory and time that grow with their
             number, for all materials at once.
Takes      : a `BoundarySurface`, right-hand sides.
Gives      : `CompressedSystem` (a `BoundarySystem` without matrices), iterative solutions.
Depends on : `bem.system`, `bem.integrals`, `geometry`.
Read first : `operator.py`, then `far_field.py`; `system.py`, `iterative.py`.
"""
