"""From the pictures of calibrated cameras to the displacement of the object's surface.

Purpose    : range flow, a 3-D displacement with a covariance at points of the surface, and from it
             the displacement of the mesh's vertices.
Takes      : a `Rig`, grey pictures, a triangle surface.
Gives      : `RangeFlow`, `VertexDisplacement`.
Depends on : `records`, `geometry`, `shapes`, `errors`.
Read first : `range_flow.py`, then `joint_flow.py`.
"""

from palpate.vision.camera import normalised, project, project_jacobian, rays
from palpate.vision.dense_maps import dense_maps
from palpate.vision.joint_flow import joint_flow
from palpate.vision.joint_settings import JointSettings
from palpate.vision.lang_pai import lang_pai_flow
from palpate.vision.lang_pai_settings import LangPaiSettings
from palpate.vision.lang_pai_vertices import lang_pai_vertices
from palpate.vision.pictures import Pictures, read_pictures
from palpate.vision.planar_flow import PlanarFlow, planar_flow
from palpate.vision.planar_refinement import PlanarSettings
from palpate.vision.range_flow import Outcome, RangeFlow, VertexDisplacement, is_valid
from palpate.vision.rig_check import RigCheck, check_rig
from palpate.vision.scene import Scene, make_scene
from palpate.vision.stereo import (
    StereoPoints,
    StereoSettings,
    stereo_points,
    triangulated_surface,
)
from palpate.vision.surface_map import SurfaceMap, surface_map, visible
from palpate.vision.triangulation import Triangulation, triangulate
from palpate.vision.vertex_displacement import vertex_displacement

__all__ = [
    "JointSettings",
    "LangPaiSettings",
    "Outcome",
    "Pictures",
    "PlanarFlow",
    "PlanarSettings",
    "RangeFlow",
    "RigCheck",
    "Scene",
    "StereoPoints",
    "StereoSettings",
    "SurfaceMap",
    "Triangulation",
    "VertexDisplacement",
    "check_rig",
    "dense_maps",
    "is_valid",
    "joint_flow",
    "lang_pai_flow",
    "lang_pai_vertices",
    "make_scene",
    "normalised",
    "planar_flow",
    "project",
    "project_jacobian",
    "rays",
    "read_pictures",
    "stereo_points",
    "surface_map",
    "triangulate",
    "triangulated_surface",
    "vertex_displacement",
    "visible",
]
