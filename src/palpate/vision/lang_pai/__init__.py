"""The paper's method as written: stereo, whole-pixel correlation, and a vote of the cameras.

Purpose    : range flow and vertex displacements by the method of Lang and Pai (2001), section 4,
             as the baseline for `joint`.
Takes      : a `Rig`, the pictures of its cameras at each instant, a triangle mesh.
Gives      : `LangPaiFlow`, a `FlowMethod`.
Depends on : `records`, `geometry`.
Read first : `flow.py`, then `voting.py`.
"""
