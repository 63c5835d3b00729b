"""Motion of a session's object, measured in its pictures.

Purpose    : measure every motion of a session, one by one or all at once, and sum it up.
Takes      : a `Session` with images, a `FlowMethod`.
Gives      : `MeasuredMotion`, `SessionFlow`, `ProbingMotion`, the session with the measured
             displacements; `MotionFigures`, flow.json.
Depends on : `vision`, `records`, `geometry`.
Read first : `sequences.py`, `measure_motion.py`, `displacement.py`, then `figures.py`.
"""

from palpate.pipeline.motion.displacement import (
    ProbingMotion as ProbingMotion,
    measure_pictures as measure_pictures,
    unread_probings as unread_probings,
    vertex_field as vertex_field,
    with_measured_displacement as with_measured_displacement,
    with_motions as with_motions,
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
)
from palpate.pipeline.motion.notes import MotionNotes as MotionNotes
from palpate.pipeline.motion.sequences import (
    motion_keys as motion_keys,
    motion_names as motion_names,
    picture_files as picture_files,
)
