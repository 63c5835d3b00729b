"""Cameras calibrated from pictures of boards: lenses and poses, with their covariance.

Purpose    : a `Rig` for anyone with cameras and a printer; the pose of a rig relative to an object
             of known shape.
Takes      : pictures or videos of a target, a folder for every camera; pictures of an object.
Gives      : `Calibration`: cameras, their covariance, residuals; `ObjectView`, a rig in an object's
             frame, refined by the object's texture; files of both.
Depends on : `vision`, `geometry`, `records`.
Read first : `targets.py`, then `calibrate.py` and `adjustment.py`; `object_view.py`, then
             `refinement.py`.
"""

from palpate.calibration.calibrate import (
    Calibration as Calibration,
    board_frame as board_frame,
    calibrate as calibrate,
    known_rig as known_rig,
)
from palpate.calibration.object_view import (
    ObjectView as ObjectView,
    find_instants as find_instants,
    view_object as view_object,
    write_object_view as write_object_view,
)
from palpate.calibration.quality import (
    REGIONS as REGIONS,
    CameraQuality as CameraQuality,
    PictureError as PictureError,
    baseline_text as baseline_text,
    camera_quality as camera_quality,
    length_check as length_check,
    length_sigma as length_sigma,
    middle_view as middle_view,
    picture_errors as picture_errors,
    timing_note as timing_note,
    write_calibration as write_calibration,
)
from palpate.calibration.sightings import (
    Sightings as Sightings,
    eight_bits as eight_bits,
    find_boards as find_boards,
    find_pictures as find_pictures,
    find_videos as find_videos,
    gathered as gathered,
    still_frames as still_frames,
    without_repeats as without_repeats,
)
from palpate.calibration.targets import (
    TARGET_KINDS as TARGET_KINDS,
    AprilGrid as AprilGrid,
    Charuco as Charuco,
    Chessboard as Chessboard,
    Circles as Circles,
    Sighting as Sighting,
    Target as Target,
    make_target as make_target,
)
