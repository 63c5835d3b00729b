"""Fusion of the views of an object into one surface.

Purpose    : a closed surface through the points of all views, with its standard deviation.
Takes      : `View`s; points with normals and sigmas in one frame.
Gives      : `TriangleMesh`; `FittedSurface`; the agreement of each view with the others.
Depends on : `geometry`, `scanning.mending`, `scanning.views`; libigl.
Read first : `fusion.py`, then `vertex_fit.py`.
"""
