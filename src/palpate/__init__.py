"""Palpate: elastic constants of a soft object from probings with a known force.

Purpose    : estimate shear modulus, Poisson's ratio and Young's modulus, each with an interval.
Takes      : a session folder (closed triangle mesh, support, probings with displacements).
Gives      : an estimate with intervals, a likelihood over the constants, residuals per probing.
Depends on : nothing of its own; numpy, scipy, numba and what else `pyproject.toml` names.
Read first : `records/session.py`, then `pipeline/fit_session.py`; docs/developer/map.md.

Importing this root is cheap and does nothing else: the rooms are imported by their own names.
"""

__version__ = "0.1.0"
