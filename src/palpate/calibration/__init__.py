"""Cameras calibrated from pictures of boards: lenses and poses, with their covariance.

Purpose    : a `Rig` for a person who has cameras and a printer.
Takes      : pictures of a target, a folder for every camera.
Gives      : `Calibration`: cameras, their covariance, what is left in the pictures; files of it.
Depends on : `vision`, `records`.
Read first : `targets.py`, then `calibrate.py` and `adjustment.py`.
"""

from palpate.calibration.adjustment import Adjusted as Adjusted, Corners as Corners
from palpate.calibration.calibrate import (
    Calibration as Calibration,
    board_frame as board_frame,
    calibrate as calibrate,
    view_rms as view_rms,
)
from palpate.calibration.files import write_calibration as write_calibration
from palpate.calibration.quality import (
    REGIONS as REGIONS,
    CameraQuality as CameraQuality,
    LengthCheck as LengthCheck,
    camera_quality as camera_quality,
    length_check as length_check,
    length_sigma as length_sigma,
)
from palpate.calibration.sightings import (
    Sightings as Sightings,
    find_boards as find_boards,
    find_pictures as find_pictures,
)
from palpate.calibration.targets import (
    AprilGrid as AprilGrid,
    Charuco as Charuco,
    Chessboard as Chessboard,
    Circles as Circles,
    Target as Target,
)
