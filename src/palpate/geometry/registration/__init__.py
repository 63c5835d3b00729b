"""Pose of an object from points measured on its surface.

Purpose    : register measured points to a mesh, and find the motions that its shape does not
             determine.
Takes      : points with their covariances, a mesh, an initial pose.
Gives      : `Registration` with the covariance of the pose.
Depends on : nothing but the ground floor.
Read first : `registration.py`, `surface_fit.py`.
"""

from palpate.geometry.registration.coarse_pose import (
    compact_groups as compact_groups,
    initial_pose as initial_pose,
)
from palpate.geometry.registration.registration import (
    Registration as Registration,
    RegistrationSettings as RegistrationSettings,
    check_registration as check_registration,
    free_motions_text as free_motions_text,
    register as register,
)
