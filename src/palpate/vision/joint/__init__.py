"""The method `joint`: every window of the surface matched in all cameras at once.

Purpose    : track points of the surface from picture to picture to a hundredth of a pixel, each
             with its covariance.
Takes      : a `Rig`, the pictures of its cameras at each instant, a triangle surface.
Gives      : `JointFlow`, a `FlowMethod`; `JointState`, its state between instants.
Depends on : `vision.matching`, `geometry`, `records`.
Read first : `flow.py`, then `match.py`.
"""
