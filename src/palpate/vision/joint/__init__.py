"""The method `joint`: every window of the surface matched in all cameras at once.

Purpose    : follow points of the surface from picture to picture to a hundredth of a pixel, with a
             covariance that says how well each is known.
Takes      : a `Rig`, the pictures of its cameras instant by instant, a triangle surface.
Gives      : `JointFlow`, a `FlowMethod`; `JointState`, what it remembers.
Depends on : `vision.cameras`, `vision.images`, `vision.matching`, `geometry`, `records`.
Read first : `flow.py`, then `match.py`, then `refinement.py`.
"""

from palpate.vision.joint.flow import JointFlow as JointFlow
from palpate.vision.joint.scene import Scene as Scene, make_scene as make_scene
from palpate.vision.joint.vertices import vertex_displacement as vertex_displacement
