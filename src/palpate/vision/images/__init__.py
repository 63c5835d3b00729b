"""Pictures from files, prepared for searching and matching.

Purpose    : grey levels from picture files, or a message about what is wrong with a file;
             normalised pictures, their features, and interpolation between pixels.
Takes      : picture files, a `Rig`.
Gives      : `Pictures`, `NormalisedImage`, `PreparedPictures`, `SplinePicture`.
Depends on : `records`.
Read first : `pictures.py`, then `spline.py`.
"""
