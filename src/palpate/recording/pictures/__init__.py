"""The cameras' recordings, frame by frame: motion, presses, pictures of single moments.

Purpose    : evaluate recordings of any length without keeping them in memory.
Takes      : `Footage`: a video, or pictures with their times.
Gives      : `CameraMotion`, `Ramp`; PNG files of moments.
Depends on : `vision`, `records`.
Read first : `footage.py`, then `motion.py`, `ramps.py`, `moments.py`.
"""

from palpate.recording.pictures.footage import (
    Footage as Footage,
    read_frames as read_frames,
    read_times as read_times,
)
from palpate.recording.pictures.moments import (
    MAX_FRAMES as MAX_FRAMES,
    Moment as Moment,
    write_moments as write_moments,
)
from palpate.recording.pictures.motion import (
    CameraMotion as CameraMotion,
    camera_motion as camera_motion,
    still_frames as still_frames,
)
from palpate.recording.pictures.ramps import (
    MARGIN as MARGIN,
    Ramp as Ramp,
    RampTimes as RampTimes,
    camera_ramps as camera_ramps,
)
