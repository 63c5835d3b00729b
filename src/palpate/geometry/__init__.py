"""Geometry of the object's surface.

Purpose    : triangle surfaces, their files, their quality, closest points on them.
Takes      : arrays and mesh files.
Gives      : `TriangleMesh`, `SurfacePoints`, figures about a mesh.
Depends on : `errors`, `shapes`.
Read first : `triangle_mesh.py`, then `mesh_quality.py`.
"""

from palpate.geometry.closest_point import SurfacePoints, closest_points, triangle_distances
from palpate.geometry.fixed_array import fixed_array
from palpate.geometry.late_import import late_import
from palpate.geometry.mesh_files import MESH_SUFFIXES, read_mesh, welded, write_mesh
from palpate.geometry.mesh_quality import MeshQuality, checked_mesh, mesh_quality
from palpate.geometry.midpoints import (
    QuadraticNodes,
    displacement_nodes,
    interpolation_matrix,
    linear_nodes,
    side_nodes,
)
from palpate.geometry.refinement import refined_surface
from palpate.geometry.registration import (
    Registration,
    RegistrationSettings,
    check_registration,
    register,
)
from palpate.geometry.self_intersection import intersecting_pairs
from palpate.geometry.sides import CREASE_ANGLE, Sides, split_sides
from palpate.geometry.threads import in_threads
from palpate.geometry.triangle_mesh import (
    TriangleMesh,
    area_vectors,
    bounding_diagonal,
    enclosed_volume,
    triangle_areas,
    unit_normals,
    vertex_normals,
)

__all__ = [
    "CREASE_ANGLE",
    "MESH_SUFFIXES",
    "MeshQuality",
    "QuadraticNodes",
    "Registration",
    "RegistrationSettings",
    "Sides",
    "SurfacePoints",
    "TriangleMesh",
    "area_vectors",
    "bounding_diagonal",
    "check_registration",
    "checked_mesh",
    "closest_points",
    "displacement_nodes",
    "enclosed_volume",
    "fixed_array",
    "in_threads",
    "interpolation_matrix",
    "intersecting_pairs",
    "late_import",
    "linear_nodes",
    "mesh_quality",
    "read_mesh",
    "refined_surface",
    "register",
    "side_nodes",
    "split_sides",
    "triangle_areas",
    "triangle_distances",
    "unit_normals",
    "vertex_normals",
    "welded",
    "write_mesh",
]
