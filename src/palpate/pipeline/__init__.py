"""From files to results: the one place where vision, probe, boundary elements and estimation meet.

Purpose    : measure the motion of a session's object from its pictures, estimate its constants,
             poke it; warm up: compile the kernels of all that.
Takes      : a `Session`.
Gives      : `SessionFlow`, `FitResult`, the model that links them, and the files that hold them.
Depends on : `field`, `lab`, `vision`, `probe`, `bem`, `solids`, `relaxation`, `estimation`,
             `records`, `geometry`.
Read first : `fit_session.py`, then `result_files.py`.
"""

from palpate.pipeline.creep import require_series as require_series
from palpate.pipeline.fit_session import fit_session as fit_session, prepare_body as prepare_body
from palpate.pipeline.heterogeneous import (
    FittedBody as FittedBody,
    Material as Material,
    fitted_body as fitted_body,
)
from palpate.pipeline.model.contact_loads import (
    outward_pushes as outward_pushes,
    surface_load as surface_load,
)
from palpate.pipeline.model.grading import (
    graded_session as graded_session,
    refined_session as refined_session,
)
from palpate.pipeline.model.object_model import make_object_model as make_object_model
from palpate.pipeline.model.supports import (
    moving_supports as moving_supports,
    require_given_motions as require_given_motions,
    rigid_modes as rigid_modes,
    sliding_motion as sliding_motion,
)
from palpate.pipeline.motion.displacement import (
    MOTION_FILE as MOTION_FILE,
    ProbingMotion as ProbingMotion,
    keep_motion as keep_motion,
    kept_motion as kept_motion,
    kept_motion_keys as kept_motion_keys,
    measure_pictures as measure_pictures,
    unread_probings as unread_probings,
    with_measured_displacement as with_measured_displacement,
    with_motions as with_motions,
    with_pictures_measured as with_pictures_measured,
)
from palpate.pipeline.motion.figures import (
    MotionFigures as MotionFigures,
    Rejections as Rejections,
    rejection_note as rejection_note,
    rejections as rejections,
    write_flow_document as write_flow_document,
)
from palpate.pipeline.motion.measure_motion import (
    FLOW_METHODS as FLOW_METHODS,
    MeasuredMotion as MeasuredMotion,
    MotionNotes as MotionNotes,
    SessionFlow as SessionFlow,
    measure_motion as measure_motion,
    measured_motions as measured_motions,
)
from palpate.pipeline.motion.sequences import (
    PoseChoice as PoseChoice,
    motion_names as motion_names,
    picture_files as picture_files,
)
from palpate.pipeline.observations import (
    converged_observations as converged_observations,
    graded_observations as graded_observations,
    session_observations as session_observations,
)
from palpate.pipeline.places import first_place as first_place
from palpate.pipeline.planning import (
    PREDICTION as PREDICTION,
    MeasurementPlan as MeasurementPlan,
    NextProbings as NextProbings,
    expected_precision as expected_precision,
    plan_measurement as plan_measurement,
    plan_next as plan_next,
)
from palpate.pipeline.poke import (
    PokedState as PokedState,
    held_object as held_object,
    poke_session as poke_session,
    tool_contact as tool_contact,
    von_mises_stress as von_mises_stress,
)
from palpate.pipeline.pokes import pooled as pooled
from palpate.pipeline.reciprocity import reciprocity as reciprocity
from palpate.pipeline.result_files import (
    SURFACE_FILE as SURFACE_FILE,
    FittedProbing as FittedProbing,
    FittedSurface as FittedSurface,
    read_fitted_surface as read_fitted_surface,
    read_modulus as read_modulus,
    seen_vertices as seen_vertices,
    write_fitted_surface as write_fitted_surface,
    write_flow_npz as write_flow_npz,
    write_flow_vtp as write_flow_vtp,
    write_held_out as write_held_out,
    write_modulus as write_modulus,
    write_motion as write_motion,
    write_relaxation as write_relaxation,
    write_residuals as write_residuals,
    write_vertices as write_vertices,
)
from palpate.pipeline.survey import (
    COARSEST_TEXTURE as COARSEST_TEXTURE,
    DARK_LEVEL as DARK_LEVEL,
    MOST_SATURATED as MOST_SATURATED,
    NEAR_RADII as NEAR_RADII,
    CameraSurvey as CameraSurvey,
    ProbingSurvey as ProbingSurvey,
    ViewSurvey as ViewSurvey,
    session_outlook as session_outlook,
    size_notes as size_notes,
    survey_cameras as survey_cameras,
    survey_field as survey_field,
    survey_probing as survey_probing,
    survey_view as survey_view,
    texture_length as texture_length,
    triangulated as triangulated,
    without_contradicted as without_contradicted,
)
from palpate.pipeline.warm_up import warm_up as warm_up
