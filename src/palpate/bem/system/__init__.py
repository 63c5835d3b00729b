"""The linear system of a held object.

Purpose    : set up and solve the boundary integral equations for the unknowns of an object.
Takes      : a `BoundarySurface`.
Gives      : `BoundarySystem`, its matrix, factorisation and derivative with respect to Poisson's
             ratio, equations at further surface points, compliant supports.
Depends on : `bem.integrals`, `geometry`.
Read first : `system.py`, `matrix.py`.
"""
