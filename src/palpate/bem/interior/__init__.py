"""Displacement and stress inside a loaded object.

Purpose    : show where an object is strained, from the solution on its surface.
Takes      : an `ElasticMap`, a load with its force, points inside.
Gives      : `InteriorState`.
Depends on : bem's integrals, loads and elastic map; geometry; errors.
Read first : `interior.py`, `somigliana.py`.
"""

from palpate.bem.interior.interior import (
    InteriorState as InteriorState,
    interior_state as interior_state,
)
