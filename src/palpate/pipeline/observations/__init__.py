"""What the probings of a session saw, beside what its model says they should have seen.

Purpose    : measurement and model of every probing as the one object that the estimation takes, and
             the errors of the mesh.
Takes      : a `Session`, its `ObjectModel`.
Gives      : `ProbeObservations` of the estimation, one for each probing.
Depends on : `pipeline.model`, `estimation`, `records`, `bem`, `geometry`; errors, shapes.
Read first : `session_observations.py`, `settled_observations.py`, then `mesh_errors.py`.
"""

from palpate.pipeline.observations.mesh_errors import (
    coarser_observations as coarser_observations,
    graded_observations as graded_observations,
    with_considered_errors as with_considered_errors,
)
from palpate.pipeline.observations.session_observations import (
    session_observations as session_observations,
)
from palpate.pipeline.observations.settled_observations import (
    settled_observations as settled_observations,
)
