"""From views, scans or broken meshes to one closed surface with even triangles.

Purpose    : the mesh of an object that was scanned, printed or drawn.
Takes      : surfaces as triangles, closed or not; points, depth maps and pictures of views.
Gives      : `PreparedSurface` and `ScannedSurface`: a surface fit for the boundary element model,
             with its repairs, guessed parts and uncertainty.
Depends on : `vision`, `geometry`, `records`.
Read first : `prepare.py`, `mending/mend.py`, `remesh.py`; `scan.py`, `joining/fusion.py`.
"""

from palpate.scanning.mending.action import Action as Action, place_text as place_text
from palpate.scanning.mending.deviation import (
    Deviation as Deviation,
    deviation as deviation,
    distances as distances,
)
from palpate.scanning.mending.mend import Mended as Mended, mend as mend
from palpate.scanning.plane import (
    Plane as Plane,
    plane_from_text as plane_from_text,
    plane_text as plane_text,
)
from palpate.scanning.prepare import (
    PreparedSurface as PreparedSurface,
    prepare_surface as prepare_surface,
)
from palpate.scanning.remesh import remeshed as remeshed
from palpate.scanning.scan import (
    ScannedSurface as ScannedSurface,
    scan_surface as scan_surface,
)
from palpate.scanning.surface_file import write_surface as write_surface
from palpate.scanning.views.depth_maps import depth_points as depth_points
from palpate.scanning.views.point_files import read_points as read_points
from palpate.scanning.views.scan_file import Scan as Scan, read_scan as read_scan
from palpate.scanning.views.turntable import Turntable as Turntable
from palpate.scanning.views.view import View as View, make_view as make_view
