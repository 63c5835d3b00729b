"""A rig relative to an object of known shape.

Purpose    : the object's pose from pictures of it, and a correction of the rig from the same
             pictures.
Takes      : a `Rig`, with its covariance if there is one; a mesh; pictures of the object at rest.
Gives      : `ObjectView` and its files; `Refined`.
Depends on : `vision`, `geometry`, `records`.
Read first : `view.py`, then `refine.py`, `ties.py`, `body.py`.
"""

from palpate.calibration.known_object.body import KnownSurface as KnownSurface
from palpate.calibration.known_object.refine import Refined as Refined, refined_rig as refined_rig
from palpate.calibration.known_object.ties import Ties as Ties
from palpate.calibration.known_object.view import (
    ObjectView as ObjectView,
    find_instants as find_instants,
    view_object as view_object,
    write_object_view as write_object_view,
)
