"""The measurement itself: an arm that probes, sensors that are read, files that are written.

Purpose    : carry out the probings, or the steps of a motion stage, of a configuration.
Takes      : configurations with a folder each; or a session that is not yet measured.
Gives      : session folders with ground truth; previews of the camera pictures; recordings of
             calibration boards, turntables and presses.
Depends on : `lab.pictures`, `solids`, `vision`, `records`, `geometry`.
Read first : `facility.py`, then `arm.py`, `session_text.py`.
"""
