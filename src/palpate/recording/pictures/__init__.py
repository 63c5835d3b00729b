"""The cameras' recordings, frame by frame: motion, presses, pictures of single moments.

Purpose    : evaluate recordings of any length without keeping them in memory.
Takes      : `Footage`: a video, or pictures with their times.
Gives      : `CameraMotion`, `Ramp`; PNG files of moments.
Depends on : `vision`, `records`.
Read first : `footage.py`, then `motion.py`, `ramps.py`, `moments.py`.
"""
