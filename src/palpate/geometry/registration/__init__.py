"""Pose of an object from points measured on its surface.

Purpose    : register measured points to a mesh, and find the motions that its shape does not
             determine.
Takes      : points with their covariances, a mesh, an initial pose.
Gives      : `Registration` with the covariance of the pose.
Depends on : nothing but the ground floor.
Read first : `registration.py`, `surface_fit.py`.
"""
