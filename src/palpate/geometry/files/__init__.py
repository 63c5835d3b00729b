"""Mesh files.

Purpose    : read the surface of an object from the usual formats, and write it.
Takes      : PLY, OBJ, STL, OFF, MSH, VTU and VTP files.
Gives      : `TriangleMesh` in metres with coinciding vertices welded.
Depends on : nothing but the ground floor.
Read first : `mesh_files.py`.
"""

from palpate.geometry.files.mesh_files import (
    MESH_SUFFIXES as MESH_SUFFIXES,
    read_mesh as read_mesh,
    welded as welded,
    write_mesh as write_mesh,
)
from palpate.geometry.files.vtp_file import check_packed_arrays as check_packed_arrays
