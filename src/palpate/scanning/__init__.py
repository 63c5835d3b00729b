"""From views, scans or broken meshes to one closed surface with even triangles.

Purpose    : the mesh of an object that was scanned, printed or drawn.
Takes      : surfaces as triangles, closed or not; points, depth maps and pictures of views.
Gives      : `PreparedSurface` and `ScannedSurface`: a surface fit for the boundary element model,
             with its repairs, guessed parts and uncertainty.
Depends on : `vision`, `geometry`, `records`; libigl, manifold3d and Mmg.
Read first : `mend.py`, then `cleaning.py`, `solid.py`, `remesh.py`; `scan.py`, then `fusion.py`.
"""

from palpate.scanning.mend import (
    PreparedSurface as PreparedSurface,
    prepare_surface as prepare_surface,
)
from palpate.scanning.plane import (
    plane_from_text as plane_from_text,
    plane_text as plane_text,
)
from palpate.scanning.poses import posed as posed
from palpate.scanning.remesh import (
    distances as distances,
)
from palpate.scanning.scan import (
    ScannedSurface as ScannedSurface,
    scan_surface as scan_surface,
    write_surface as write_surface,
)
from palpate.scanning.scan_file import (
    SCAN_FILE as SCAN_FILE,
    SCAN_FORMAT as SCAN_FORMAT,
    View as View,
    read_points as read_points,
    read_scan as read_scan,
)
