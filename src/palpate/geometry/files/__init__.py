"""Mesh files.

Purpose    : read the surface of an object from the usual formats, and write it.
Takes      : PLY, OBJ, STL, OFF, MSH, VTU and VTP files.
Gives      : `TriangleMesh` in metres with coinciding vertices welded.
Depends on : nothing but the ground floor.
Read first : `mesh_files.py`.
"""
