"""Contacts of tools: their place, their radius, their outward traction, and their errors.

Purpose    : loads of a tool's contact for given elastic constants, and the errors of the contact:
             its position, its radius, the mesh about it.
Takes      : a `Session`, a `BoundarySystem`, `ContactPatch`.
Gives      : sessions with the places and radii of their tools' contacts, columns of right-hand
             sides.
Depends on : `solids`, `bem`, `estimation`, `probe`, `records`, `geometry`.
Read first : `perturbations.py`, then `outward.py`.
"""
