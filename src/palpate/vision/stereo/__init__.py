"""Surface points from the pictures of one instant, and a check of the rig against the pictures.

Purpose    : locate the object before anything is known about its surface or pose.
Takes      : `PreparedPictures` of one instant.
Gives      : `StereoPoints` with covariance, `RigCheck`; the `Registration` of the points to a known
             object.
Depends on : `vision.cameras`, `vision.images`, `vision.matching`, `vision.range_flow`, `geometry`,
             `records`.
Read first : `stereo.py`, then `pair_disparity.py`; `rig_check.py` stands by itself.
"""

from palpate.vision.stereo.known_object import (
    MIN_POSE_POINTS as MIN_POSE_POINTS,
    near_object as near_object,
    object_frame as object_frame,
    register_object as register_object,
    smooth_surface as smooth_surface,
)
from palpate.vision.stereo.rig_check import RigCheck as RigCheck, check_rig as check_rig
from palpate.vision.stereo.stereo import (
    StereoMatches as StereoMatches,
    StereoPoints as StereoPoints,
    StereoSettings as StereoSettings,
    stereo_matches as stereo_matches,
    stereo_points as stereo_points,
    triangulated_matches as triangulated_matches,
)
