"""From views, scans or broken meshes to one closed surface with even triangles.

Purpose    : the mesh of an object for a person who has scanned it, printed it or drawn it.
Takes      : surfaces as triangles, closed or not; clouds of points.
Gives      : `PreparedSurface`: a surface that the boundary element model takes, what was mended,
             and how far it is from what was given.
Depends on : `geometry`, `records`.
Read first : `prepare.py`, then `mending/mend.py` and `remesh.py`.
"""

from palpate.scanning.mending import (
    Action as Action,
    Deviation as Deviation,
    Mended as Mended,
    deviation as deviation,
    distances as distances,
    mend as mend,
    place_text as place_text,
)
from palpate.scanning.plane import (
    Plane as Plane,
    plane_from_text as plane_from_text,
    plane_text as plane_text,
)
from palpate.scanning.prepare import (
    PreparedSurface as PreparedSurface,
    prepare_surface as prepare_surface,
    write_prepared as write_prepared,
)
from palpate.scanning.remesh import remeshed as remeshed
from palpate.scanning.views import read_points as read_points
