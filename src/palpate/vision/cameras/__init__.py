"""Projection of points into calibrated cameras, and from pixels back into space.

Purpose    : projection with its Jacobian and inverse, triangulation, rectification, and the surface
             point seen by each pixel.
Takes      : `Camera` and `Rig`, points, pixels, a triangle surface.
Gives      : pixels, rays, `Triangulation`, `SurfaceMap`, `Rectified`, apparent strains due to
             calibration errors.
Depends on : `vision.images`, `vision.small_systems`, `records`.
Read first : `lens.py`, then `projection.py`.
"""
