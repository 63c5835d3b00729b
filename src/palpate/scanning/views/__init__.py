"""What a scanner saw from its viewpoints.

Purpose    : read points and depth maps as they were written, in metres.
Takes      : PLY, PCD, NPY, columns of text.
Gives      : points.
Depends on : nothing but the ground floor.
Read first : `point_files.py`.
"""

from palpate.scanning.views.point_files import (
    POINT_SUFFIXES as POINT_SUFFIXES,
    read_points as read_points,
)
