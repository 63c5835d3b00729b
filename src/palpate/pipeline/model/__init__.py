"""The boundary element model of a session: its object, its supports, and their errors.

Purpose    : one model for all probings, and the observations of each as functions of its solutions.
Takes      : a `Session`.
Gives      : `ObjectModel`, the rows of a probing, motions of supports, nuisance parameters.
Depends on : `pipeline.model.contacts`, `solids`, `bem`, `estimation`, `probe`, `records`,
             `geometry`.
Read first : `object_model.py`, then `shared_errors.py`.
"""

from palpate.pipeline.model.compliant_supports import (
    compliances as compliances,
    compliant_supports as compliant_supports,
    session_springs as session_springs,
)
from palpate.pipeline.model.contacts import (
    OUTWARD_ERROR as OUTWARD_ERROR,
    RADIUS_ERROR as RADIUS_ERROR,
    displaced_contacts as displaced_contacts,
    has_tools as has_tools,
    largest_change as largest_change,
    outward_pushes as outward_pushes,
    settled_contact as settled_contact,
    surface_load as surface_load,
    with_contact_radii as with_contact_radii,
)
from palpate.pipeline.model.finite_strain import (
    make_finite_body as make_finite_body,
    strain_corrections as strain_corrections,
)
from palpate.pipeline.model.grading import (
    REMAINING_FRACTION as REMAINING_FRACTION,
    edge_refined_session as edge_refined_session,
    graded_session as graded_session,
    refined_session as refined_session,
)
from palpate.pipeline.model.large_strain import fit_at_finite_strain as fit_at_finite_strain
from palpate.pipeline.model.measurement_errors import space_stretch as space_stretch
from palpate.pipeline.model.moving_supports import (
    check_balance as check_balance,
    free_std as free_std,
    given_motion as given_motion,
    held_directions as held_directions,
    moving_supports as moving_supports,
    require_given_motions as require_given_motions,
    rigid_modes as rigid_modes,
    session_surface as session_surface,
    sliding_motion as sliding_motion,
)
from palpate.pipeline.model.object_model import (
    ObjectModel as ObjectModel,
    make_object_model as make_object_model,
)
from palpate.pipeline.model.probe_rows import probe_rows as probe_rows
from palpate.pipeline.model.responses import (
    ProbeResponse as ProbeResponse,
    full_responses as full_responses,
    reduced_responses as reduced_responses,
)
from palpate.pipeline.model.shared_errors import (
    pose_changes as pose_changes,
    shared_errors as shared_errors,
)
from palpate.pipeline.model.spring_responses import (
    settlement as settlement,
    spring_responses as spring_responses,
)
