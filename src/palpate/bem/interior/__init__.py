"""Displacement and stress inside a loaded object.

Purpose    : compute displacement and stress at interior points from the solution on the surface.
Takes      : an `ElasticMap`, a load with its force, interior points.
Gives      : `InteriorState`.
Depends on : `bem.integrals`, `bem.loads`, `geometry`.
Read first : `interior.py`, `somigliana.py`.
"""
