"""Repair of broken surfaces to the boundary of one solid.

Purpose    : repair surfaces from scanners, 3-D printing files or CAD programs that are open,
             duplicated, folded or inverted; reject what cannot be repaired, with place and reason.
Takes      : `TriangleMesh`, closed or not; the plane that the object stood on.
Gives      : `Mended` with its `Action`s; `Deviation` between two surfaces.
Depends on : `geometry`; libigl, manifold3d and Mmg.
Read first : `mend.py`, then `cleaning.py`, `pieces.py`, `holes.py`, `solid.py`.
"""

from palpate.scanning.mending.action import Action as Action, place_text as place_text
from palpate.scanning.mending.adapt import adapted as adapted
from palpate.scanning.mending.cleaning import compacted as compacted, seam_width as seam_width
from palpate.scanning.mending.deviation import (
    Deviation as Deviation,
    deviation as deviation,
    distances as distances,
    surface_samples as surface_samples,
)
from palpate.scanning.mending.mend import Mended as Mended, mend as mend
from palpate.scanning.mending.solid import (
    above as above,
    largest_piece as largest_piece,
    wrapped as wrapped,
)
