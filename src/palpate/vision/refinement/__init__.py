"""One window of the surface matched in all cameras at once, from a start.

Purpose    : the motion of points of a surface between two instants to a hundredth of a pixel, each
             with its covariance.
Takes      : a `Rig`, the pictures of its cameras at two instants, a triangle surface; starts.
Gives      : `Scene`, an instant with its points; `Match`, their motion, from `refine_joint`.
Depends on : `vision.cameras`, `vision.images`, `vision.matching`, `vision.range_flow`,
             `vision.small_systems`, `records`.
Read first : `window_match.py`, then `refinement.py`.
"""
