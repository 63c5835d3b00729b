"""Integrals of Kelvin's solution over the surface, for every collocation point and every node.

Purpose    : compute the material-independent matrices of the boundary element method.
Takes      : a mesh and its held triangles, collocation points, the quadrature tolerance.
Gives      : `BoundarySurface`, `KernelIntegrals`; the layout and meaning of a kernel's fields.
Depends on : geometry; errors, threads.
Read first : `kelvin.py`, `assembly.py`.
"""
