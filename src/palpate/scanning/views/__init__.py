"""Views of an object: points measured from single viewpoints.

Purpose    : read point clouds, depth maps and pictures of several cameras, as points with normals.
Takes      : `scan.toml`; PLY, PCD, NPY, columns of text; 16-bit depth maps; a `Rig` and pictures.
Gives      : `Scan` with its `View`s.
Depends on : `records`, `vision`; files of its room.
Read first : `view.py`, `scan_file.py`.
"""
