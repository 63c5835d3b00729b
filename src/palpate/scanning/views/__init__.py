"""Views of an object: points measured from single viewpoints.

Purpose    : read point clouds, depth maps and pictures of several cameras, as points with normals.
Takes      : `scan.toml`; PLY, PCD, NPY, columns of text; 16-bit depth maps; a `Rig` and pictures.
Gives      : `Scan` with its `View`s.
Depends on : `records`, `vision`; files of its room.
Read first : `view.py`, `scan_file.py`.
"""

from palpate.scanning.views.depth_maps import depth_points as depth_points
from palpate.scanning.views.point_files import (
    POINT_SUFFIXES as POINT_SUFFIXES,
    read_points as read_points,
)
from palpate.scanning.views.scan_file import Scan as Scan, read_scan as read_scan
from palpate.scanning.views.turntable import Turntable as Turntable
from palpate.scanning.views.view import Pose as Pose, View as View, make_view as make_view
