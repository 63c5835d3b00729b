"""Windows of the surface found in other pictures, and smooth fields through displacements.

Purpose    : the motion of every pixel without an initial guess (dense flow, features); the motion
             of a window, matched in all cameras at once, to a hundredth of a pixel with its
             covariance; predictions from neighbouring displacements.
Takes      : a `Rig`, prepared pictures of its cameras at two instants, a triangle surface; starts;
             displacements of scattered points.
Gives      : `Scene`, an instant with its points; `Match`, their motion, from `refine_joint`;
             `dense_start`, `local_field`, `predicted`, feature matches, and the window kernels.
Depends on : `records`.
Read first : `scene.py`, then `window.py`, then `refinement.py`.
"""
