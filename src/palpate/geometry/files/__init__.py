"""files."""

from palpate.geometry.files.mesh_files import (
    MESH_SUFFIXES as MESH_SUFFIXES,
    read_mesh as read_mesh,
    welded as welded,
    write_mesh as write_mesh,
)
