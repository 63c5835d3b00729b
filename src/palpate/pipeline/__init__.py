"""From files to results: the one place where vision, probe, boundary elements and estimation meet.

Purpose    : measure the motion of a session's object from its pictures; estimate its constants.
Takes      : a `Session`.
Gives      : `SessionFlow`, `FitResult`, and the model between them.
Depends on : `vision`, `probe`, `bem`, `estimation`, `records`.
Read first : `fit_session.py`, then `measure_motion.py`.
"""

from palpate.pipeline.fit_session import (
    ContactPoints,
    ObjectModel,
    fit_session,
    make_object_model,
    session_observations,
    surface_load,
)
from palpate.pipeline.measure_motion import (
    MeasuredMotion,
    MotionSettings,
    SessionFlow,
    measure_motion,
    with_measured_displacement,
)
from palpate.pipeline.measurement_plan import (
    MATCHING_NOISE,
    MeasurementPlan,
    PlannedProbing,
    plan_measurement,
)

__all__ = [
    "MATCHING_NOISE",
    "ContactPoints",
    "MeasuredMotion",
    "MeasurementPlan",
    "MotionSettings",
    "ObjectModel",
    "PlannedProbing",
    "SessionFlow",
    "fit_session",
    "make_object_model",
    "measure_motion",
    "plan_measurement",
    "session_observations",
    "surface_load",
    "with_measured_displacement",
]
