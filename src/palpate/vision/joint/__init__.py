"""joint."""

from palpate.vision.joint.flow import joint_flow as joint_flow
from palpate.vision.joint.scene import Scene as Scene, make_scene as make_scene
from palpate.vision.joint.settings import JointSettings as JointSettings
from palpate.vision.joint.tracking import grid_triangles as grid_triangles
from palpate.vision.joint.vertices import vertex_displacement as vertex_displacement
