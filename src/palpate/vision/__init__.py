"""From the pictures of calibrated cameras to the displacement of the object's surface.

Purpose    : range flow, i.e. the 3-D displacement of surface points with its covariance, and from
             it the displacement of the mesh's vertices.
Takes      : a `Rig`, grey pictures, a triangle surface.
Gives      : `FlowMethod` with `JointFlow` and `LangPaiFlow`; `RangeFlow`, `VertexDisplacement`;
             `StereoPoints`, and a check of the rig, from its pictures at rest.
Depends on : `geometry`, `records`.
Read first : `range_flow.py`, `projection.py`, `joint/flow.py`, then `lang_pai/flow.py`.
"""

from palpate.vision.joint.flow import JointFlow as JointFlow
from palpate.vision.lang_pai.flow import LangPaiFlow as LangPaiFlow
from palpate.vision.matching.features import prepare_pictures as prepare_pictures
from palpate.vision.matching.outliers import median_test as median_test
from palpate.vision.pictures import (
    VIDEO_SUFFIXES as VIDEO_SUFFIXES,
    Pictures as Pictures,
    picture_path as picture_path,
    read_grey as read_grey,
    read_pictures as read_pictures,
    read_stored as read_stored,
    video_frame_count as video_frame_count,
    video_frames as video_frames,
)
from palpate.vision.projection import (
    camera_sigma as camera_sigma,
    normalised as normalised,
    pixel_grid as pixel_grid,
    project as project,
    project_jacobian as project_jacobian,
)
from palpate.vision.range_flow import (
    CAUSES as CAUSES,
    FlowMethod as FlowMethod,
    Outcome as Outcome,
    RangeFlow as RangeFlow,
    VertexDisplacement as VertexDisplacement,
    cause_counts as cause_counts,
    dense_maps as dense_maps,
    is_valid as is_valid,
    measured_vertices as measured_vertices,
)
from palpate.vision.stereo.rig_check import check_rig as check_rig
from palpate.vision.stereo.stereo import (
    MIN_POSE_POINTS as MIN_POSE_POINTS,
    StereoMatches as StereoMatches,
    StereoPoints as StereoPoints,
    StereoSettings as StereoSettings,
    near_object as near_object,
    object_frame as object_frame,
    register_object as register_object,
    smooth_surface as smooth_surface,
    stereo_matches as stereo_matches,
    stereo_points as stereo_points,
    triangulated_matches as triangulated_matches,
)
from palpate.vision.surface_map import (
    SurfaceMap as SurfaceMap,
    surface_map as surface_map,
    visible as visible,
)
from palpate.vision.triangulation import (
    calibration_numbers as calibration_numbers,
    moved_rig as moved_rig,
    space_strains as space_strains,
    triangulate as triangulate,
)
