"""Kernels of rigid contact on Green's functions: what a tick of a haptic loop does.

Purpose    : find the forces of tools on an object in a fraction of a millisecond.
Takes      : `ToolArrays`, compliance between the nodes, `Nodal` of the tick before.
Gives      : `Nodal` at rest, changed in place; displacement of the surface.
Depends on : nothing but the ground floor.
Read first : `state.py`, `settle.py`, then `friction.py`, `nodes.py`.
"""
