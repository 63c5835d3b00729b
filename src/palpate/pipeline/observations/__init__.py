"""Observations of a session's probings, with the responses of their model.

Purpose    : measurement and model of every probing as the one object that the estimation takes, and
             the errors of the mesh; what fits of one body share, before anything is measured.
Takes      : a `Session`, its `ObjectModel`.
Gives      : `ProbeObservations` of the estimation, one for each probing.
Depends on : `pipeline.model`, `estimation`, `records`, `bem`, `geometry`; errors, shapes.
Read first : `session_observations.py`, `converged_observations.py`, then `mesh_errors.py`.
"""

from palpate.pipeline.observations.consistent_contacts import (
    with_consistent_contacts as with_consistent_contacts,
)
from palpate.pipeline.observations.converged_observations import (
    converged_observations as converged_observations,
)
from palpate.pipeline.observations.mesh_errors import (
    graded_observations as graded_observations,
    ungraded_observations as ungraded_observations,
    with_mesh_steps as with_mesh_steps,
)
from palpate.pipeline.observations.prepared_body import prepare_body as prepare_body
from palpate.pipeline.observations.session_observations import (
    session_observations as session_observations,
)
