"""Windows of one picture found in another, and smooth fields through scattered displacements.

Purpose    : the motion of every pixel without an initial guess (dense and sparse flow); the motion
             of a window to a hundredth of a pixel; predictions from neighbouring displacements.
Takes      : grey pictures, prepared by `images`; displacements of scattered points.
Gives      : `dense_start`, `refine_planar`, `local_field`, `noise_correlation`, `predicted`, and
             the window kernels.
Depends on : `vision.images`, `vision.small_systems`, `records`.
Read first : `window_sums.py`, then `planar_match.py`, then `dense_flow.py`.
"""
