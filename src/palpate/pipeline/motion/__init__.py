"""Motion of a session's object, measured in its pictures.

Purpose    : measure every motion of a session, one by one or all at once, and sum it up.
Takes      : a `Session` with images, a `FlowMethod`.
Gives      : `MeasuredMotion`, `SessionFlow`, the session with the measured displacements;
             `MotionFigures`, flow.json.
Depends on : `vision`, `records`, `geometry`.
Read first : `measure_motion.py`, `displacement.py`, then `figures.py`.
"""

from palpate.pipeline.motion.displacement import (
    SCALE_ERROR as SCALE_ERROR,
    vertex_field as vertex_field,
    with_measured_displacement as with_measured_displacement,
    with_pictures_measured as with_pictures_measured,
)
from palpate.pipeline.motion.figures import (
    MotionFigures as MotionFigures,
    motion_figures as motion_figures,
    write_flow_document as write_flow_document,
)
from palpate.pipeline.motion.measure_motion import (
    FLOW_METHODS as FLOW_METHODS,
    MeasuredMotion as MeasuredMotion,
    SessionFlow as SessionFlow,
    measure_motion as measure_motion,
    measured_motions as measured_motions,
    motion_key as motion_key,
    motion_names as motion_names,
)
