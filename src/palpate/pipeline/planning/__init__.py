"""What to measure, and what to expect of it, before it is measured.

Purpose    : expected precision of probings still to be made, and the most informative next places.
Takes      : a `Session`, with a guess of its constants or with measurements.
Gives      : `MeasurementPlan`, `NextProbings`.
Depends on : `pipeline.model`, `pipeline.motion`, `pipeline.observations`, `lab`, `estimation`,
             `vision`, `records`, `geometry`.
Read first : `measurement_plan.py`, then `next_probings.py`.
"""

from palpate.pipeline.planning.measurement_plan import (
    MeasurementPlan as MeasurementPlan,
    plan_measurement as plan_measurement,
)
from palpate.pipeline.planning.next_probings import (
    NextProbings as NextProbings,
    plan_next as plan_next,
)
