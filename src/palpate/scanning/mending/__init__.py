"""Repair of broken surfaces to the boundary of one solid.

Purpose    : repair surfaces from scanners, 3-D printing files or CAD programs that are open,
             duplicated, folded or inverted; reject what cannot be repaired, with place and reason.
Takes      : `TriangleMesh`, closed or not; the plane that the object stood on.
Gives      : `Mended` with its `Action`s; `Deviation` between two surfaces.
Depends on : `geometry`; libigl, manifold3d and Mmg.
Read first : `mend.py`, then `cleaning.py`, `pieces.py`, `holes.py`, `solid.py`.
"""
