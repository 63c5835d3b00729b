"""stereo."""

from palpate.vision.stereo.rig_check import RigCheck as RigCheck, check_rig as check_rig
from palpate.vision.stereo.stereo import (
    StereoPoints as StereoPoints,
    StereoSettings as StereoSettings,
    stereo_points as stereo_points,
    triangulated_surface as triangulated_surface,
)
