"""A rig relative to an object of known shape.

Purpose    : the object's pose from pictures of it, and a correction of the rig from the same
             pictures.
Takes      : a `Rig`, with its covariance if there is one; a mesh; pictures of the object at rest.
Gives      : `ObjectView` and its files; `Refined`.
Depends on : `vision`, `geometry`, `records`.
Read first : `view.py`, then `refine.py`, `ties.py`, `body.py`.
"""
