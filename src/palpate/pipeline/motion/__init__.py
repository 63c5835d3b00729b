"""Motion of a session's object, measured in its pictures.

Purpose    : measure every motion of a session, one by one or all at once, and sum it up.
Takes      : a `Session` with images, a `FlowMethod`; a result folder.
Gives      : `MeasuredMotion`, `SessionFlow`, `ProbingMotion`, the session with the measured
             displacements; `MotionFigures`, flow.json, motion.npz.
Depends on : `vision`, `records`, `geometry`.
Read first : `sequences.py`, `measure_motion.py`, `displacement.py`, then `figures.py`.
"""
