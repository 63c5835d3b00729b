"""From the pictures of calibrated cameras to the displacement of the object's surface.

Purpose    : range flow, a 3-D displacement with a covariance at points of the surface, and from it
             the displacement of the mesh's vertices.
Takes      : a `Rig`, grey pictures, a triangle surface.
Gives      : `RangeFlow`, `VertexDisplacement`.
Depends on : `records`, `geometry`, `shapes`, `errors`.
Read first : `range_flow.py`, then `joint_flow.py`.
"""

from palpate.vision.cameras import (
    SurfaceMap as SurfaceMap,
    Triangulation as Triangulation,
    camera_sigma as camera_sigma,
    normalised as normalised,
    pixel_grid as pixel_grid,
    project as project,
    project_jacobian as project_jacobian,
    rays as rays,
    surface_map as surface_map,
    triangulate as triangulate,
    visible as visible,
)
from palpate.vision.dense_maps import dense_maps as dense_maps
from palpate.vision.images import (
    Pictures as Pictures,
    prepare_pictures as prepare_pictures,
    read_pictures as read_pictures,
)
from palpate.vision.joint import (
    JointSettings as JointSettings,
    Scene as Scene,
    joint_flow as joint_flow,
    make_scene as make_scene,
    vertex_displacement as vertex_displacement,
)
from palpate.vision.lang_pai import (
    LangPaiSettings as LangPaiSettings,
    lang_pai_flow as lang_pai_flow,
    lang_pai_vertices as lang_pai_vertices,
)
from palpate.vision.matching import PlanarSettings as PlanarSettings
from palpate.vision.range_flow import (
    CAUSES as CAUSES,
    Outcome as Outcome,
    RangeFlow as RangeFlow,
    VertexDisplacement as VertexDisplacement,
    cause_counts as cause_counts,
    is_valid as is_valid,
    measured_vertices as measured_vertices,
)
from palpate.vision.stereo import (
    RigCheck as RigCheck,
    StereoPoints as StereoPoints,
    StereoSettings as StereoSettings,
    check_rig as check_rig,
    stereo_points as stereo_points,
    triangulated_surface as triangulated_surface,
)
