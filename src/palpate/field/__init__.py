"""Bodies whose shear modulus differs from place to place: a field of moduli with its evidence.

Purpose    : responses of a body of any field of moduli, a Gaussian prior of such fields, and how
             much likelier the data are with one than without.
Takes      : a `Session`, its `ProbeObservations` with the homogeneous model.
Gives      : `ModulusField`; observations with the field's response and its coefficients as errors
             that all probings share.
Depends on : `solids`, `estimation`, `probe`, `geometry`, `records`.
Read first : `field_prior.py`, `field_responses.py`, then `field_fit.py`; of pokes without pictures
             `poke_responses.py`.
"""

from palpate.field.elements import (
    no_field_reason as no_field_reason,
    nodal_load as nodal_load,
)
from palpate.field.explanations import (
    Cause as Cause,
    Explanation as Explanation,
    evidence_of_errors as evidence_of_errors,
    explanations as explanations,
)
from palpate.field.field_fit import (
    DECISIVE as DECISIVE,
    fit_field as fit_field,
)
from palpate.field.field_map import (
    FieldPosterior as FieldPosterior,
    make_map_response as make_map_response,
)
from palpate.field.field_responses import UnevenBody as UnevenBody
from palpate.field.inclusions import fit_inclusions as fit_inclusions
from palpate.field.poke_responses import (
    PokeModel as PokeModel,
    PokeResponse as PokeResponse,
    dents as dents,
    growths as growths,
    make_poke_model as make_poke_model,
    tools as tools,
)
from palpate.field.regions import (
    RegionFit as RegionFit,
    check_regions as check_regions,
    fit_regions as fit_regions,
)
