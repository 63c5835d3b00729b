"""Surface points from the pictures of one instant, and a check of the rig against the pictures.

Purpose    : locate the object before anything is known about its surface or pose.
Takes      : `PreparedPictures` of one instant.
Gives      : `StereoPoints` with covariance, notes on the rig; the `Registration` of the points to a
             known object.
Depends on : `vision.matching`, `geometry`, `records`.
Read first : `stereo.py`, then `pair_disparity.py`; `rig_check.py` stands by itself.
"""
